"""What a command writes: whole or not there, readable by whom the umask says, and never over an
earlier result."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from command_line import Run, fails
from grip_bench import until
from hazard_marks import HALF_FINISHED, OVERWRITTEN, READABLE_BY_OTHERS
from recorder_bench import one_pull

from holdfast.cli.command import Parser
from holdfast.cli.main import VERBS, functions_of
from holdfast.core.errors import OutputError
from holdfast.core.writing import whole_folder, write_whole
from holdfast.data.fixture import write_fixture
from holdfast.export.exporting import require_replaceable

if TYPE_CHECKING:
    from conftest import Built


def options_of(verb: str) -> set[str]:
    parser = Parser()
    functions_of(verb)[0](parser)
    return set(parser._option_string_actions)


ROOT = Path(__file__).resolve().parents[2]
SetUmask = Callable[[int], None]


@pytest.fixture
def umask() -> Iterator[SetUmask]:
    """Set the umask of this process for one test."""
    before = os.umask(0o022)
    yield lambda mask: void(os.umask(mask))
    os.umask(before)


def void(_: object) -> None:
    return None


def mode_of(path: Path) -> int:
    return path.stat().st_mode & 0o777


# -- permissions


@READABLE_BY_OTHERS.mark
@pytest.mark.parametrize(
    ("mask", "mode"), [(0o077, 0o600), (0o022, 0o644), (0o002, 0o664)]
)
def test_a_new_file_has_the_permissions_that_the_umask_leaves(
    tmp_path, umask, mask, mode
):
    umask(mask)
    assert mode_of(write_whole(tmp_path / "meta.json", "{}")) == mode


@READABLE_BY_OTHERS.mark
def test_a_file_written_anew_is_readable_by_no_more_people_than_before(tmp_path, umask):
    path = write_whole(tmp_path / "meta.json", "{}")
    path.chmod(0o600)
    umask(0o000)
    write_whole(path, '{"mass_g": 80}')
    assert (mode_of(path), path.read_text()) == (0o600, '{"mass_g": 80}')


@READABLE_BY_OTHERS.mark
def test_under_a_umask_of_077_no_command_leaves_a_file_that_others_can_read(
    tmp_path, umask
):
    umask(0o077)
    one_pull(tmp_path / "recorded")
    with whole_folder(tmp_path / "set") as unfinished:
        write_whole(unfinished / "a/b.csv", "1")
    write_fixture(tmp_path / "fixture", trials_per_cell=1)
    written = list(tmp_path.rglob("*"))
    assert len(written) > 20
    assert {
        path.name: oct(mode_of(path)) for path in written if mode_of(path) & 0o077
    } == {}


# -- half-finished output


@HALF_FINISHED.mark
@pytest.mark.parametrize("end", ["SIGINT", "SIGTERM", "SIGKILL"])
def test_a_simulation_that_is_ended_leaves_nothing_that_looks_whole(tmp_path, end):
    command = [
        sys.executable,
        "-m",
        "holdfast",
        "simulate",
        "thesis",
        "--trials",
        "99",
        "--out",
        str(tmp_path / "set"),
    ]
    # a job in the background ignores it otherwise
    heeds = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    with subprocess.Popen(
        command, cwd=ROOT, stderr=subprocess.PIPE, text=True, preexec_fn=heeds
    ) as process:
        until(lambda: list(tmp_path.rglob("meta.json")))
        assert process.poll() is None
        process.send_signal(signal.Signals[end])
        _, err = process.communicate(timeout=300)
    assert not (tmp_path / "set").exists()
    if end == "SIGKILL":
        assert [path.name for path in tmp_path.iterdir()] == ["set.unfinished"]
    else:
        assert (process.returncode, list(tmp_path.iterdir())) == (130, [])
        assert "interrupted" in err


def test_a_folder_that_another_run_finished_first_is_not_written_over(tmp_path):
    def both_write() -> None:
        with whole_folder(tmp_path / "set") as unfinished:
            write_whole(unfinished / "card.toml", "ours")
            write_whole(tmp_path / "set/card.toml", "theirs")

    with pytest.raises(OutputError, match="cannot write"):
        both_write()
    assert {path.name: path.read_text() for path in tmp_path.rglob("*.toml")} == {
        "card.toml": "theirs"
    }
    assert [path.name for path in tmp_path.iterdir()] == ["set"]


# -- earlier results


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


@pytest.fixture
def artifact(eight_classes: Built, tmp_path: Path) -> Path:
    """An artifact of the fixture, exported, as it lies in build/default."""
    return shutil.copytree(eight_classes.artifact, tmp_path / "build/default")


@OVERWRITTEN.mark
def test_training_does_not_replace_an_artifact_without_force(
    run: Run, artifact: Path, tmp_path: Path
) -> None:
    before = bytes_of(artifact)
    words = ("train", "--data", tmp_path / "nowhere", "--out", artifact)
    fails(run, 5, "OutputError", *words, says="exists already")
    fails(run, 3, "DataNotFound", *words, "--force")
    fails(
        run,
        3,
        "DataNotFound",
        "train",
        "--data",
        tmp_path / "nowhere",
        "--out",
        tmp_path / "new",
    )
    assert bytes_of(artifact) == before


@OVERWRITTEN.mark
def test_an_export_replaces_its_own_earlier_model_and_nothing_else_without_force(
    run: Run,
    artifact: Path,
    tmp_path: Path,
) -> None:
    elsewhere = tmp_path / "models/hand.onnx"
    for there in (elsewhere, elsewhere.with_suffix(".json")):
        write_whole(there, "of another training")
        fails(
            run,
            5,
            "OutputError",
            "export",
            artifact,
            "--out",
            elsewhere,
            says=f"{there}: exists already",
        )
        there.unlink()
    require_replaceable(artifact, artifact / "holdfast.onnx", force=False)
    write_whole(elsewhere, "of another training")
    assert run("export", artifact, "--out", elsewhere, "--force")[0] == 0
    assert elsewhere.read_bytes() == (artifact / "holdfast.onnx").read_bytes()


@OVERWRITTEN.mark
@pytest.mark.parametrize("name", ["artifact.onnx", "rows.npz", "situation.skops"])
def test_an_export_never_replaces_a_part_of_its_artifact(
    run: Run, artifact: Path, name: str
) -> None:
    before = bytes_of(artifact)
    fails(
        run,
        5,
        "OutputError",
        "export",
        artifact,
        "--force",
        "--out",
        artifact / name,
        says="part of the artifact",
    )
    assert bytes_of(artifact) == before


# -- one rule for every file that a verb writes


JSON_VERBS = [verb for verb in VERBS if "--json" in options_of(verb)]
NEEDED: dict[str, str] = {
    "record": "--source sim://p1 --out new --person p01 --object cup --action pull",
    "check": "trials",
    "import": "trials --out new",
    "evaluate": "m.onnx --data trials",
    "simulate": "thesis --out new",
    "bias": "--source virtual://ft232h --out new.json",
    "calibrate": "loads.csv --out new.json",
    "bench": "latency",
    "adapt": "m.onnx --undo --out new.onnx",
    "watch": "--onset trials",
    "convert": "trials --to mcap --out new",
}
"""Verb -> what it needs to begin; the others need nothing."""


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with a model, its card, loads and an empty folder."""
    monkeypatch.chdir(tmp_path)
    for name in ("m.onnx", "m.json", "loads.csv", "kept.json"):
        (tmp_path / name).write_text(name)
    (tmp_path / "trials").mkdir()
    return tmp_path


