"""Effects: optional parts of the physics or the sensor, and their parameters.

A scene file compiles to the list of effects that it names: the module of an effect is loaded when
a scene names it, and one that no scene names is never called and keeps no state. Every effect has
a random stream of its own, so that it shifts no other draw. Stages, in this order: `physics`
effects take part in every step of the solver, or set how it steps; `sensor` effects turn the forces
on the fingertips into what a sensor reports.

A parameter in a scene file is a constant, a choice, or a distribution that is drawn once a trial:

    grip_n = 8.0
    grip_n = { uniform = [6, 10] }
    grip_n = { normal = [8, 1] }         # mean and standard deviation, kept within the range
    grip_n = { log_uniform = [0.1, 10] }
    grip_n = { choice = [4, 8, 12] }
    sensors = [2, 5]                     # for a parameter that is a list
"""

from __future__ import annotations

import importlib
import math
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, TypeVar

import numpy as np

from holdfast.core.contract import BoolArray, FloatArray, Unit

Drawn = Mapping[str, Any]
"""Parameter name -> value of one trial: a float, or a list of floats."""
Interval = tuple[float, float]
"""Start and end, s."""
Plan = dict[str, Any]
"""Arrays by name; the first axis has a row for each sample, or one row for all samples."""

DISTRIBUTIONS = (
    "{ uniform = [low, high] } or { log_uniform = [low, high] }, low before high, "
    "{ normal = [mean, standard deviation] } or { choice = [values] }"
)
"""Distributions that a scene file may name."""
EFFECT_MODULES = {
    "brush": "physics.contacts",
    "texture": "physics.contacts",
    "lag": "physics.contacts",
    "rotation": "physics.contacts",
    "arm": "effects.shakes",
    "tremor": "effects.shakes",
    "fluctuation": "effects.shakes",
    "averaging": "effects.chip",
    "shear_gain": "effects.sensor_spread",
    "hysteresis": "effects.sensor_spread",
    "mounting": "effects.sensor_spread",
    "dipole": "effects.magnet",
    "pad_magnet": "effects.magnet",
    "cross_talk": "effects.magnet",
    "gain_tilt": "effects.magnet",
    "magnet_reversed": "effects.magnet",
    "thermal_drift": "effects.magnet",
    "temperature": "effects.magnet",
    "hall_noise": "effects.chip",
    "quantisation": "effects.chip",
    "magnetometer": "effects.magnet",
    "drift": "effects.sensor_spread",
    "white_noise": "effects.sensor_spread",
    "timing_jitter": "effects.chip",
}
"""Every effect in the order in which they run, and the module of this package that has it."""


@dataclass(frozen=True)
class Parameter:
    """One parameter of a scene file, and the range that values and draws keep within.

    default    what holds where the file has no value: a constant or a distribution; None: the
               parameter is then not drawn at all
    unit       "" for a ratio or a count
    low, high  the range, ends included
    about      what it is, as docs/scenes.md prints it
    many       the value is a list of numbers (such as sensors), not one number
    """

    default: Any
    unit: str
    low: float
    high: float
    about: str
    many: bool = False

    def allowed(self) -> str:
        """The range in words, for errors and tables."""
        what = "a list of numbers" if self.many else "a number"
        unit = f" {self.unit}" if self.unit else ""
        return f"{what} from {self.low:g} to {self.high:g}{unit}"

    def problem(self, value: Any) -> str | None:
        """What a scene file's value should be instead, or None."""
        if self.many:
            fits = isinstance(value, list) and all(map(self._inside, value))
            return None if fits else self.allowed()
        if self._inside(value) or self._can_give(value):
            return None
        return f"{self.allowed()}, or a distribution of them: {DISTRIBUTIONS}"

    def draw(self, value: Any, rng: np.random.Generator) -> Any:
        """One draw of a value that has no problem; a constant uses no random number."""
        if self.many:
            return list(map(float, value))
        if not isinstance(value, dict):
            return float(value)
        ((kind, numbers),) = value.items()
        # A normal draw may lie outside of the range.
        return min(max(_drawn(kind, numbers, rng), self.low), self.high)

    def _inside(self, value: Any) -> bool:
        """Whether a value is a number within the range."""
        # Python counts True as an int, and nan fails both comparisons
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        return number and self.low <= value <= self.high

    def _can_give(self, value: Any) -> bool:
        """Whether a value is a distribution, and all that it is given by is within the range."""
        if not isinstance(value, dict) or len(value) != 1:
            return False
        ((kind, numbers),) = value.items()
        if not isinstance(numbers, list) or not numbers:
            return False
        if kind == "choice":
            return all(map(self._inside, numbers))
        if len(numbers) != 2 or not self._inside(numbers[0]):
            return False
        # A normal draw that lies outside of the range is moved to its end.
        if kind == "normal":
            return bool(numbers[1] >= 0)
        low, high = numbers
        known = kind == "uniform" or (kind == "log_uniform" and low > 0)
        return known and self._inside(high) and bool(low <= high)


