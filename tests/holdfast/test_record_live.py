"""While a trial is recorded: what the operator sees, and what happens when the source or its scene
ends."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hazard_marks import OVERWRITTEN, SOURCE_ENDED
from recorder_bench import TRIAL, Hand, meta_of, recorded, said, session, states_in
from recorder_bench import columns_of as read_columns

from holdfast.core.errors import EmptyRecording
from holdfast.drivers.virtual.faults import VirtualClock
from holdfast.sessions.recorder.plan import Task
from holdfast.sessions.recorder.terminal import OVER_THE_LINE_ABOVE, Display, StatusLine

SHORT_SCENE = """
[record]
rate_hz = 100
[[trials]]
objects = ["soft-ball"]
action = "pull"
close_at_s = 1.6
hold_s = 0.8
tail_s = 0.6
[effects.brush]
count = 3
[effects.dipole]
"""


# -- the source or its scene ends


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "short.toml"
    path.write_text(SHORT_SCENE, encoding="utf-8")
    return path


@SOURCE_ENDED.mark
@pytest.mark.parametrize(
    "samples",
    [35, 60, 82],
    ids=["before the hand closed", "in the grip", "as it opened"],
)
def test_a_trial_whose_source_ended_before_it_was_complete_is_not_kept_and_says_so(
    tmp_path, samples
):
    messages: list[str] = []
    display = Display(messages.append)
    hand = Hand(samples)
    with pytest.raises(EmptyRecording, match="cannot be kept"):
        session(tmp_path, hand, display=display)
    folder = tmp_path / TRIAL
    assert (meta_of(folder)["state"], meta_of(folder)["quality"]["samples"]) == (
        "interrupted",
        samples,
    )
    assert meta_of(folder)["why"] == "the source ended before the trial was complete"
    assert said(messages, "not kept, it will be recorded again: the source ended")
    assert not (folder / "tactile.truth.json").exists()


def test_a_source_that_ends_with_the_hand_empty_again_leaves_a_kept_trial(tmp_path):
    assert session(tmp_path, Hand(120))[0] == 1
    assert session(tmp_path, Hand(35), [Task("nothing", "nothing")])[0] == 1


def test_a_scene_that_is_recorded_from_end_to_end_is_kept_and_comes_again_with_every_trial(
    tmp_path, scene
):
    words = "--object soft-ball --action pull --trials 2"
    recorded(tmp_path / "out", *words.split(), source=f"sim://{scene}")
    assert states_in(tmp_path) == ["kept", "kept"]


# -- what the operator sees


class Terminal:
    """A sink that draws as a terminal does; at most `takes` lines are taken."""

    def __init__(self, takes: int = 10**9) -> None:
        self.takes, self.lines, self.drawn = takes, list[str](), list[str]()

    def __call__(self, text: str) -> bool:
        self.takes -= 1
        if self.takes < 0:
            return False
        if text.startswith(OVER_THE_LINE_ABOVE):
            self.lines.pop()
        self.lines.append(text.removeprefix(OVER_THE_LINE_ABOVE))
        self.drawn += [self.lines[-1]] if "lost; forces" in text else []
        return True


def shown(
    out: Path, terminal: Callable[[str], bool], columns: int = 80, **hand: object
) -> None:
    """One trial of 1.2 s at 100 Hz before a terminal."""
    clock, status = VirtualClock(), StatusLine(terminal, lambda: columns, seconds=1.2)
    source = Hand(130, clock=clock, **hand)  # type: ignore[arg-type]
    bias = 0.001 * np.arange(18.0)
    session(out, source, seconds=1.2, display=status, bias=bias)


@pytest.mark.parametrize("takes", [0, 1, 3, 5])
def test_a_terminal_that_takes_nothing_costs_no_sample(tmp_path, takes):
    shown(tmp_path / "a", Terminal())
    shown(tmp_path / "b", Terminal(takes))
    free, stuck = (read_columns(tmp_path / one / TRIAL) for one in "ab")
    assert stuck["sequence"] == free["sequence"]
    assert states_in(tmp_path / "b") == ["kept"]


@OVERWRITTEN.mark
def test_what_a_person_wrote_beside_an_object_s_mass_stays(tmp_path):
    about = tmp_path / "p01/soft-ball/meta.json"
    about.parent.mkdir(parents=True)
    about.write_text('{"mass_g": 80, "colour": "red"}')
    hand, mass_g = Hand(99), {"soft-ball": 91.5}
    kept, _ = session(tmp_path, hand, seconds=0.5, mass_g=mass_g)
    assert kept == 1
    assert json.loads(about.read_text()) == {"mass_g": 91.5, "colour": "red"}
