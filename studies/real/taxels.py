"""Which taxels of human_slip_uskin a row of a table reads, and the timing-only baseline's input."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from holdfast.core.contract import FloatArray, IntArray
from holdfast.core.hand_card import read_hand_card
from holdfast.training.datasets.human_slip_labels import CONTACT_N, contact_force_n
from holdfast.training.datasets.human_slip_uskin import N_TAXELS
from holdfast.training.datasets.public_files import channels_of
from holdfast.training.recording import DataSet, LabelledRows

PAD_COLUMNS = 4
FIRST_SPREAD_TAXEL = 2
"""Where the spread begins: any taxel of the upper edge but a corner (docs/on-a-hand.md)."""
SPREAD_TAXELS_CARD = "pinch-pad-spread"
"""The hand card with six taxels that `spread_taxels` gives, whatever they bear."""


def spread_taxels(count: int) -> tuple[int, ...]:
    """So many taxels of the 4 x 4 pad, counted from 1, spread by a rule that sees no reading.

    The rule is the farthest-point spread (T. F. Gonzalez, "Clustering to minimize the maximum
    intercluster distance", 1985): begin with one taxel, then always add the one that is farthest
    from all that are chosen. Of equally far ones it adds the last.

    >>> spread_taxels(6)
    (2, 5, 8, 11, 13, 16)
    """
    row, column = np.divmod(np.arange(N_TAXELS), PAD_COLUMNS)
    chosen = [FIRST_SPREAD_TAXEL - 1]

    while len(chosen) < count:
        # squares of whole numbers, so that equal distances compare as equal
        down = row[:, None] - row[chosen]
        right = column[:, None] - column[chosen]
        squares = down**2 + right**2

        # a taxel is as far as the nearest chosen one; those that are chosen have 0
        nearest = squares.min(axis=1)
        farthest = np.flatnonzero(nearest == nearest.max())
        chosen.append(int(farthest[-1]))

    return tuple(taxel + 1 for taxel in sorted(chosen))


def with_taxels(data: DataSet, taxels: Sequence[int], card: str) -> DataSet:
    """The set of all 48 channels with these taxels alone, counted from 1; its labels stay."""
    sensors = [taxel - 1 for taxel in taxels]
    columns = channels_of(sensors)
    recordings = []
    for one in data.recordings:
        samples, valid = one.samples[:, columns], one.valid[:, sensors]
        recordings.append(replace(one, samples=samples, valid=valid))
    return replace(data, recordings=recordings, hand=read_hand_card(card))


def frames_since_contact(force_n: FloatArray, contact_n: float = CONTACT_N) -> IntArray:
    """[T] rows since z last rose through contact_n, -1 before: the timing of a scripted set."""
    touching = force_n >= contact_n
    touched_before = np.concatenate([[False], touching[:-1]])
    rises = touching & ~touched_before

    row = np.arange(len(force_n))
    last_rise = np.maximum.accumulate(np.where(rises, row, -1))
    return np.where(last_rise >= 0, row - last_rise, -1)


def clock_features(data: DataSet, rows: LabelledRows) -> FloatArray:
    """[M, 2]: frames since contact and normal force z in N, at each window.

    Contact: the last rise of z through 1 N; -1 before any. data: all 48 channels, because z sums
    all 16 normals.
    """
    features = np.empty((len(rows), 2))
    for trial in np.unique(rows.trial):
        here = rows.trial == trial
        force_n = contact_force_n(data.recordings[trial].samples)
        both = np.column_stack([frames_since_contact(force_n), force_n])
        features[here] = both[rows.row[here]]
    return features