@OVERWRITTEN.mark
@pytest.mark.parametrize("verb", JSON_VERBS)
@pytest.mark.parametrize(
    ("result", "says"),
    [
        ("kept.json", "exists already"),
        ("trials", "is a folder"),
        ("/dev/null", "no regular file"),
        ("loads.csv/found.json", "cannot write"),
    ],
)
def test_no_verb_replaces_a_file_or_begins_where_its_result_cannot_be_written(
    run: Run, desk: Path, verb: str, result: str, says: str
) -> None:
    before = bytes_of(desk)
    words = NEEDED.get(verb, "").split()
    fails(run, 5, "OutputError", verb, *words, "--json", result, says=says)
    assert bytes_of(desk) == before
    assert Path("/dev/null").is_char_device()


@OVERWRITTEN.mark
@pytest.mark.parametrize(
    "words",
    [
        "calibrate loads.csv --out loads.csv",
        "calibrate loads.csv --out ./trials/../loads.csv",
        "calibrate loads.csv --out link.csv",
        "calibrate loads.csv --out new.json --json loads.csv",
        "calibrate loads.csv --out new.json --json new.json",
        "calibrate loads.csv --out new.json/a.json --json new.json",
        "evaluate m.onnx --data trials --report m.onnx",
        "evaluate m.onnx --data trials --report m.json",
        "evaluate m.onnx --data trials --report r.html --json r.html",
        "bias --source loads.csv --out loads.csv",
        "bias --source sim://loads.csv?seed=1 --out loads.csv",
        "doctor m.onnx --json m.onnx",
        "adapt m.onnx --undo --out link.onnx",
        "adapt m.onnx --undo --out new.onnx --json new.json",
        "export m.onnx --rule evidence_ms=300 --out m.onnx",
        "export m.onnx --rule evidence_ms=300 --out new.onnx --json new.json",
        "train --data trials --out new --json new/holdfast.json",
        "simulate thesis --trials 1 --out new --json new/meta.json",
        "convert trials --to mcap --out new --json new/meta.json",
    ],
)
def test_an_input_and_another_output_are_never_replaced_not_even_with_force(
    run: Run, desk: Path, words: str
) -> None:
    for name in ("m.onnx", "loads.csv"):
        (desk / f"link.{name.partition('.')[2]}").symlink_to(name)
    before = bytes_of(desk)
    says = "next: name another file"
    fails(run, 5, "OutputError", *words.split(), "--force", says=says)
    assert bytes_of(desk) == before


