"""What becomes of one trial in one hand, and the hands that need no model: bare, and the oracles.

The oracle knows what will come. From the load onset of the bare hand on it closes to a multiple of
the grip that the largest load needs, or to the drive's ceiling, by the same drive. A drop is
preventable where any of these closures saves the object.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from benchmarks.loop_figures import HELD_N
from benchmarks.world.draws import WorldTrial, draw_trial
from benchmarks.world.hand import DRIVE, RATE_HZ, World
from holdfast.core.contract import FloatArray

CLOSURES = (1.1, 1.5, 2.0, 3.0)
"""Multiples of the grip that the largest load needs; the last closure is the drive's ceiling."""
CEILING = "ceiling"
LOAD_N = 0.1
"""Load onset: people and box push differently by this much, as in our scenes."""
RELAXED_N = 0.1
"""Load onset of a relaxing grip: the wearer commands so much less."""
LOST_SAMPLES = 23
"""Thumb or fingers without contact for so long, 0.15 s: the object is gone. It leaves one side for
a shorter time when a pull presses it against the other, and comes back."""
SETTLE_S = 0.1
SETTLED_MM = 0.5
"""A hold that slides further between the giver's letting go and the event is drawn again."""
GROSS_MM = 2.0
"""Gross slip, as in our scenes. Kinds that friction holds stay below it in the bare hand."""
KNOWS_AFTER_S = 0.02
"""A hand that knows so long after load onset: no hand knows at its onset."""
MUST_HOLD = ("tug-held", "pick-up", "quiet-hold", "trembling-hold")
MOST_ATTEMPTS = 200
REFUSALS = ("grip or load", "hold slides", "friction does not hold it", "unstable")
"""Why a draw was refused: by ranges.py, before the event, in the event, by MuJoCo itself."""


@dataclass
class Outcome:
    """What became of the object. Times in s of the trial; inf for what never happened.

    lost_s   thumb or fingers lose contact for good
    onset_s  load onset
    slip_mm  how far the pads slid from the event on, mean of those that touch
    peak_n   largest change of the force of people and box since the event, while it is held
    peak_before_n  the same up to the wearer's opening
    held_on_s  how long after its wearer's grip has gone, by an opening, the hand still grips
    grip_n   largest grip of the drive from the event on, N a side
    """

    lost_s: float = np.inf
    onset_s: float = np.inf
    slip_mm: float = 0.0
    peak_n: float = 0.0
    peak_before_n: float = 0.0
    held_on_s: float = 0.0
    grip_n: float = 0.0


@dataclass
class Watch:
    """Reads an outcome off a world, sample by sample."""

    world: World
    outcome: Outcome = field(default_factory=Outcome)

    def __post_init__(self) -> None:
        self._apart = 0
        self._before_n: FloatArray | None = None
        self._from_m: FloatArray | None = None
        self._own_gone_s = np.inf

    @property
    def over(self) -> bool:
        """The object is gone, or the trial has ended."""
        trial = self.world.trial
        return self.world.t_s >= trial.end_s or bool(np.isfinite(self.outcome.lost_s))

    def look(self) -> None:
        """Take in the world after a sample period."""
        world = self.world
        if world.t_s < world.trial.give_s:
            return
        self._apart = 0 if world.gripped else self._apart + 1
        if self._apart >= LOST_SAMPLES:
            self.outcome.lost_s = world.t_s - (LOST_SAMPLES - 1) / RATE_HZ
            return
        if world.t_s >= world.trial.act_s:
            self._look_at_event()

    def _look_at_event(self) -> None:
        world = self.world
        found = self.outcome
        if self._before_n is None or self._from_m is None:
            self._before_n = world.outside_n.copy()
            self._from_m = world.contact_places_m()
        change = world.outside_n - self._before_n
        change_n = float(np.sqrt(change @ change))
        relaxes = world.script.own_n(world.t_s) < world.trial.grip_n - RELAXED_N
        relaxes = relaxes and world.trial.kind == "fall-relax"
        if np.isinf(found.onset_s) and (change_n > LOAD_N or relaxes):
            found.onset_s = world.t_s
        if self._apart:
            return
        found.peak_n = max(found.peak_n, change_n)
        if world.t_s < world.trial.open_s:
            found.peak_before_n = found.peak_n
        else:
            self._look_after_opening()
        found.grip_n = max(found.grip_n, float(world.drive.grip_n[0]))
        found.slip_mm = slid_mm(world, self._from_m)

    def _look_after_opening(self) -> None:
        """How long the hand grips beyond its wearer, in whose bare hand nothing else moves it."""
        world = self.world
        if world.script.own_n(world.t_s) <= HELD_N:
            self._own_gone_s = min(self._own_gone_s, world.t_s)
        if float(world.drive.grip_n[0]) > HELD_N and world.t_s > self._own_gone_s:
            self.outcome.held_on_s = world.t_s - self._own_gone_s