SENSORS = Parameter([], "", 1, 12, "which sensors", many=True)
"""Of effects on some sensors."""


def _drawn(kind: str, numbers: list[float], rng: np.random.Generator) -> float:
    """One draw of a distribution; its kind is one of DISTRIBUTIONS."""
    if kind == "choice":
        return float(numbers[int(rng.integers(len(numbers)))])
    first, second = numbers
    if kind == "log_uniform":
        return float(math.exp(rng.uniform(math.log(first), math.log(second))))
    # numpy's methods have the names of the other kinds.
    return float(getattr(rng, kind)(first, second))


@dataclass(frozen=True)
class Rows:
    """What S fingertips report in n rows: shear x, shear y, normal.

    Rows are the samples of one trial, or one sample of many trials.

    values  [n, S, 3]
    valid   [n, S]
    unit    of the values
    """

    values: FloatArray
    valid: BoolArray
    unit: Unit = "N"


Reported = TypeVar("Reported", bound=Rows)


@dataclass(frozen=True, kw_only=True)
class Signal(Rows):
    """What S fingertips report in a trial, at the times t_s [T]."""

    t_s: FloatArray


@dataclass(frozen=True)
class PlanRequest:
    """What an effect draws its plan from.

    drawn    parameters of the trial; request["height_mm"] is one of them
    rng      the effect's random stream in the trial
    t_s      [T] times of the samples
    sensors  S
    """

    drawn: Drawn
    rng: np.random.Generator
    t_s: FloatArray
    sensors: int

    def __getitem__(self, name: str) -> Any:
        return self.drawn[name]

    @property
    def places(self) -> list[int]:
        """Of the sensors that the effect is about; a scene file numbers them from 1."""
        return [int(number) - 1 for number in self["sensors"]]

    def noise(self) -> FloatArray:
        """[T, S, 3] standard normal numbers from the stream."""
        return self.rng.normal(size=(len(self.t_s), self.sensors, 3))


@dataclass(frozen=True)
class Effect:
    """One entry of the table of effects.

    make            of a sensor effect: its law, (rows, plan) -> rows, which draws nothing;
                    of a physics effect: EffectBatch -> PhysicsEffect;
                    of one that `sets` a field of stepper.StepSettings: its constant -> that field
    parameters      in the order in which they are drawn
    plan            of a sensor effect: PlanRequest -> plan, everything random; else None
    whole           of a law that also takes what it returned for the row before (itself at the
                    first): the same law of a whole trial; None: no row depends on another
    needs           effects that the scene must name too
    constant        a parameter that is the same in all trials of a scene: they are stepped together
    sets            the field of stepper.StepSettings
    longest_step_s  the longest physics.step_s it allows
    gives_unit      the unit after it; None: it changes no unit
    in_scene_unit   it acts on reported samples, so the unit is converted before it
    only_unit       the unit of the scene's samples that it needs; None: any
    by_channel      parameters that are lists with a number for each channel, all given or none
    example         values with which it does something, where the defaults may not: for its tests
    neutral         values with which it changes no bit; None: there are none
    """

    make: Callable[..., Any]
    parameters: dict[str, Parameter]
    plan: Any = None
    whole: Callable[..., Any] | None = None
    needs: tuple[str, ...] = ()
    constant: str = ""
    sets: str = ""
    longest_step_s: float = math.inf
    gives_unit: Unit | None = None
    in_scene_unit: bool = False
    only_unit: Unit | None = None
    by_channel: tuple[str, ...] = ()
    example: Mapping[str, Any] = field(default_factory=dict)
    neutral: Mapping[str, Any] | None = None

    @property
    def stage(self) -> str:
        """Whether it is a part of the physics or of the sensor."""
        return "sensor" if self.plan else "physics"

    def draw(self, values: Mapping[str, Any], rng: np.random.Generator) -> Drawn:
        """Draw one trial's parameters from the scene's values.

        The order is the table's, so no draw depends on the order in the scene file.
        """
        return draw_all(self.parameters, values, rng)

    def sense(self, signal: Signal, drawn: Drawn, rng: np.random.Generator) -> Signal:
        """The signal of a whole trial after this effect, in the unit that it gives."""
        sensors = signal.values.shape[1]
        plan = self.plan(PlanRequest(drawn, rng, signal.t_s, sensors))
        made: Signal = (self.whole or self.make)(signal, plan)
        return replace(made, unit=self.gives_unit or made.unit)


