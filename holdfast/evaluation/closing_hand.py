"""Closing in time: a small model of whether a hand that acts on an alarm still holds the object.

From the request on, the hand closes at v_max (1 - exp(-t / lag)): a rate limit behind a
first-order lag. Its travel squeezes fingers and object, springs in series, the contacts of one side
against those of the other (a and b fingertips' stiffness by the hand card; usual hand 2 and 4):

    N(t) = grip + travel(t) / c,    c = 1 / (a k) + 1 / (b k),    N <= 70 N a side
    k = fingertip and object in series

The object is a mass on one line, the hand's skin a spring along it that lets go at 2 mu N (static
until it slides, kinetic until it rests again). A pull is a spring and damper on a minimum-jerk
path, capped, with the weight on top; a fall is the weight, as its support vanishes. The model of a
hand that does nothing gives how far the object had moved when contact was lost. A hand that acts
keeps the object if it comes to rest before it has moved so far, and keeps it without a slip if it
slid less than 2 mm, which is the truth's threshold of gross slip.

From the truth: load onset, gross slip, contact lost, grip, stiffness, friction, and the pull.
Assumed: LAG_S; no dead time in addition; all fingers close together (the real hand drives three
and the others follow); the puller does not pull harder because the hand resists; no ball is
squeezed out. `model_error_ms` compares its slips with those of the truth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, astuple, dataclass, fields
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import BoolArray, FloatArray
from holdfast.core.hand_card import HandCard, usual_hand
from holdfast.evaluation.statistics import spread
from holdfast.evaluation.trials import Grasp
from holdfast.training.timeline import RiskyEvent

CLOSING_S = 0.37
"""Full stroke of the Michelangelo hand (Front. Syst. Neurosci. 9:162, 2015, table 1)."""
STROKE_MM = 120.0
"""Its opening width (thesis, 5.1.1); over CLOSING_S, 324 mm/s."""
MOST_N = 70.0
"""Its opposition grip (thesis, 5.1.1)."""
LAG_S = 0.05
"""Time constant of motor and gear: an assumption, since none is published; LAGS_S are others."""
LAGS_S = (0.0, 0.02, 0.1)
"""Other time constants, to show how much of the result hangs on the assumed one."""
GRAVITY_M_S2 = 9.81
DAMPING_RATIO = 0.7
"""Of the puller's arm and of the skin while it sticks, as the scenes have it."""
STEP_S = 0.0005
"""Step of the integration."""
LOOK_S = 0.6
"""Each event is stepped for this long from its load onset."""
DROPS_AT_ONCE = 512
"""Their arrays stay within tens of MB."""
GROSS_SLIP_M = 2e-3
"""Travel from which the truth of a scene calls a slip gross."""
MODELLED = ("pull", "fall")
"""Actions in which an object is lost against the wearer's will."""


@dataclass(frozen=True)
class ClosingHand:
    """How a hand closes."""

    closing_s: float = CLOSING_S
    stroke_mm: float = STROKE_MM
    lag_s: float = LAG_S
    most_n: float = MOST_N

    def travel_m(self, since_s: FloatArray) -> FloatArray:
        """By how much the opening has shrunk, s after the request to act (0 before)."""
        # Before the request the hand has not moved at all.
        t = np.maximum(since_s, 0.0)
        # The lag integrated: for t much longer than it, the travel is late by the whole lag.
        behind: FloatArray | float = 0.0
        if self.lag_s:
            behind = self.lag_s * -np.expm1(-t / self.lag_s)
        speed_m_s = 1e-3 * self.stroke_mm / self.closing_s
        travel: FloatArray = speed_m_s * (t - behind)
        return travel


@dataclass(frozen=True)
class Drop:
    """One event that can be modelled. Times in s since load onset; the puller's are 0 in a fall."""

    gross_s: float
    lost_s: float
    mass_kg: float
    grip_n: float
    squeeze_n_per_m: float
    skin_n_per_m: float
    static: float
    kinetic: float
    vanish_s: float
    arm_n_per_m: float
    distance_m: float
    move_s: float
    cap_n: float