def slid_mm(world: World, from_m: FloatArray) -> float:
    """How far the touching pads are from from_m [S, 3], in the object's frame; the mean, mm."""
    touching = world.touching()
    moved = world.contact_places_m() - from_m
    if not touching.any():
        return 0.0
    return float(1e3 * np.sqrt((moved * moved).sum(axis=1))[touching].mean())


@dataclass
class BareRun:
    """A trial in the hand that does nothing. at_event: the world when the event begins."""

    trial: WorldTrial
    outcome: Outcome
    at_event: World


def bare_run(trial: WorldTrial, pads: str) -> BareRun | str:
    """The bare hand; or why the draw is refused (of REFUSALS)."""
    try:
        return _bare_run(trial, pads)
    except FloatingPointError:
        return REFUSALS[3]


def _bare_run(trial: WorldTrial, pads: str) -> BareRun | str:
    world = World(trial, pads)
    if not settled(world):
        return REFUSALS[1]
    at_event = world.copy()
    watch = Watch(world)
    while not watch.over:
        world.advance(0.0)
        watch.look()
    found = watch.outcome
    if trial.kind in MUST_HOLD and (
        np.isfinite(found.lost_s) or found.slip_mm > GROSS_MM
    ):
        return REFUSALS[2]
    return BareRun(trial, found, at_event)


def settled(world: World) -> bool:
    """Step to the event; whether the hold stands until then."""
    trial = world.trial
    from_s = trial.give_s + trial.numbers["give_s"] + SETTLE_S
    if trial.kind == "fall-support":
        from_s = trial.act_s - trial.numbers["hold_s"]
    from_m: FloatArray | None = None
    while world.t_s < trial.act_s:
        world.advance(0.0)
        if world.t_s < from_s:
            continue
        if not world.gripped:
            return False
        if from_m is None:
            from_m = world.contact_places_m()
    return from_m is None or slid_mm(world, from_m) < SETTLED_MM


def possible_run(
    kind: str, repetition: int, seed: int, pads: str, first: int = 0
) -> tuple[BareRun, dict[str, int]]:
    """(the first draw whose hold is possible, in the bare hand; how many draws were refused why).

    first: the attempt to begin with. A draw must be possible with single points too, so that both
    kinds of pads mostly have the same trials.
    """
    refused = dict.fromkeys(REFUSALS, 0)
    for _ in range(MOST_ATTEMPTS):
        trial = draw_trial(kind, repetition, seed, first)
        refused[REFUSALS[0]] += trial.attempt - first
        first = trial.attempt + 1
        run: BareRun | str = ""
        for which in dict.fromkeys(("point", pads)):
            run = bare_run(trial, which)
            if isinstance(run, str):
                refused[run] += 1
                break
        if isinstance(run, BareRun):
            return run, refused
    raise RuntimeError(f"{kind} {repetition}: no hold in {MOST_ATTEMPTS} draws")


def oracle_saves(run: BareRun, knows_after_s: float = 0.0) -> str | None:
    """The first closure that keeps the object, or None. knows_after_s: later than load onset."""
    need_n = run.trial.need_n
    targets = {f"{multiple:g}": multiple * need_n for multiple in CLOSURES}
    targets[CEILING] = DRIVE.ceiling_n
    for name, target_n in targets.items():
        if np.isinf(closed_from_onset(run, target_n, knows_after_s).lost_s):
            return name
    return None


def closed_from_onset(
    run: BareRun, target_n: float, knows_after_s: float = 0.0
) -> Outcome:
    """The trial with a drive that gets this target from the bare hand's load onset on, or later."""
    world = run.at_event.copy()
    watch = Watch(world)
    while not watch.over:
        begun = world.t_s >= run.outcome.onset_s + knows_after_s
        world.advance(target_n if begun else 0.0)
        watch.look()
    return watch.outcome
