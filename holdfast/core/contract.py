"""The whole domain on two screens: what comes in, what goes out, and the words for it.

A *sample* is one reading of all sensors. Each sensor is a 3-axis Hall fingertip, and its three
channels stand together: shear x, shear y, normal z. Six fingertips give 18 channels; any other
multiple of three works (a 4x4 pad gives 48). A *recording* is samples at one rate, in one unit.

The *situation* says what the hand is in; the *class* adds whether the object is light or heavy::

    situation      class ids   meaning
    nothing        0 / 1       no contact
    grasp          2 / 3       the moment of grasping, and steady holding
    safe_slip      4 / 5       voluntary: pass, put-down, release; no action wanted
    risky_slip     6 / 7       involuntary: pull, fall; action wanted

Even ids are light objects (under 150 g), odd ids heavy ones. The numbers grow with risk, so the
rule for ties (the riskier one wins) is "the higher number wins" everywhere.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

AXES = ("x", "y", "z")
NORMAL_AXIS = 2
SITUATIONS = ("nothing", "grasp", "safe_slip", "risky_slip")
CLASSES = tuple(
    f"{situation}_{weight}" for situation in SITUATIONS for weight in ("light", "heavy")
)
LIGHT_BELOW_G = 150.0

NOTHING, GRASP, SAFE_SLIP, RISKY_SLIP = range(4)

Unit = Literal["N", "uT", "count"]
UNITS: tuple[Unit, ...] = ("N", "uT", "count")
STANDARD_GRAVITY_M_S2 = 9.80665
POUND_KG = 0.45359237
UNIT_OF: dict[str, tuple[Unit, float]] = {
    "N": ("N", 1.0),
    "mN": ("N", 1e-3),
    "cN": ("N", 1e-2),
    "dN": ("N", 1e-1),
    "kN": ("N", 1e3),
    "gf": ("N", 1e-3 * STANDARD_GRAVITY_M_S2),
    "kgf": ("N", STANDARD_GRAVITY_M_S2),
    "lbf": ("N", POUND_KG * STANDARD_GRAVITY_M_S2),
    "ozf": ("N", POUND_KG / 16 * STANDARD_GRAVITY_M_S2),
    "uT": ("uT", 1.0),
    "mT": ("uT", 1e3),
    "G": ("uT", 100.0),
    "T": ("uT", 1e6),
    "count": ("count", 1.0),
}
"""A unit that arrays may come in -> the unit of ours, and the factor to it."""
NORMAL_FLOOR: Mapping[Unit, float] = MappingProxyType(
    {"N": 0.3, "uT": 100.0, "count": 300.0}
)
"""A finger with a smaller normal reading touches nothing; above the noise of a resting channel.

In the stream's unit. No friction ratio is computed below it, and a resting normal below minus this
value means a reversed magnet.
"""
State = Literal["unknown", "nothing", "grasp", "safe_slip", "risky_slip"]
Reason = Literal[
    "", "settling", "sensors", "repeats", "rate", "started_loaded", "late", "clock"
]
"""Why the state is unknown.

settling: the history is not whole yet. sensors: too few sensors are usable. repeats: the whole hand
repeats itself. rate: the rate is not the model's. started_loaded: the hand has not been empty since
a loaded start. late: the answer is late. clock: the sample's stamp lies in the future.
"""
CommandLink = Literal["none", "live", "expired"]
"""The wearer's commands: none has come yet, they come, or their sender went silent."""
Mode = Literal["idle", "hold", "tighten", "relax", "yield"]
"""Of a grip command (GripCommand)."""

SINCE_BOOT = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
"""The clock that stamps samples. CLOCK_MONOTONIC stops in a suspended machine.

Samples around the gap would seem to be neighbours.
"""

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]
Json = dict[str, Any]
"""A JSON object as it stands in a file, looked up by its keys."""

RATE_TOLERANCE = 0.10
"""A source may run within +-10 % of the rate a model was built for (median step)."""
MOST_AVERAGED = 20
"""At most so many samples of a source are averaged to one of a model."""
RATES_HZ = (1e-3, 1e5)
"""The least and the largest sampling rate, wherever one comes from."""
CANNOT_TELL = "cannot_tell"
"""Of a model card's "training": what its data did not show, name -> reason.

A name is one of SITUATIONS, or "weight". No figure of such a thing means anything.
"""


def not_learned_of(card: Mapping[str, Any]) -> dict[str, str]:
    """What a model cannot tell, from its card; empty for a file that does not say."""
    training = card.get("training")
    not_learned = training.get(CANNOT_TELL) if isinstance(training, dict) else None
    return not_learned if isinstance(not_learned, dict) else {}


def not_learned_in_words(not_learned: Mapping[str, str]) -> list[str]:
    """A line for each thing that a model cannot tell.

    >>> not_learned_in_words({"safe_slip": "no voluntary release in the training data"})
    ['cannot tell safe slip: no voluntary release in the training data']
    """
    lines = []
    for name, reason in not_learned.items():
        lines.append(f"cannot tell {name.replace('_', ' ')}: {reason}")
    return lines