def drop_of(
    event: RiskyEvent, grasp: Grasp | None, hand: HandCard | None = None
) -> Drop | None:
    """The event as the model sees it; None where its truth is not complete (a hold).

    hand: the set's hand card, None for the usual hand.
    """
    if grasp is None or grasp.action not in MODELLED or event.gross_s is None:
        return None
    # Recorded and older simulated truths do not give the object.
    if "thing" not in grasp.truth:
        return None
    drawn = grasp.truth["drawn"]
    held = grasp.truth["thing"]
    finger = drawn["finger_n_per_m"]
    stuff = held["stiffness_n_per_m"]
    # Springs in series: their compliances add, so the softer of the two decides.
    series = finger * stuff / (finger + stuff)
    # The contacts of a side are parallel, and both sides in series.
    parts = (hand or usual_hand()).side_parts
    compliance = sum(1.0 / (part * series) for part in parts)
    friction = held["friction"] * drawn["friction_factor"]

    return Drop(
        # The model starts at load onset, so its times count from there.
        gross_s=event.gross_s - event.onset_s,
        lost_s=event.end_s - event.onset_s,
        mass_kg=1e-3 * held["mass_g"],
        grip_n=float(grasp.truth["grip_n"]),
        squeeze_n_per_m=1.0 / compliance,
        # All contacts share the load along the skin, so their shear springs are parallel.
        skin_n_per_m=sum(parts) * finger * drawn["shear_ratio"],
        static=friction,
        kinetic=friction * held["kinetic_share"],
        vanish_s=drawn.get("vanish_s", 0.0),
        arm_n_per_m=drawn.get("arm_n_per_m", 0.0),
        distance_m=drawn.get("distance_m", 0.0),
        # A fall has no puller: any time above 0 avoids a division by 0, since the distance is 0.
        move_s=drawn.get("move_s", 1.0),
        cap_n=drawn.get("cap_n", 0.0),
    )


@dataclass(frozen=True)
class Slide:
    """What became of E objects after K steps.

    moved_m [K, E]. slid_m [E]. slides_from_s [E], inf: never. rests [E]: at rest in the end.
    """

    moved_m: FloatArray
    slid_m: FloatArray
    slides_from_s: FloatArray
    rests: BoolArray


@dataclass(frozen=True)
class _Course:
    """What drives E drops and does not depend on how they move, each [K, E] over K steps.

    path_m, path_m_s: the puller's hand. weight_n: of the object that the support has let go.
    normal_n: of the grip on one side.
    """

    path_m: FloatArray
    path_m_s: FloatArray
    weight_n: FloatArray
    normal_n: FloatArray


def _course(
    drop: dict[str, FloatArray], request_s: FloatArray, hand: ClosingHand
) -> _Course:
    n_steps = round(LOOK_S / STEP_S)
    # A row for each step and a column for each drop, so that all are stepped at once.
    t_s = np.arange(n_steps)[:, None] * STEP_S
    # A request that never comes is at infinity: its hand does not travel.
    since_s = np.where(np.isfinite(request_s), t_s - request_s, 0.0)
    squeezed_n = drop["squeeze_n_per_m"] * hand.travel_m(since_s)
    # A grip that is already above what the hand can close with stays as it is.
    most_n = np.maximum(hand.most_n, drop["grip_n"])
    normal_n = np.minimum(drop["grip_n"] + squeezed_n, most_n)

    share = np.minimum(t_s / drop["move_s"], 1.0)
    mean_m_s = drop["distance_m"] / drop["move_s"]
    # The derivative of the minimum-jerk path.
    path_m_s = mean_m_s * 30.0 * (share * (1.0 - share)) ** 2

    # A pulled object has no support; a falling one loses its own over vanish_s.
    falls = drop["cap_n"] == 0.0
    support_gone = _minimum_jerk(t_s / np.maximum(drop["vanish_s"], STEP_S))
    let_go = np.where(falls, support_gone, 1.0)

    return _Course(
        path_m=drop["distance_m"] * _minimum_jerk(share),
        path_m_s=path_m_s,
        weight_n=drop["mass_kg"] * GRAVITY_M_S2 * let_go,
        normal_n=normal_n,
    )