def as_drawn(request: PlanRequest) -> Plan:
    """The parameters themselves, [1, 1, 1] each: nothing random."""
    return {name: np.full((1, 1, 1), value) for name, value in request.drawn.items()}


def added(rows: Rows, plan: Plan) -> Rows:
    """What is read, and what the plan adds to it, in the unit of the rows."""
    return replace(rows, values=rows.values + plan["added"])


def scaled(rows: Rows, plan: Plan) -> Rows:
    """What is read times the plan's factor."""
    return replace(rows, values=rows.values * plan["factor"])


def draw_all(
    table: Mapping[str, Parameter],
    values: Mapping[str, Any],
    rng: np.random.Generator,
) -> dict[str, Any]:
    """Draw every parameter of a table in its order; values: those that are not the default."""
    drawn = {}
    for name, parameter in table.items():
        value = values.get(name, parameter.default)
        if value is not None:
            drawn[name] = parameter.draw(value, rng)
    return drawn


def module_effects(name: str) -> dict[str, Effect]:
    """All effects of the module that has the named one; loads the module."""
    module = importlib.import_module(f"holdfast.simulation.{EFFECT_MODULES[name]}")
    effects: dict[str, Effect] = module.EFFECTS
    return effects


def effect_named(name: str) -> Effect:
    """An effect by its name; loads the module that has it."""
    return module_effects(name)[name]


def all_effects() -> dict[str, Effect]:
    """Every effect in the order in which they run, with all their modules loaded."""
    return {name: effect_named(name) for name in EFFECT_MODULES}


def step_settings(named: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Fields of stepper.StepSettings that effects set; named: effect -> the scene's values."""
    fields = {}
    for name, values in named.items():
        effect = effect_named(name)
        if effect.sets:
            default = effect.parameters[effect.constant].default
            value = values.get(effect.constant, default)
            fields[effect.sets] = effect.make(float(value))
    return fields


def stream(seed: int, trial: int, name: str) -> np.random.Generator:
    """The random stream of one part of one trial; draws of other parts cannot shift it."""
    # The checksum and not hash(), which differs from process to process.
    key = (trial, zlib.crc32(name.encode()))
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


@dataclass(frozen=True)
class EffectBatch:
    """What an effect of the physics is built of.

    drawn   of each of B trials
    trials  as they were planned
    rngs    the effect's random stream in each trial
    """

    drawn: Sequence[Drawn]
    trials: Sequence[Any]
    rngs: Sequence[np.random.Generator]

    def values(self, name: str) -> FloatArray:
        """[B] a parameter of every trial."""
        return np.array([drawn[name] for drawn in self.drawn])


class PhysicsEffect:
    """A part of every step of the solver, built for a batch of B trials.

    Its kind says what the solver asks it for, and thereby its place in PhysicsEffects:
    shakes    the hand accelerates: acceleration_m_s2(t_s [B]) -> [3, B]
    textures  friction depends on how far an element has slipped: scale(slip in the last step
              [E, S, B]) -> [E, S, B], a factor of the friction limit
    lags      a part of the normal force with memory, which gains stiffness * (change of depth)
              + held: terms(dt_s [B]) -> (stiffness, held force), [S, B] each; and follow(change
              of depth [S, B], touching [S, B], dt_s [B]) takes in the step
    turns     the object rotates: turn(body, state, limit_m, dt_s, inertial force of the shakes
              [3, B]) moves the brushes in place after the solver has
    grips     the fingers are unsteady: closure_m(closure [S, B], t_s [B]) -> [S, B]
    """

    kind: Literal["shakes", "textures", "lags", "turns", "grips"]

    def busy_s(self, trial: int) -> list[Interval]:
        """When a trial of the batch needs fine steps; by default never for the effect's sake."""
        return []

    @staticmethod
    def peak_m_s2(drawn: Drawn) -> float:
        """Largest acceleration that a hold has to bear."""
        return 0.0

    @staticmethod
    def lever_m(drawn: Drawn) -> float:
        """How far from the grip the load of a hold acts."""
        return 0.0


@dataclass(frozen=True)
class PhysicsEffects:
    """What takes part in every step of the solver: empty unless the scene names an effect."""

    shakes: tuple[Any, ...] = ()
    textures: tuple[Any, ...] = ()
    lags: tuple[Any, ...] = ()
    turns: tuple[Any, ...] = ()
    grips: tuple[Any, ...] = ()


NO_EFFECTS = PhysicsEffects()