@OVERWRITTEN.mark
@pytest.mark.parametrize(
    "words",
    [
        "calibrate loads.csv --out kept.json",
        "bias --source virtual://ft232h --out kept.json",
        "adapt m.onnx --undo --out kept.onnx",
        "export m.onnx --rule evidence_ms=300 --out kept.onnx",
        "evaluate m.onnx --data trials --report kept.json",
        "train --data trials --out build",
        "bench latency --out build",
    ],
)
def test_a_file_beside_the_one_that_is_named_is_not_replaced_without_force(
    run: Run, desk: Path, words: str
) -> None:
    for name in ("build/holdfast.onnx", "build/latency.json"):
        write_whole(desk / name, "kept")
    before = bytes_of(desk)
    fails(run, 5, "OutputError", *words.split(), says="exists already")
    assert bytes_of(desk) == before


@OVERWRITTEN.mark
@pytest.mark.parametrize(
    "words",
    [
        "run --source nowhere.csv --to new.jsonl --to new.csv",
        "run --source virtual://ft232h --to new.jsonl --to new.jsonl",
        "run --source virtual://ft232h --bias m.json --to new.jsonl --to new.csv",
        "record --source virtual://ft232h?fault=nack:2@0%2B99 --out new --person p01 "
        "--object cup --action pull --at-once --seconds 2",
    ],
)
def test_a_verb_that_is_refused_leaves_nothing_behind(
    run: Run, desk: Path, words: str
) -> None:
    before = sorted(desk.iterdir())
    assert run(*words.split())[0] > 1
    assert sorted(desk.iterdir()) == before
