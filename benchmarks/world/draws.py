"""One trial of the second physics, all its numbers drawn from ranges.py before anything moves.

The frame is the hand's: x from the thumb to the fingers, z along the fingers' row. The hand is held
any way, so gravity points anywhere in it. A trial's number picks its random streams, so a small set
is a part of a larger one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.world.ranges import EVENT_N, HELD_N, RANGES, REFUSED_GRIP_N
from holdfast.core.contract import FloatArray
from holdfast.simulation.effects.effect import stream
from holdfast.simulation.physics.objects import hand_of_counts

G_M_S2 = 9.81
KINDS = {
    "pull-fast": "a person pulls the object out within half a second",
    "pull-slow": "the same in up to two seconds",
    "fall-support": "the support of a weak grip vanishes",
    "fall-weight": "weight is added until friction does not hold",
    "fall-relax": "the wearer's grip relaxes below what the weight needs",
    "tug-lost": "a short tug that friction does not hold",
    "tug-held": "a short tug that friction holds",
    "hand-over": "a person takes it, and the wearer opens",
    "hand-over-late": "a person takes it, and the wearer opens late or never",
    "put-down": "a box takes the weight, and the wearer opens",
    "pick-up": "the hand lifts the object",
    "quiet-hold": "nothing happens",
    "trembling-hold": "the hand trembles",
}
NUMBERS_A_KIND = 100_000
"""Trials of a kind are numbered from its place in KINDS times this."""
MOST_DRAWS = 1000
PULLS = ("pull-fast", "pull-slow")
TUGS = ("tug-lost", "tug-held")
FALLS = ("fall-support", "fall-weight", "fall-relax")
RISKY = (*PULLS, *FALLS, "tug-lost")
"""Kinds in which losing the object is a drop that an answer may prevent."""
HAND_OVERS = ("hand-over", "hand-over-late")
HOLDS = ("quiet-hold", "trembling-hold")
INTENTS = {
    "drawn": "one in two wearers' signals to open reach the run",
    "wired": "nine in ten do, as in our own loop",
    "always": "every one does",
    "none": "none does",
}
MISSED_SHARES = {"wired": 0.1, "always": 0.0, "none": 1.0}
"""Of the signals: those that do not reach the run."""
SHAPES = ("box", "cylinder", "ball")
HAND = hand_of_counts()
SIDE = np.where(np.arange(HAND.n_contacts) < HAND.thumb, 1.0, -1.0)
"""[S] which way each pad pushes along x: the thumb's along it, the fingers' against it."""
THROUGH = 0.5
"""No person pulls an object through thumb or fingers: |x| of a pull's direction is below this."""
WATCH_S = 1.0
"""A fall, a tug and a lift are watched for so long after the load has come."""
HOLDS_S = 4.0
NEVER_S = 1e9


@dataclass(frozen=True)
class WorldTrial:
    """One trial. Times in s from its start; NEVER_S for what it does not have.

    kind, number, seed, attempt  what happens, and which draw this is of it
    numbers          drawn values by the names of RANGES
    shape            of the object
    centre_m         [3] of its mass, from the middle of the object
    gravity_m_s2     [3] in the hand's frame
    push             [3] direction of a pull, a tug, or of taking
    tremble          [3] direction of the tremor
    grab_m           [3] where a person pulls, from the middle of the object
    share            [S] of its side's grip that each pad bears
    stiffness        [S] normal, N/m
    grip_n           the wearer's, N a side
    need_n           grip of either side that the trial's largest load needs
    close_s, give_s, act_s, open_s, end_s   the hand closes, the giver lets go, the event, the
                     wearer opens, the trial ends
    signal_s         the wearer's muscle signal reaches the run
    """

    kind: str
    number: int
    seed: int
    attempt: int
    numbers: dict[str, float]
    shape: str
    centre_m: FloatArray
    gravity_m_s2: FloatArray
    push: FloatArray
    tremble: FloatArray
    grab_m: FloatArray
    share: FloatArray
    stiffness: FloatArray
    grip_n: float
    need_n: float
    close_s: float
    give_s: float
    act_s: float
    open_s: float
    end_s: float
    signal_s: float

    @property
    def weight_n(self) -> FloatArray:
        """[3] the weight."""
        weight: FloatArray = self.numbers["mass_kg"] * self.gravity_m_s2
        return weight

    @property
    def has_signal(self) -> bool:
        """Whether the wearer opens the hand, and the signal reaches the run."""
        return self.signal_s < NEVER_S and self.open_s < NEVER_S


@dataclass(frozen=True)
class Event:
    """What the event adds to the weight: load_n [3], largest; needs: grip it needs over grip_n."""

    load_n: FloatArray


def number_of(kind: str, repetition: int) -> int:
    """The number of a trial."""
    return list(KINDS).index(kind) * NUMBERS_A_KIND + repetition


