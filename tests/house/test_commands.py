"""The commands that documents print: each is one that the parser takes, with options that exist."""

from __future__ import annotations

import argparse
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import Run

from holdfast.cli.main import VERBS, functions_of
from holdfast.core.errors import UsageError

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")]
FENCED = re.compile(r"^```(?:sh|text)?\n(.*?)^```", re.DOTALL | re.MULTILINE)
INLINE = re.compile(r"(?<!`)`([^`\n]+)`(?!`)")
ENDS = re.compile(r"\s#\s|\s*(?:\||&&|;|<|>)\s")
"""Where one command ends in a line: its comment, a pipe, the next command, a file."""
BY_A_PROGRAM = re.compile(r'"(--[\w-]+)"')


class Refused(Exception):
    """What the parser says."""


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> None:  # type: ignore[override]
        raise Refused(message)


def _today(page: Path) -> str:
    """A page without what it says of the past."""
    return page.read_text("utf-8").partition("\n## Gone\n")[0]


def commands(page: Path) -> Iterator[str]:
    """What stands after `holdfast` in blocks of a page, and within its sentences."""
    text = _today(page)
    for block in FENCED.findall(text):
        for line in block.replace("\\\n", " ").splitlines():
            # at the begin of a line, after a pipe or &&, or by the path of an environment
            for part in re.findall(r"(?:^|[|&] |/bin/)holdfast ([a-z].*)", line):
                yield ENDS.split(part)[0]
    for words in INLINE.findall(FENCED.sub("", text)):
        if words.startswith("holdfast ") and not words.startswith("holdfast-"):
            yield words.removeprefix("holdfast ")
        elif re.match(rf"(?:{'|'.join(VERBS)}) (?:-|\S+://)", words):
            yield words


def parse(words: list[str]) -> None:
    """Raises Refused where the verb's own parser would."""
    if words[0] == "help":
        words = [words[1], "--help"] if len(words) > 1 else ["run", "--help"]
    if words[0] not in VERBS:
        raise Refused(f"no verb {words[0]}")
    parser = _Parser(prog=words[0])
    functions_of(words[0])[0](parser)
    for action in parser._actions:
        # holdfast.toml may give what a sentence leaves out
        action.required = False
    try:
        parser.parse_args(words[1:])
    except SystemExit:
        # of --help
        return
    except Refused as refused:
        # a sentence may name an option without its value
        if "expected" not in str(refused):
            raise


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_of_a_page_is_one(page: Path) -> None:
    wrong = {}
    for line in commands(page):
        words = [word for word in shlex.split(line) if word != ".."]
        if words[0].startswith("-") or words[:2] == ["help", "VERB"]:
            continue
        try:
            parse(words)
        except (Refused, UsageError) as refused:
            wrong[line] = str(refused)
    assert wrong == {}


@pytest.mark.parametrize(
    "line", ["run --controller none", "walk", "scan --opening larger", "train set"]
)
def test_a_command_that_does_not_exist_is_found(line: str) -> None:
    with pytest.raises((Refused, UsageError)):
        parse(line.split())


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_option_in_a_sentence_exists_somewhere(page: Path) -> None:
    known = {"--help", "--version", "--debug"}
    for folder in ("holdfast", "studies", "benchmarks", "examples", "tools"):
        for path in (ROOT / folder).rglob("*.py"):
            known.update(BY_A_PROGRAM.findall(path.read_text("utf-8")))
    text = FENCED.sub("", _today(page))
    named = set(
        re.findall(r"(?<![\w-])(--[a-z][\w-]+)", " ".join(INLINE.findall(text)))
    )
    assert named - known - OF_OTHERS == set()


OF_OTHERS = {"--upgrade"}
"""Options of programs that are not ours."""


@pytest.mark.parametrize(
    ("source", "says"),
    [
        ("usb://ft232h", "none on USB"),
        ("i2c://77", "/dev/i2c-77"),
        ("unix:///no/such/folder/hand.sock", "/no/such/folder"),
        ("serial:///dev/no-such-port", "/dev/no-such-port"),
    ],
)
def test_a_run_without_its_hardware_says_what_is_missing_and_what_to_do(
    run: Run, source: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, err = run("run", "--source", source, "--seconds", "1", "--to", "none")
    assert code in (2, 5, 6), err
    assert says in err
    assert "; next: " in err
    assert "Traceback" not in err