def slide(drops: Sequence[Drop], request_s: npt.ArrayLike, hand: ClosingHand) -> Slide:
    """Step the drops from their load onset on, the hand closing from request_s [E] (inf: never)."""
    names = [field.name for field in fields(Drop)]
    # Columns instead of objects: a step is then one operation for all drops.
    rows = [astuple(one) for one in drops]
    # The shape keeps the columns where there is no drop at all.
    table = np.array(rows).reshape(len(drops), len(names))
    drop = dict(zip(names, table.T, strict=True))
    # The course does not depend on how an object moves, so it is computed once for all steps.
    course = _course(drop, np.asarray(request_s, dtype=np.float64), hand)

    mass = drop["mass_kg"]
    skin = drop["skin_n_per_m"]
    arm = drop["arm_n_per_m"]
    # The object slides between two sides, each with the friction of its normal force.
    static_n = 2.0 * drop["static"] * course.normal_n
    kinetic_n = 2.0 * drop["kinetic"] * course.normal_n

    # Critical damping of a spring k and a mass m is 2 sqrt(k m).
    skin_damping = 2.0 * DAMPING_RATIO * np.sqrt(skin * mass)
    arm_damping = 2.0 * DAMPING_RATIO * np.sqrt(arm * mass)

    # All drops start at rest, where their support or the puller left them.
    at = np.zeros(len(drops))
    speed = np.zeros(len(drops))
    slid = np.zeros(len(drops))
    # A pulled object hangs in the skin already.
    hanging = mass * GRAVITY_M_S2 / skin
    stretch = np.where(drop["cap_n"] == 0.0, 0.0, hanging)
    slides_from_s = np.full(len(drops), np.inf)
    sliding = np.zeros(len(drops), dtype=np.bool_)
    # The whole path is kept: what counts is how far an object ever got.
    moved = np.empty(course.normal_n.shape)

    for k in range(len(moved)):
        behind_m = course.path_m[k] - at
        behind_m_s = course.path_m_s[k] - speed
        arm_n = arm * behind_m + arm_damping * behind_m_s
        # An arm pulls and never pushes.
        pull_n = np.minimum(np.maximum(arm_n, 0.0), drop["cap_n"])
        load_n = pull_n + course.weight_n[k]

        # Sticking skin is a spring and a damper between finger and object.
        stuck_n = skin * stretch + skin_damping * speed
        limit_n = np.where(sliding, kinetic_n[k], static_n[k])
        # Once it slides it goes on sliding at the lower kinetic friction, until its speed is 0.
        sliding = (sliding | (stuck_n > limit_n)) & (speed > 0.0)
        slides_from_s[sliding & np.isinf(slides_from_s)] = k * STEP_S
        held_n = np.where(sliding, kinetic_n[k], np.minimum(stuck_n, limit_n))

        # Semi-implicit Euler: the new speed moves the object, which keeps stiff springs stable.
        speed = speed + STEP_S * (load_n - held_n) / mass
        # What slides comes to rest; it does not slide back.
        speed = np.where(sliding, np.maximum(speed, 0.0), speed)
        # While it slides, the skin stays stretched by the friction that drags on it.
        stretch = np.where(sliding, kinetic_n[k] / skin, stretch + STEP_S * speed)
        slid = slid + np.where(sliding, STEP_S * speed, 0.0)
        at = at + STEP_S * speed
        moved[k] = at

    return Slide(moved, slid, slides_from_s, ~sliding)


def _minimum_jerk(u: FloatArray) -> FloatArray:
    """0 to 1 with minimum jerk."""
    u = np.clip(u, 0.0, 1.0)
    # 10 u^3 - 15 u^4 + 6 u^5 (Flash and Hogan, J. Neurosci. 5, 1985).
    risen: FloatArray = u * u * u * (10.0 + u * (6.0 * u - 15.0))
    return risen


@lru_cache(maxsize=2)
def _never_closed(drops: tuple[Drop, ...]) -> Slide:
    """The drops in a hand that never closes."""
    return slide(drops, np.full(len(drops), np.inf), ClosingHand())


def _distance_when_lost_m(drops: tuple[Drop, ...]) -> FloatArray:
    """[E] how far each object had moved in a hand that did nothing when contact was lost."""
    moved = _never_closed(drops).moved_m
    lost_at = [round(one.lost_s / STEP_S) for one in drops]
    steps = np.array(lost_at, dtype=np.int64)
    # Contact that is lost after LOOK_S is taken at the last step.
    last = np.minimum(steps, len(moved) - 1)
    distance: FloatArray = moved[last, np.arange(len(drops))]
    return distance


@dataclass(frozen=True)
class KeptObjects:
    """What a hand still holds. preventable: kept by a hand that closes from load onset on.

    kept, kept_share and kept_without_a_slip are of the preventable ones. modelled: of all events.
    """

    hand: ClosingHand
    events: int
    modelled: int
    preventable: int
    not_preventable: int
    kept: int
    kept_share: float | None
    kept_without_a_slip: int