def draw_trial(kind: str, repetition: int, seed: int, first: int = 0) -> WorldTrial:
    """A trial whose hold is possible; first: the attempt to begin with.

    A hold outside of REFUSED_GRIP_N, and an event that is not of its kind (a tug that friction does
    not hold must need more than it holds), is drawn again as a whole.
    """
    number = number_of(kind, repetition)
    for attempt in range(first, first + MOST_DRAWS):
        rng = stream(seed, number, f"world {attempt}")
        trial = _drawn(kind, number, seed, attempt, rng)
        if trial is not None:
            return trial
    raise RuntimeError(f"{kind} {repetition}: no hold in {MOST_DRAWS} draws")


def _drawn(
    kind: str, number: int, seed: int, attempt: int, rng: np.random.Generator
) -> WorldTrial | None:
    """One draw; None where the hold or the event is refused."""
    numbers = {name: one.draw(rng) for name, one in RANGES.items()}
    if kind == "trembling-hold":
        numbers["tremor_m_s2"] = numbers["trembling_m_s2"]
    shape = SHAPES[int(rng.integers(len(SHAPES)))]
    gravity = G_M_S2 * direction(rng)
    push = direction(rng, THROUGH)
    tremble = direction(rng)
    centre = _centre(shape, numbers, rng)
    share, stiffness = _fingers(numbers, rng)
    grab = numbers["grab_m"] * direction(rng)

    gives_signal = rng.uniform() < 0.5
    never_opens = rng.uniform() < 0.5

    weight_n = numbers["mass_kg"] * gravity
    need = _needs(numbers, stiffness)
    hold_n = need(weight_n, _shaken_n(kind, numbers))
    grip_n = _grip_n(kind, numbers, weight_n, need)
    if not REFUSED_GRIP_N[0] <= grip_n <= REFUSED_GRIP_N[1]:
        return None
    load_n = weight_n + _event_n(kind, numbers, gravity, push)
    need_n = max(hold_n, need(load_n, 0.0))
    if not _fits(kind, need_n / grip_n):
        return None

    times = _times(kind, numbers, never_opens)
    signal_s = times["open_s"] - numbers["signal_s"] if gives_signal else NEVER_S
    return WorldTrial(
        kind,
        number,
        seed,
        attempt,
        numbers,
        shape,
        centre,
        gravity,
        push,
        tremble,
        grab,
        share,
        stiffness,
        grip_n,
        need_n,
        **times,
        signal_s=signal_s,
    )


def with_intent(trial: WorldTrial, intent: str) -> WorldTrial:
    """The trial with the wearer's signal as `intent`, of INTENTS, has it; all else is the same."""
    if intent == "drawn" or trial.open_s >= NEVER_S:
        return trial
    # A stream of its own: the draws of the trial stay as they are.
    rng = stream(trial.seed, trial.number, "muscle signal")
    missed = rng.uniform() < MISSED_SHARES[intent]
    signal_s = NEVER_S if missed else trial.open_s - trial.numbers["signal_s"]
    return replace(trial, signal_s=signal_s)


def direction(rng: np.random.Generator, most_x: float = 1.0) -> FloatArray:
    """[3] a direction, any as likely as another, whose |x| is at most most_x."""
    while True:
        drawn = rng.normal(size=3)
        length = float(np.sqrt(drawn @ drawn))
        if length > 1e-6 and abs(drawn[0]) <= most_x * length:
            one: FloatArray = drawn / length
            return one


def half_size_m(shape: str, numbers: dict[str, float]) -> FloatArray:
    """[3] half the size of the object: between the fingers, across, along."""
    width = numbers["half_width_m"]
    if shape == "ball":
        return np.full(3, max(width, 0.02))
    depth = width if shape == "cylinder" else numbers["half_depth_m"]
    return np.array([width, depth, numbers["half_length_m"]])


def moments_kg_m2(shape: str, numbers: dict[str, float]) -> list[float]:
    """Moments of inertia of the full shape about x, y and z."""
    mass = numbers["mass_kg"]
    x, y, z = (half_size_m(shape, numbers) ** 2).tolist()
    if shape == "ball":
        return [0.4 * mass * x] * 3
    if shape == "cylinder":
        across = mass * (x / 4.0 + z / 3.0)
        return [across, across, mass * x / 2.0]
    third = mass / 3.0
    return [third * (y + z), third * (x + z), third * (x + y)]


def _centre(
    shape: str, numbers: dict[str, float], rng: np.random.Generator
) -> FloatArray:
    """[3] m: in three of ten objects the mass is off centre."""
    drawn = direction(rng)
    if numbers["off_centre_share"] >= 0.3:
        return np.zeros(3)
    centre: FloatArray = numbers["off_centre"] * drawn * half_size_m(shape, numbers)
    return centre


