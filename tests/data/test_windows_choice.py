"""The choice "dense": closer windows where a phase begins, few of a slip that lasts."""

from __future__ import annotations

import numpy as np

from holdfast.core.contract import GRASP, NOTHING, RISKY_SLIP
from holdfast.data.recording import Recording
from holdfast.data.timeline import Phase
from holdfast.data.windows import MOST_RISKY, TimedTrial, windows_of

RATE_HZ = 100.0


def a_trial(*phases: Phase) -> TimedTrial:
    length = phases[-1].stop
    recording = Recording(
        trial_id="one",
        group="one",
        samples=np.zeros((length, 18)),
        valid=np.ones((length, 6), np.bool_),
        rate_hz=RATE_HZ,
        unit="N",
        object_name="mug",
        phases=phases,
    )
    return TimedTrial(recording, heavy=False, timed=True)


def rows_of(trial: TimedTrial, situation: int) -> list[int]:
    table = windows_of([trial], "dense")
    return table[table.label == 2 * situation].row.tolist()


def test_windows_are_two_hundredths_of_a_second_apart_while_a_phase_begins() -> None:
    trial = a_trial(Phase(0, 100, NOTHING), Phase(100, 300, GRASP))
    begins = [row for row in rows_of(trial, GRASP) if row < 140]
    assert begins == list(range(100, 140, 2))


def test_a_slip_that_lasts_gives_its_first_windows_and_others_evenly_spaced() -> None:
    trial = a_trial(Phase(0, 100, GRASP), Phase(100, 600, RISKY_SLIP))
    rows = rows_of(trial, RISKY_SLIP)
    assert len(rows) == MOST_RISKY
    assert rows[: MOST_RISKY // 2] == list(range(100, 100 + MOST_RISKY // 2))
    assert rows[-1] == 599


def test_no_window_ends_before_the_history_is_whole() -> None:
    trial = a_trial(Phase(0, 100, NOTHING), Phase(100, 200, GRASP))
    assert min(rows_of(trial, NOTHING)) == 50