def is_rate(rate_hz: float) -> bool:
    """Whether a number can be a sampling rate; NaN is none."""
    return RATES_HZ[0] <= rate_hz <= RATES_HZ[1]


def averaged_by(rate_hz: float, model_hz: float) -> int:
    """How many samples of a source make one of a model's rate; 0 where no whole number does.

    >>> [averaged_by(rate_hz, 150.0) for rate_hz in (140.0, 300.0, 1000.0, 200.0)]
    [1, 2, 7, 0]
    """
    if not is_rate(rate_hz):
        return 0
    n = max(1, round(rate_hz / model_hz))
    fits = abs(rate_hz / (n * model_hz) - 1.0) <= RATE_TOLERANCE
    return n if fits and n <= MOST_AVERAGED else 0


def averaged_in_words(rate_hz: float, n: int) -> str:
    """What is reported where every n samples of a source become one."""
    return (
        f"{rate_hz:.4g} Hz averaged down to {rate_hz / n:.4g} Hz, means of {n} samples"
    )


def class_id(situation: int, *, heavy: bool) -> int:
    """Eight-class id of a situation index and a weight."""
    return 2 * situation + int(heavy)


def channel_names(n_sensors: int) -> tuple[str, ...]:
    """Channel names in order: X1, Y1, Z1 .. Xn, Yn, Zn."""
    return tuple(f"{axis.upper()}{k}" for k in range(1, n_sensors + 1) for axis in AXES)


def valid_names(n_sensors: int) -> tuple[str, ...]:
    """Names of the columns that say whether a sensor is valid, in order: valid1 .. validn."""
    return tuple(f"valid{k}" for k in range(1, n_sensors + 1))


@dataclass(frozen=True)
class Sample:
    """One reading of all sensors.

    t_ns: acquisition time, monotonic, ns. values: [C] in the unit of the source.
    valid: [C/3], False where the driver knows that a sensor is lost, stale or saturated.
    sequence: counts samples from 0, gaps show losses.
    """

    t_ns: int
    values: FloatArray
    valid: BoolArray
    sequence: int


@dataclass(frozen=True)
class Prediction:
    """The answer at one sample (the output contract; one JSON line each).

    t_acquired_ns, t_decided_ns, latency_us: monotonic clock. p_situation: the four situations,
    always; about 0 for one that the model cannot tell (not_learned_of its card): null in the
    JSON line. p_class and weight: None where the model knows no weight, and in "nothing" and
    "unknown". state and why: "unknown" wherever the samples or the time of the answer cannot be
    trusted, and the reason; "" where the state is known. extra: further heads by name, such as
    p_risky_250ms. detectors: which classical detectors fire. arm, act: the decision's debounced
    request. act_ended: how the last act ended (edge_runtime/decision.py), None before the first act
    and during one. opening, overridden, commands: what the wearer commands, whether an override
    lasts, and whether the commands still come. late: older than two periods when it was given.
    started_loaded: the hand held something at the start and has not been empty since; None where no
    stored bias says what unloaded is. degraded: some sensors are missing, yet enough are left; the
    state is then never safe_slip, whatever p_situation says.
    """

    sequence: int
    t_acquired_ns: int
    t_decided_ns: int
    latency_us: float
    state: State
    why: Reason
    p_situation: dict[str, float]
    p_risky: float
    p_class: dict[str, float] | None
    weight: Literal["light", "heavy"] | None
    extra: dict[str, float]
    detectors: dict[str, bool]
    arm: bool
    act: bool
    act_ended: Literal["released", "timed_out", "opened", "overridden"] | None
    opening: bool
    overridden: bool
    commands: CommandLink
    late: bool
    started_loaded: bool | None
    degraded: bool
    settled: bool
    model_id: str


class GripCommand(NamedTuple):
    """What the hand should do now.

    target_n: what the hand may add while its wearer does not open it: normal force of either side,
    N. From the very sample on at which the hand's own controller decides to open, the hand ignores
    it, until it has been empty or the wearer closes. None where the hand keeps the grip it has: in
    idle and yield the wearer's, in hold the present one. mode: idle (nothing wanted: the wearer's
    grip), hold (keep target_n), tighten, relax (give back slowly), yield (give back at once).
    slew_n_s: no faster than this. feedback: strength of the wearer's vibration cue, 0 to 1. mu_hat,
    margin, needed_n: friction margin (grip_control.py), None while not observed.
    reason: one word or two, for people.
    """

    sequence: int
    t_ns: int
    mode: Mode
    target_n: float | None
    slew_n_s: float
    feedback: float
    reason: str
    mu_hat: float | None = None
    margin: float | None = None
    needed_n: float | None = None


class Command(NamedTuple):
    """What the wearer commands at a sample.

    opening ends an act and prevents a new one; override ends every request and blocks new ones for
    a while. link: whether words have come at all, and whether they still come.
    """

    opening: bool = False
    override: bool = False
    link: CommandLink = "none"