def _fingers(
    numbers: dict[str, float], rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """(share of the grip of its side, normal stiffness in N/m) [S] of each pad."""
    share = 1.0 + numbers["share_spread"] * rng.uniform(-1.0, 1.0, HAND.n_contacts)
    share[: HAND.thumb] /= share[: HAND.thumb].sum()
    share[HAND.thumb :] /= share[HAND.thumb :].sum()
    stiffness = numbers["finger_n_per_m"] * rng.uniform(0.8, 1.25, HAND.n_contacts)
    return share, stiffness


Need = Callable[[FloatArray, float], float]
"""(load [3] in N, further load along the skin in N) -> grip of either side, N."""


def _needs(numbers: dict[str, float], stiffness: FloatArray) -> Need:
    """The grip that holds a load by Coulomb's friction: all of it, no share of it.

    The part of a load along x presses one side and unloads the other, by the fingers' springs; a
    side that is unloaded altogether holds nothing.
    """
    thumb = float(stiffness[: HAND.thumb].sum())
    fingers = float(stiffness[HAND.thumb :].sum())

    def need(load_n: FloatArray, more_n: float) -> float:
        along_n = float(np.hypot(load_n[1], load_n[2])) + more_n
        across_n = float(load_n[0])
        # Towards the fingers the thumb is unloaded, and the other way round.
        unloads = thumb if across_n > 0.0 else fingers
        unloaded_n = abs(across_n) * unloads / (thumb + fingers)
        gained_n = across_n * (fingers - thumb) / (thumb + fingers)
        by_friction_n = 0.5 * (along_n / numbers["friction"] - gained_n)
        return max(by_friction_n, 1.25 * unloaded_n)

    return need


def _shaken_n(kind: str, numbers: dict[str, float]) -> float:
    """Peak of tremor and arm on the object, N, as if all of it were along the skin."""
    peak_m_s2 = numbers["tremor_m_s2"]
    if kind == "pick-up":
        peak_m_s2 += lift_m_s2(numbers)
    return numbers["mass_kg"] * peak_m_s2


def lift_m_s2(numbers: dict[str, float]) -> float:
    """Peak acceleration of a minimum-jerk lift: 10 / sqrt(3) of distance over time squared."""
    return 10.0 / np.sqrt(3.0) * numbers["lift_m"] / numbers["lift_s"] ** 2


def _grip_n(
    kind: str, numbers: dict[str, float], weight_n: FloatArray, need: Need
) -> float:
    """The wearer's grip, N a side."""
    held_n = need(weight_n, _shaken_n(kind, numbers))
    if kind == "fall-support":
        return numbers["weak_grip"] * held_n
    return held_n / numbers["friction_used"]


def _event_n(
    kind: str, numbers: dict[str, float], gravity: FloatArray, push: FloatArray
) -> FloatArray:
    """[3] the largest load that the event adds to the weight, N; a hand-over adds none."""
    if kind in (*PULLS, *TUGS):
        return numbers["force_n"] * push
    if kind == "fall-weight":
        return numbers["added_n"] * gravity / G_M_S2
    return np.zeros(3)


def _fits(kind: str, needed: float) -> bool:
    """Whether the event is of its kind; needed: grip that it needs over the wearer's."""
    if kind in (*PULLS, "tug-lost", "fall-weight"):
        return EVENT_N[0] <= needed <= EVENT_N[1]
    if kind == "tug-held":
        return HELD_N[0] <= needed <= HELD_N[1]
    return True


def _times(kind: str, numbers: dict[str, float], never_opens: bool) -> dict[str, float]:
    """When what happens."""
    close_s = numbers["rest_s"]
    closed_s = close_s + 2.0 * numbers["closing_s"]
    give_s = closed_s + numbers["give_after_s"]
    act_s = give_s + numbers["give_s"] + numbers["hold_s"]
    if kind == "pick-up":
        # the lift itself takes the object from its support
        act_s = give_s
    if kind == "fall-support":
        give_s = act_s

    open_s = NEVER_S
    if kind == "hand-over":
        open_s = act_s + numbers["open_after_s"]
    if kind == "hand-over-late" and not never_opens:
        open_s = act_s + numbers["late_s"]
    if kind == "put-down":
        open_s = act_s + numbers["rest_on_s"]

    end_s = act_s + _lasts_s(kind, numbers)
    if open_s < NEVER_S:
        end_s = max(end_s, open_s + numbers["opening_s"] + WATCH_S)
    return {
        "close_s": close_s,
        "give_s": give_s,
        "act_s": act_s,
        "open_s": open_s,
        "end_s": end_s,
    }


def _lasts_s(kind: str, numbers: dict[str, float]) -> float:
    """How long the event is watched, s."""
    if kind in PULLS:
        return gives_up_s(kind, numbers) + 0.5
    if kind in TUGS:
        return numbers["tug_s"] + WATCH_S
    if kind in HAND_OVERS:
        return gives_up_s(kind, numbers) + 0.5
    if kind in HOLDS:
        return HOLDS_S
    more = {"fall-weight": "adding_s", "fall-relax": "relaxing_s", "pick-up": "lift_s"}
    return (numbers[more[kind]] if kind in more else 0.0) + WATCH_S


def gives_up_s(kind: str, numbers: dict[str, float]) -> float:
    """From the event until the other person lets go, s."""
    if kind == "pull-fast":
        return max(1.0, numbers["fast_s"] + 0.5)
    if kind == "pull-slow":
        return max(1.0, numbers["slow_s"] + 0.5)
    if kind in TUGS:
        return numbers["tug_s"] + 0.05
    return 3.0
