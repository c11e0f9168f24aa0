"""Lifts in which nothing slips: when the hand touches something, and when it is empty.

A recording may hold many lifts, one after the other. It begins with the open hand. In N contact is
what the model's own contact rule calls so (ContactRule in step/spec.py). A force in another unit
has no threshold of its own: there contact begins above six times the noise of the first rest, with
the same hysteresis, mean and zero.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from holdfast.core.contract import GRASP, NOTHING, BoolArray, FloatArray, Unit
from holdfast.core.errors import LabelError
from holdfast.data.recording import runs_of
from holdfast.data.timeline import Phase, Phases
from holdfast.step.spec import (
    LEAST_MEAN,
    MEAN_S,
    OFF_SHARE,
    ON_SHARE,
    ZERO_S,
    ZERO_SHARE_PER_S,
    ContactRule,
    StepSpec,
)

LIFT = "lift"
"""The action."""
REST_S = 0.5
"""The hand must be open for so long at the beginning of a recording."""
NOISES = 6.0
"""Contact begins above so many times the noise, where the unit has no threshold."""
QUESTION = (
    "write its phases to its .truth.json, or move the trial out of the set; of a log: import it "
    'with --action "lift=hold" if it is one long hold'
)


def contact_rule(
    samples: FloatArray, valid: BoolArray, rate_hz: float, unit: Unit
) -> ContactRule:
    """When a hand touches something in a recording: samples [T, C], prepared; valid [T, C/3]."""
    spec = _spec(valid, rate_hz, unit)
    if spec.contact is not None:
        return spec.contact

    rest = round(REST_S * rate_hz)
    channels = np.repeat(valid[:rest].all(axis=0), 3)
    noise = math.sqrt(samples[:rest, channels].var(axis=0).sum())
    # a reading in whole steps may rest without any noise
    steps = np.abs(np.diff(np.nan_to_num(samples), axis=0))
    least = float(steps[steps > 0.0].min(initial=np.inf))
    on = NOISES * max(noise, least if np.isfinite(least) else 0.0)
    return ContactRule(
        on=on,
        off=on * OFF_SHARE / ON_SHARE,
        mean_s=max(MEAN_S, LEAST_MEAN / rate_hz),
        zero_s=ZERO_S,
        zero_per_s=on * ZERO_SHARE_PER_S / ON_SHARE,
    )


def lift_phases(
    samples: FloatArray,
    valid: BoolArray,
    rate_hz: float,
    unit: Unit,
    where: Path | str,
) -> Phases:
    """Grasps while the hand touches something, nothing while it is empty; samples and valid so.

    Rows at which too many sensors are lost have no label. Raises LabelError where no contact is
    found, or one in the first REST_S: then a person has to say what happens.
    """
    spec = _spec(valid, rate_hz, unit)
    # onnx, which a conversion of trials need not load
    from holdfast.step.guard import reference_contact, reference_flags

    rule = contact_rule(samples, valid, rate_hz, unit)

    # A rest before the first row, because the rule knows nothing until its history is whole.
    before = spec.settle_samples
    values = np.concatenate([np.zeros((before, samples.shape[1])), samples])
    there = np.concatenate([np.ones((before, valid.shape[1]), np.bool_), valid])
    is_empty, _ = reference_contact(values, there, spec, rule)
    unknown = reference_flags(values, there, spec)["unknown"]
    empty = is_empty[before:]
    touching = ~empty & ~unknown[before:]

    first = round(REST_S * rate_hz)
    what = ""
    if not touching.any():
        what = f"no contact found: nothing above {rule.on:.3g} {unit}"
    elif touching[:first].any():
        what = f"the hand touches something in the first {REST_S:g} s"
    if what:
        raise LabelError(
            what,
            where=where,
            cause="a lift begins and ends with the open hand, and its forces exceed their noise",
            next_step=QUESTION,
        )

    phases = []
    for flags, situation in ((empty, NOTHING), (touching, GRASP)):
        for row, stop in zip(*map(np.ndarray.tolist, runs_of(flags)), strict=True):
            phases.append(Phase(row, stop, situation))
    return tuple(sorted(phases, key=lambda phase: phase.first))


def _spec(valid: BoolArray, rate_hz: float, unit: Unit) -> StepSpec:
    """A step of the whole hand, which as in a model of pooled features needs two thirds of it."""
    n_sensors = valid.shape[1]
    least = -(-2 * n_sensors // 3)
    return StepSpec(n_sensors, rate_hz, unit, ("now",), least)
