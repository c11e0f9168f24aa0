"""The report of one evaluation: its pictures, and what its template shows.

The template is templates/evaluation.html; the order of its sections is the order of the report.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from holdfast.evaluation import pictures as draw
from holdfast.evaluation.figures import Evaluation
from holdfast.evaluation.formats import DEPLOYED, LAWS, ORACLE, onsets_in_words
from holdfast.evaluation.html import write_page
from holdfast.evaluation.real_sets import RealFigures, RealSetsMissing
from holdfast.training.figures import PLURAL


def write_event_report(
    path: Path,
    evaluation: Evaluation,
    real: RealFigures | RealSetsMissing | None = None,
) -> Path:
    """Write the report; OutputError where that cannot be done. real: of real recordings, if any."""
    of = evaluation

    headline = evaluation.thresholds.headline
    kind = kind_of(of)
    drawn = {}
    for title, rows in of.drawn.items():
        drawn[title] = draw.timelines(rows, kind)

    # Where a model has seen what is evaluated, the headline must say so.
    seen = []
    recordings = []
    for one in of.sets.values():
        seen.append(one.card.trained_on_recordings)
        recordings.append(one.card.recordings)

    return write_page(
        path,
        "evaluation.html",
        of=of,
        kind=kind,
        short_kind=_in_short(of),
        timed=any(one.card.timed for one in of.sets.values()),
        headline=headline,
        deployed=DEPLOYED,
        oracle=ORACLE,
        laws=LAWS,
        ours=of.rows[headline],
        parts=_parts(of),
        cards={name: one.card for name, one in of.sets.items()},
        simulated_sets=_simulated_sets(of),
        trained_on=sum(seen),
        n_recordings=sum(recordings),
        least_events=draw.LEAST_EVENTS,
        resampled=_resampled(of),
        timelines=drawn,
        central_picture=draw.trial(of.central, kind) if of.central else "",
        distributions=draw.distributions(of.times, kind),
        state_pictures=_state_pictures(of, kind),
        real=real if isinstance(real, RealFigures) else None,
        real_missing=real if isinstance(real, RealSetsMissing) else None,
        onsets_in_words=onsets_in_words,
    )


def kind_of(of: Evaluation) -> str:
    """The kind of the data (simulated, recorded), which stands next to every number."""
    kinds = [one.card.kind for one in of.sets.values()]
    # Each kind once, in the order of the sets.
    return ", ".join(dict.fromkeys(kinds))


def _in_short(of: Evaluation) -> str:
    """The first word of each kind, for where the whole of it has no room."""
    kinds = [re.split("[,:]", one.card.kind)[0] for one in of.sets.values()]
    return ", ".join(dict.fromkeys(kinds))


def _simulated_sets(of: Evaluation) -> list[str]:
    """The names of the sets that no hand recorded."""
    # A set's kind begins with the word, as in "simulated: a hand over a scene".
    names = []
    for name, one in of.sets.items():
        # A folder of recordings has another word there, such as "recorded".
        if one.card.kind.startswith("simulated"):
            names.append(name)
    return names


def _parts(of: Evaluation) -> dict[str, Any]:
    """Title -> what has rows and comparisons: all sets together, then each set."""
    # All sets together are the same as the only one.
    if len(of.sets) == 1:
        return dict(of.sets)
    return {"all sets": of, **of.sets}


def _resampled(of: Evaluation) -> str:
    """What the intervals resample, such as people, or people and trials of several sets."""
    # Sets of people and sets of trials have different groups to draw.
    kinds = sorted({one.card.group_kind for one in of.sets.values()})
    return " and ".join(PLURAL[kind] for kind in kinds)


def _state_pictures(of: Evaluation, kind: str) -> dict[str, str]:
    """Caption -> picture: the confusion of the first set, the calibration of every set."""
    first, figures = next(iter(of.sets.items()))
    calibrated = {}
    for name, one in of.sets.items():
        # A set without labelled samples has no calibration.
        if one.states.calibration:
            calibrated[name] = one.states.calibration.reliability_risky

    pictures = {}
    for level, confusion in figures.states.confusion.items():
        pictures[f"{level} classes, {first}"] = draw.confusion(confusion, kind)
    if calibrated:
        pictures["calibration"] = draw.reliability(calibrated, kind)
    return pictures
