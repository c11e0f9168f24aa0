"""Reader of grip_lift_ati: people lift an object with two fingertips on two force transducers.

A. Raj Kumar et al., "Grasp Rehabilitator: A Mechatronic Approach", Design of Medical Devices
Conference, DMD2019-3242 (2019), Apache-2.0. Nothing falls: the set says how often a model alarms
in plain lifts by people, and not whether it finds slips.

A recording is a whole file, about ten lifts without a break, at 600 Hz averaged down to the rate
that is asked for. `lifts.csv` says when each contact begins and ends, by the force on the orange
transducer, and what both read at rest. Where the yellow normal force is broken (`yellow_ok` false),
a lift is no window and no minute, from its from_s to its to_s: with two sensors a lost one makes
the answer unknown, which cannot alarm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.contract import GRASP, NOTHING, FloatArray, averaged_by
from holdfast.core.errors import EmptyRecording, RateError
from holdfast.core.hand_card import fill_unmeasured, read_hand_card
from holdfast.data.datasets.public_files import PublicSet, read_arrays
from holdfast.data.datasets.thesis import SetMeta
from holdfast.data.recording import Recording, finite_sensors
from holdfast.data.timeline import Phase, Phases
from holdfast.data.windows import TimedTrial
from holdfast.edge_runtime.preparation import Preparation

NAME = "grip_lift_ati"
LIFTS = "lifts.csv"
RECORDED_HZ = 600.0
USUAL_HZ = 150.0
CARD = "two-transducers"
"""The hand card with these sensors."""
COLUMN_OF = [2, 2, 0, 3, 3, 1]
"""The column of a file for each channel: yellow x, y, z, then orange. x is not measured."""
RESTS = ["rest_yellow_grip_n", "rest_orange_grip_n"]
RESTS += ["rest_yellow_load_n", "rest_orange_load_n"]
"""Columns of lifts.csv: what a column of a file reads at rest, in the order of the columns."""
ABOUT = SetMeta(
    unit="N",
    kind="real, recorded by others: people lift an object with two fingertips",
    name=NAME,
    redistributable=True,
    caveat="No slip was marked and nothing fell: small slips may hide in these lifts. Two "
    "sensors, without a force along the third axis; both loads together are 0.88 of the weight.",
)
LICENCE = "Apache-2.0"
SOURCE = (
    "github.com/rashwinr/grasp-rehabilitator, commit "
    "3a17224f424b08060bffc04fb05899b51dd7318d, COI_DATA/ATI"
)


def is_ours(root: Path) -> bool:
    """Whether its table of lifts is there."""
    return (root / LIFTS).is_file()


def about(root: Path) -> PublicSet:
    """Six channels (two sensors), unit N, people as groups."""
    channels = (len(COLUMN_OF),)
    return PublicSet(ABOUT, channels, Preparation(), CARD, LICENCE, SOURCE)


def trials(root: Path, rate_hz: float | None) -> list[TimedTrial]:
    """The recordings. rate_hz: 600 Hz divided by a whole number; None for 150.

    Nothing from from_s to to_s of a lift, grasp while the contact lasts. The masses are not used:
    all are heavy. Raises RateError or EmptyRecording.
    """
    import pandas as pd  # a third of a second, which sets in other formats do not need

    wanted_hz = rate_hz or USUAL_HZ
    averaged = averaged_by(RECORDED_HZ, wanted_hz)
    if averaged == 0:
        raise RateError(
            f"{RECORDED_HZ:g} Hz is no whole multiple of {wanted_hz:g} Hz",
            where=root,
            cause=f"a model for a rate that {NAME} cannot be averaged to",
            next_step="use a model for 150, 100 or 50 Hz",
        )

    table = pd.read_csv(root / LIFTS)
    found = []
    for person, of_person in table.groupby("person"):
        files = sorted(of_person["file"].unique())
        for file, raw in zip(
            files, read_arrays(root / f"{person}.npz", *files), strict=True
        ):
            lifts = of_person[of_person["file"] == file]
            trial = _trial(str(person), str(file), raw, lifts, averaged)
            found.append(replace(trial, averaged=averaged))
    if not found:
        raise EmptyRecording(
            f"no lift in {LIFTS}", where=root, next_step="copy the data set again"
        )

    return found


def _trial(
    person: str, file: str, raw: FloatArray, lifts: Any, averaged: int
) -> TimedTrial:
    """One file with its lifts. raw [T, 4] at 600 Hz; lifts: its lines of lifts.csv."""
    rest = lifts[RESTS].iloc[0].to_numpy()
    forces = _means(raw.astype(np.float64) - rest, averaged)
    samples = fill_unmeasured(forces[:, COLUMN_OF], read_hand_card(CARD))
    rate_hz = RECORDED_HZ / averaged
    good = lifts["yellow_ok"].to_numpy(dtype=bool)
    broken = _rows(lifts[~good], ["from_s", "to_s"], rate_hz, len(samples))
    recording = Recording(
        trial_id=f"{person}/{file}",
        group=person,
        samples=samples,
        valid=finite_sensors(samples),
        rate_hz=rate_hz,
        unit="N",
        object_name=str(lifts["object"].iloc[0]),
        action="lift",
        phases=_phases(lifts[good], rate_hz, len(samples)),
        left_out=tuple((first, stop) for first, stop in broken),
        person=person,
    )
    return TimedTrial(
        recording,
        heavy=None,
        timed=True,
        labels_by="contact by force",
        averaged=averaged,
    )


def _means(values: FloatArray, averaged: int) -> FloatArray:
    """[T, C] -> [T / averaged, C], the means of so many rows; the last ones are dropped."""
    whole = len(values) // averaged * averaged
    return values[:whole].reshape(-1, averaged, values.shape[1]).mean(axis=1)


def _phases(lifts: Any, rate_hz: float, n_rows: int) -> Phases:
    """Nothing before and after each contact, grasp within it, in rows."""
    phases: list[Phase] = []
    names = ["from_s", "contact_s", "release_s", "to_s"]
    for begin, contact, release, end in _rows(lifts, names, rate_hz, n_rows):
        # A lift ends a little after the next one begins.
        first = max(begin, phases[-1].stop) if phases else begin
        parts = [(first, contact, NOTHING), (contact, release, GRASP)]
        for start, stop, situation in [*parts, (release, end, NOTHING)]:
            if start < stop:
                phases.append(Phase(start, stop, situation))
    return tuple(phases)


def _rows(
    lifts: Any, names: Sequence[str], rate_hz: float, n_rows: int
) -> list[list[int]]:
    """The times of these columns as rows, a list a lift."""
    rows = np.rint(lifts[names].to_numpy() * rate_hz).astype(np.int64)
    listed: list[list[int]] = np.minimum(rows, n_rows).tolist()
    return listed
