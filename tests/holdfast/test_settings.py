"""Settings of a hand in a file: they stand in for what is not typed, and what is typed wins."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import Run, fails

HAND = 'source = "virtual://ft232h"\n'
SOON = ("--seconds", "1")
"""A bias is measured on the clock of the machine."""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder that a command is given in; returns its file of settings, not there yet."""
    monkeypatch.chdir(tmp_path)
    return tmp_path / "holdfast.toml"


def test_a_command_takes_its_source_from_the_settings_here(
    run: Run, here: Path
) -> None:
    here.write_text(HAND)
    code, _, err = run("bias", "--out", "bias.json", *SOON)
    assert code == 0, err
    assert Path("bias.json").is_file()


def test_settings_elsewhere_are_named(run: Run, here: Path) -> None:
    other = here.parent / "left.toml"
    other.write_text(HAND)
    assert run("bias", "--out", "bias.json")[0] == 2
    for words in (("--config", other), (f"--config={other}",)):
        assert run("bias", "--out", f"{len(words)}.json", *SOON, *words)[0] == 0


def test_files_are_looked_for_beside_the_settings(run: Run, here: Path) -> None:
    other = here.parent / "hands" / "left.toml"
    other.parent.mkdir()
    other.write_text(f'{HAND}model = "mine.onnx"\n')
    _, _, err = run("run", "--config", other)
    assert str(other.parent / "mine.onnx") in err


def test_outputs_are_of_a_run_and_typed_ones_stand_in_their_place(
    run: Run, here: Path
) -> None:
    here.write_text(f'{HAND}to = ["today.jsonl", "none"]\nceiling_n = 40\n')
    assert run("run", *SOON)[0] == 0
    assert Path("today.jsonl").stat().st_size > 0
    assert run("run", *SOON, "--to", "other.jsonl")[0] == 0
    assert Path("other.jsonl").stat().st_size > 0
    assert run("bias", "--out", "bias.json", *SOON)[0] == 0


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('sauce = "virtual://ft232h"', "sauce"),
        ("source = 3", "source = 3"),
        ('ceiling_n = "x"', "ceiling_n = 'x'"),
        ("source = ", "not valid TOML"),
        ("[rules]\nfrom = 0.5", "from_p, full_p, rise_n, follow_n, most_over_n, floor"),
        ("[rules]\nfrom_p = 1.5", "from_p = 1.5; next: allowed: a number from 0.001"),
        ('[rules]\nrise_n = "6"', "rise_n = '6'"),
        ("rules = 3", "rules = 3"),
        (
            "most_over_wearers_n = 5\n[rules]\nmost_over_n = 5",
            "most_over_wearers_n and most_over_n of [rules] are the same",
        ),
    ],
)
def test_a_wrong_setting_is_named_with_its_file(
    run: Run, here: Path, text: str, says: str
) -> None:
    here.write_text(text)
    fails(run, 3, "CardError", "bias", "--out", "b.json", says=says)
    assert "holdfast.toml" in run("bias")[2]


def test_the_rules_of_the_settings_are_those_of_the_grip(run: Run, here: Path) -> None:
    here.write_text(
        'source = "virtual://ft232h?scene=falling-bottle"\n[rules]\nfrom_p = 0.9'
    )
    words = ("run", "--grip", "virtual")
    fails(run, 2, "UsageError", *words, says="from_p = 0.9 is not below full_p")


def test_settings_that_are_not_there_are_an_error_only_if_they_are_named(
    run: Run, here: Path
) -> None:
    fails(run, 3, "DataNotFound", "bias", "--config", "left.toml", says="left.toml")
    fails(run, 2, "UsageError", "bias", "--out", "b.json", says="--source")
