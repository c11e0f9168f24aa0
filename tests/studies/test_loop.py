"""`python -m studies loop SCENE`: figures of controllers on a scene; bad input is one line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from command_line import Run, fails
from loop_bench import MODEL, SLOWER, card_text, row

CARD = card_text(
    row("pass", "count = 2\n"),
    row("fall", "weak_grip = 0.5\n", "hard-ball"),
    '[[trials]]\naction = "nothing"\nlasts_s = 1\n',
    rate_hz=50,
)
KEYS = (
    "preventable",
    "saved_share",
    "handovers",
    "blocked_share",
    "slip_mm_p50",
    "extra_force_n_p50",
    "extra_delay_ms_p95",
    "crushed_share",
    "grip_excess",
)


def written(folder: Path, text: str, name: str = "mine") -> Path:
    path = folder / f"{name}.toml"
    path.write_text(text, encoding="utf-8")
    return path


def looped(
    study: Run, folder: Path, text: str, *words: object
) -> tuple[str, dict[str, Any]]:
    """(what was printed, the JSON) of a run on a card."""
    out = folder / "loop.json"
    options = ("--model", SLOWER, "--jobs", 1, "--json", out, *words)
    code, printed, err = study("loop", written(folder, text), *options)
    assert code == 0, err
    assert "Traceback" not in err
    return printed, json.loads(out.read_text("utf-8"), parse_constant=pytest.fail)


def test_the_figures_of_every_controller_are_written_and_printed(
    study: Run, tmp_path: Path
) -> None:
    words = ("--controller", "holdfast", "oracle", "--lag-ms", 20, "--seed", 3)
    page = tmp_path / "report.html"
    printed, written_json = looped(study, tmp_path, CARD, *words, "--report", page)
    assert (written_json["kind"], written_json["lag_ms"], written_json["seed"]) == (
        "simulated",
        20.0,
        3,
    )
    rows = written_json["sets"]["mine"]
    assert set(rows) == {"holdfast", "oracle"}
    for name, figures in rows.items():
        assert set(KEYS) <= set(figures)
        assert {f"{key}_ci" for key in KEYS if key.endswith("share")} <= set(figures)
        assert (figures["trials"], figures["handovers"], figures["preventable"]) == (
            3,
            2,
            1,
        )
        assert figures["crushed_share"] is figures["crushed_share_ci"] is None
        assert f"  {name}" in printed
    assert rows["oracle"]["saved_share"] == 1.0
    assert "of 2 hand-overs blocked" in printed
    assert "(simulated)" in printed
    text = page.read_text("utf-8")
    saved = f"{rows['holdfast']['saved']} of 1 preventable drop saved by holdfast"
    assert f"<h1>{saved}</h1>" in text
    assert text.count("<svg") == text.count("<h3>") >= 2


def test_what_no_hand_can_hold_is_an_outcome(study: Run, tmp_path: Path) -> None:
    slippery = '[objects."soap"]\nmass_g = 2000\nfriction = 0.05\nhalf_length_mm = 80\n'
    beyond = row("pull", "cap_n = 400\narm_n_per_m = 100000\ndistance_m = 1\n")
    text = card_text(row("fall", "", "soap"), beyond, effects=slippery, rate_hz=50)
    _, made = looped(study, tmp_path, text, "--controller", "holdfast")
    figures = made["sets"]["mine"]["holdfast"]
    assert (figures["drops"], figures["preventable"], figures["saved_share"]) == (
        2,
        0,
        None,
    )


@pytest.mark.parametrize(
    ("code", "kind", "words", "says"),
    [
        (2, "UsageError", ["thesis", "--controller", "pid"], "'pid' does not exist"),
        (3, "CardError", ["no-such-card"], "no scene 'no-such-card'"),
        (3, "ChannelError", ["twenty-sensors"], "the model needs 18"),
    ],
)
def test_bad_input_is_one_line(
    study: Run, code: int, kind: str, words: list[str], says: str
) -> None:
    fails(study, code, kind, "loop", *words, "--model", MODEL, "--jobs", 1, says=says)


def test_a_card_in_another_unit_or_at_another_rate_is_refused(
    study: Run, tmp_path: Path
) -> None:
    magnet = card_text(row("pull"), effects="[effects.dipole]\n")
    fields = written(
        tmp_path, magnet.replace("150\n", '150\nunit = "uT"\n', 1), "fields"
    )
    slow = written(tmp_path, CARD.replace("rate_hz = 50", "rate_hz = 100"), "slow")
    fails(
        study,
        3,
        "UnitError",
        "loop",
        fields,
        "--model",
        MODEL,
        says="the model needs N",
    )
    fails(
        study,
        3,
        "RateError",
        "loop",
        slow,
        "--model",
        MODEL,
        says="the model needs 150 Hz",
    )


@pytest.mark.parametrize("lag", ["-1", "nan", "inf", "1001", "soon"])
def test_a_lag_that_is_none_is_refused(study: Run, lag: str) -> None:
    code, _, err = study("loop", "thesis", "--lag-ms", lag)
    assert code == 2
    assert "is not a lag from 0 to 1000 ms" in err
    assert "Traceback" not in err


def test_without_a_scene_the_options_of_a_comparison_are_refused(study: Run) -> None:
    words = ("loop", "--controller", "oracle")
    fails(study, 2, "UsageError", *words, says="--controller needs a scene")


def test_the_word_that_was_a_verb_names_the_study(run: Run) -> None:
    fails(run, 2, "UsageError", "loop", "thesis", says="python -m studies loop")
