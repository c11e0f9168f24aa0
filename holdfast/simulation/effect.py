"""An effect: an optional part of the physics, the sensor or the camera, with its own random stream.

Stages, in this order: `physics` effects take part in every step of the core, or set how it steps;
`sensor` effects turn the forces on the fingertips into what a sensor reports; `camera` effects draw
frames. A card compiles to the list of effects it names: one that it does not name is never called
and keeps no state.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, field, fields
from typing import Any, Literal, Protocol, TypeVar

import numpy as np

from holdfast.core.contract import BoolArray, FloatArray, Unit
from holdfast.simulation.values import Parameter

Drawn = Mapping[str, Any]
"""Parameter name -> value of one trial: a float, or a list of floats."""


@dataclass(frozen=True)
class Signal:
    """What S fingertips report: t_s [T], values [T, S, 3] (shear x, y, normal), valid [T, S]."""

    t_s: FloatArray
    values: FloatArray
    valid: BoolArray
    unit: Unit = "N"


@dataclass(frozen=True)
class Effect:
    """One entry of the table of effects.

    make: (signal, drawn, random stream) -> signal; or for `physics` what builds the effect for a
    batch; or for an effect that `sets` a field of run.StepSettings what turns its constant into
    that field. needs: effects that must be on the card too. marks_invalid: it can make samples
    invalid, so the trial's file has columns for that. constant: a parameter that is the same in all
    trials of a card, which are stepped together. longest_step_s: the longest physics.step_s it
    allows. gives_unit: the unit after it. in_card_unit: it acts on reported samples, so the unit is
    converted before it.
    """

    name: str
    stage: Literal["physics", "sensor", "camera"]
    make: Callable[..., Any]
    parameters: dict[str, Parameter] = field(default_factory=dict)
    needs: tuple[str, ...] = ()
    marks_invalid: bool = False
    constant: str = ""
    sets: str = ""
    longest_step_s: float = math.inf
    gives_unit: Unit | None = None
    in_card_unit: bool = False

    def draw(self, values: Mapping[str, Any], rng: np.random.Generator) -> Drawn:
        """Draw one trial's parameters from the card's values.

        The order is the table's, so no draw depends on the order of the card.
        """
        table = self.parameters.items()
        return {name: p.draw(values.get(name, p.default), rng) for name, p in table}

    def setting(self, values: Mapping[str, Any]) -> Any:
        """The field of run.StepSettings that this effect sets, from the card's values."""
        default = self.parameters[self.constant].default
        return self.make(float(values.get(self.constant, default)))


def stream(seed: int, trial: int, name: str) -> np.random.Generator:
    """The random stream of one part of one trial; draws of other parts cannot shift it."""
    return np.random.default_rng(
        np.random.SeedSequence(seed, spawn_key=(trial, zlib.crc32(name.encode())))
    )


class ShakeEffect(Protocol):
    """The hand itself accelerates."""

    def acceleration_m_s2(self, t_s: FloatArray) -> FloatArray:
        """[3, B] of the hand at times t_s [B]."""
        ...


class TextureEffect(Protocol):
    """Friction depends on how far an element has slipped."""

    def scale(self, slipped_m: FloatArray) -> FloatArray:
        """[E, S, B] factor of the friction limit; slipped_m [E, S, B]: slip in the last step."""
        ...


class LagEffect(Protocol):
    """A part of the normal force with memory: N gains stiffness * (change of depth) + held."""

    def terms(self, dt_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(stiffness [S, B], held force [S, B]) of a step of dt_s [B]."""
        ...

    def moved(
        self, change_m: FloatArray, touching: BoolArray, dt_s: FloatArray
    ) -> None:
        """Take in the change of depth of a step, [S, B]."""
        ...


class TurnEffect(Protocol):
    """Rotation of the object: moves the brushes by itself after the core has."""

    def turn(
        self, body: Any, state: Any, limit_m: FloatArray, dt_s: FloatArray
    ) -> None:
        """Turn the object by one step; changes the stretch of the brushes in place."""
        ...


@dataclass(frozen=True)
class PhysicsEffects:
    """What takes part in every step beside the core: empty unless the card names it."""

    shakes: tuple[ShakeEffect, ...] = ()
    textures: tuple[TextureEffect, ...] = ()
    lags: tuple[LagEffect, ...] = ()
    turns: tuple[TurnEffect, ...] = ()

    def without_lanes(self, count: int, lanes: int) -> PhysicsEffects:
        """The effects of a batch of `lanes` without its first `count` lanes."""
        kinds = (getattr(self, one.name) for one in fields(self))
        return PhysicsEffects(
            *(
                tuple(without_lanes(effect, count, lanes) for effect in kind)
                for kind in kinds
            )
        )


Batched = TypeVar("Batched")


def without_lanes(whole: Batched, count: int, lanes: int) -> Batched:
    """A copy of an object that holds arrays of a batch, without the first `count` lanes.

    Its arrays whose last axis has `lanes` entries have the lanes there; lists of arrays too.
    """
    part = copy(whole)
    for name, value in vars(whole).items():
        setattr(part, name, _cut(value, count, lanes))
    return part


def _cut(value: Any, count: int, lanes: int) -> Any:
    if isinstance(value, list):
        return [_cut(one, count, lanes) for one in value]
    batched = (
        isinstance(value, np.ndarray) and value.ndim > 0 and value.shape[-1] == lanes
    )
    return value[..., count:].copy(order="K") if batched else value


NO_EFFECTS = PhysicsEffects()
