"""Distortions of whole fingers: sensors that die in a hold, fingers that do not touch."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from holdfast.core.hand_card import SIDES
from holdfast.simulation.effects.effect import Plan, Rows
from studies.distortions.chain import EARLIEST_S, LATEST_S
from studies.distortions.law import Memory, PlanRequest

DEAD_NOISE_N = 0.05
"""Noise of a sensor that reads nothing else, N rms."""
Fault = Literal["invalid", "last value", "noise"]


@dataclass(frozen=True)
class DeadFingers:
    """So many sensors, drawn a trial, die at one moment of the hold.

    fault: "invalid", marked so, and the reading stands still; "last value", it stands still and
    nothing marks it; "noise", it is the resting reading with noise, and nothing marks it.
    """

    count: int
    fault: Fault
    remembers = True

    def plan(self, request: PlanRequest) -> Plan:
        """Which sensors are dead at every sample, and what noise they read."""
        which = request.rng.permutation(request.sensors)[: self.count]
        at_s = request.rng.uniform(EARLIEST_S, LATEST_S)
        dead = np.zeros((len(request.t_s), request.sensors), dtype=np.bool_)
        dead[:, which] = (request.t_s >= at_s)[:, None]
        noise = request.rng.normal(size=(*dead.shape, 3))
        return {"dead": dead, "noise_n": DEAD_NOISE_N * noise}

    def apply(self, rows: Rows, plan: Plan, memory: Memory) -> tuple[Rows, Memory]:
        """Memory: the first reading, which is at rest, and the last output."""
        resting, last = (rows.values, rows.values) if memory is None else memory
        reads = resting + plan["noise_n"] if self.fault == "noise" else last
        dead = plan["dead"]
        values = np.where(dead[..., None], reads, rows.values)
        valid = rows.valid
        if self.fault == "invalid":
            valid = valid & ~dead
        return Rows(values, valid), (resting, values)


@dataclass(frozen=True)
class FewerFingers:
    """Forces before the sensors: only these sensors touch, and share what their side bears evenly.

    touching: their numbers from 0; at least one of the thumb and one of the fingers.
    """

    touching: tuple[int, ...]
    remembers = False

    def plan(self, request: PlanRequest) -> Plan:
        """[1, S, S] from forces to forces: what each sensor gets of each."""
        shares = np.zeros((request.sensors, request.sensors))
        for side in SIDES:
            of_side = [k for k, here in enumerate(request.sides) if here == side]
            touching = [k for k in of_side if k in self.touching]
            shares[np.ix_(touching, of_side)] = 1.0 / len(touching)
        return {"shares": shares[None]}

    def apply(self, rows: Rows, plan: Plan, memory: Memory) -> tuple[Rows, Memory]:
        """The sum of each side stays."""
        return replace(rows, values=plan["shares"] @ rows.values), None