class Droppable:
    """The events of many streams, in order, for a hand. drops: None where one is not modelled."""

    def __init__(
        self, drops: Sequence[Drop | None], hand: ClosingHand | None = None
    ) -> None:
        self.hand = hand or ClosingHand()
        is_modelled = [drop is not None for drop in drops]
        self._is_modelled = np.array(is_modelled, np.bool_)
        self._drops = tuple(drop for drop in drops if drop is not None)
        self._lost_at_m = _distance_when_lost_m(self._drops)

        # A hand that closes from load onset on keeps it.
        from_onset_s = np.zeros((1, len(self._drops)))
        held, _ = self._held(from_onset_s)
        self._preventable = held[0]

    def kept(self, delays_s: Sequence[float | None]) -> KeptObjects:
        """What the hand keeps. The request in each event: s after load onset (None: no request)."""
        return self.kept_by_each([delays_s])[0]

    def kept_by_each(
        self, delays_s: Sequence[Sequence[float | None]]
    ) -> list[KeptObjects]:
        """The same for several lists of requests, whose drops are stepped together."""
        # None becomes nan as a float, and a request that never comes is at infinity.
        delays = np.array(delays_s, dtype=np.float64)
        from_s = np.where(np.isnan(delays), np.inf, delays)
        held, still = self._held(from_s[:, self._is_modelled])

        kept = []
        for held_here, still_here in zip(held, still, strict=True):
            kept.append(self._kept(held_here, still_here))

        return kept

    def _held(self, request_s: FloatArray) -> tuple[BoolArray, BoolArray]:
        """[L, E] whether each object is still in the hand, and whether it did not even slip.

        request_s [L, E]: of L lists of requests.
        """
        drops = self._drops * len(request_s)
        lost_at_m = np.tile(self._lost_at_m, len(request_s))
        from_s = request_s.ravel()
        held = np.zeros(len(drops), dtype=np.bool_)
        still = np.zeros(len(drops), dtype=np.bool_)

        # Drops do not touch each other, so the order and the size of the parts change nothing.
        for start in range(0, len(drops), DROPS_AT_ONCE):
            some = slice(start, start + DROPS_AT_ONCE)
            end = slide(drops[some], from_s[some], self.hand)
            # An object that was past the point of no return is lost, even if it came back.
            farthest_m = end.moved_m.max(axis=0, initial=0.0)
            held[some] = end.rests & (farthest_m < lost_at_m[some])
            still[some] = held[some] & (end.slid_m < GROSS_SLIP_M)

        return held.reshape(request_s.shape), still.reshape(request_s.shape)

    def _kept(self, held: BoolArray, still: BoolArray) -> KeptObjects:
        # What no hand could keep is no measure of when the request came.
        n = int(self._preventable.sum())
        n_kept = int((held & self._preventable).sum())
        n_still = int((still & self._preventable).sum())

        return KeptObjects(
            hand=self.hand,
            events=len(self._is_modelled),
            modelled=len(self._drops),
            preventable=n,
            not_preventable=len(self._drops) - n,
            kept=n_kept,
            kept_share=n_kept / n if n else None,
            kept_without_a_slip=n_still,
        )


def droppable(drops: Sequence[Drop | None]) -> Droppable | None:
    """The bounds for the usual hand; None where no event is modelled."""
    return Droppable(drops) if any(drops) else None


@dataclass(frozen=True)
class ClosingModel:
    """How far the model is off the truth, ms, and what other lags of the hand (ms) would keep."""

    model_error_ms: dict[str, float] | None
    by_lag_ms: dict[str, KeptObjects]


def closing_model(
    drops: Sequence[Drop | None], delays_s: Sequence[float | None]
) -> ClosingModel | None:
    """Check the model, and vary its lag; None where no event is modelled."""
    if not any(drops):
        return None

    by_lag = {}
    for lag_s in LAGS_S:
        # Only the lag: it is the one number of the hand that is assumed.
        hand = ClosingHand(lag_s=lag_s)
        lag_ms = f"{1e3 * lag_s:g}"
        by_lag[lag_ms] = Droppable(drops, hand).kept(delays_s)

    return ClosingModel(model_error_ms(drops), by_lag)


def model_error_ms(drops: Sequence[Drop | None]) -> dict[str, float] | None:
    """The model's slip in a hand at rest minus the truth's gross slip; None without drops."""
    known = tuple(drop for drop in drops if drop is not None)
    if not known:
        return None

    # At rest, the hand has no part in the error: only the contact model is compared.
    from_s = _never_closed(known).slides_from_s
    # Known from the scene, and used nowhere in the model itself.
    true_s = np.array([one.gross_s for one in known])
    off_ms = 1e3 * (from_s - true_s)
    # An object that never slides in the model has no error of time; it is counted in "of".
    off_ms = off_ms[np.isfinite(off_ms)]
    found = spread(off_ms.tolist())
    error: dict[str, float] = asdict(found) if found else {}
    return error | {"slips": len(off_ms), "of": len(known)}
