"""What an effect is: optional, named on the card or absent, with a random stream of its own.

Three stages, in this order. `physics` effects take part in every step of the core; `sensor` effects
turn the forces on the fingertips into what a sensor reports; `camera` draws frames. A card compiles
to the list of effects it names: one that is not on it is never called and keeps no state.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, field, fields
from typing import Any, Literal, Protocol, TypeVar

import numpy as np

from edge_runtime.contract import BoolArray, FloatArray, Unit
from simulation.values import Parameter

Drawn = Mapping[str, Any]
"""Parameter name -> value of one trial: a float, or a list of floats."""


@dataclass(frozen=True)
class Signal:
    """What S fingertips (6, or the card's) report: t_s [T], values [T, S, 3] (shear x, y, normal
    z), valid [T, S]."""

    t_s: FloatArray
    values: FloatArray
    valid: BoolArray
    unit: Unit = "N"


SensorFunction = Callable[[Signal, Drawn, np.random.Generator], Signal]


@dataclass(frozen=True)
class Effect:
    """One entry of the table of effects.

    make: for `sensor`, the function itself; for `physics`, what builds the effect for a batch (see
    core.py). needs: effects that must be on the card too. marks_invalid: it can make samples
    invalid, so the trial's file has columns that say so.
    """

    name: str
    stage: Literal["physics", "sensor", "camera"]
    make: Callable[..., Any]
    parameters: dict[str, Parameter] = field(default_factory=dict)
    needs: tuple[str, ...] = ()
    marks_invalid: bool = False

    def draw(self, told: Mapping[str, Any], rng: np.random.Generator) -> dict[str, Any]:
        """One trial's parameters, drawn in the order of the table, so that no draw depends on the
        card's order."""
        return {name: p.draw(told.get(name, p.default), rng) for name, p in self.parameters.items()}


def stream(seed: int, trial: int, name: str) -> np.random.Generator:
    """The random stream of one part of one trial; no other part's draws can shift it."""
    return np.random.default_rng(
        np.random.SeedSequence(seed, spawn_key=(trial, zlib.crc32(name.encode())))
    )


class Shake(Protocol):
    """An inertial effect: the hand itself accelerates."""

    def acceleration_m_s2(self, t_s: FloatArray) -> FloatArray:
        """[3, B] of the hand at times t_s [B]."""
        ...


class Texture(Protocol):
    """Something that makes friction depend on how far an element has slipped."""

    def scale(self, slipped_m: FloatArray) -> FloatArray:
        """[E, 6, B] factor of the limit, told what each element slipped in the last step, m [E, 6,
        B]."""
        ...


class Lag(Protocol):
    """A part of the normal force that remembers: N gains stiffness * (change of depth) + held."""

    def terms(self, dt_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(stiffness [6, B], held force [6, B]) of a step of dt_s [B]."""
        ...

    def moved(self, change_m: FloatArray, touching: BoolArray, dt_s: FloatArray) -> None:
        """The depth changed by this much, [6, B]."""
        ...


class Turn(Protocol):
    """Rotation of the object: moves the brushes by itself after the core has."""

    def turn(self, body: Any, state: Any, limit_m: FloatArray, dt_s: FloatArray) -> None:
        """Turn the object by one step; changes the stretch of the brushes in place."""
        ...


@dataclass(frozen=True)
class PhysicsEffects:
    """What takes part in every step beside the core: empty unless the card names it."""

    shakes: tuple[Shake, ...] = ()
    textures: tuple[Texture, ...] = ()
    lags: tuple[Lag, ...] = ()
    turns: tuple[Turn, ...] = ()

    def without_lanes(self, count: int, lanes: int) -> PhysicsEffects:
        """The effects of a batch without the first so many of its lanes."""
        kinds = (getattr(self, one.name) for one in fields(self))
        return PhysicsEffects(
            *(tuple(without_lanes(effect, count, lanes) for effect in kind) for kind in kinds)
        )


Batched = TypeVar("Batched")


def without_lanes(whole: Batched, count: int, lanes: int) -> Batched:
    """A copy of an object that is told about a batch, without the first so many of its lanes.

    Every array of it whose last axis is as long as the batch, also one in a list, has the lanes
    there.
    """
    part = copy(whole)
    for name, value in vars(whole).items():
        setattr(part, name, _cut(value, count, lanes))
    return part


def _cut(value: Any, count: int, lanes: int) -> Any:
    if isinstance(value, list):
        return [_cut(one, count, lanes) for one in value]
    batched = isinstance(value, np.ndarray) and value.ndim > 0 and value.shape[-1] == lanes
    return value[..., count:].copy(order="K") if batched else value


NO_EFFECTS = PhysicsEffects()
