"""docs/first-sight.svg: a slip and a hand-over, with and without Holdfast, ten times slower.

`make docs` simulates the demo's two trials in a closed loop with the shipped model, and draws what
became of object, grip, load and answer (demo_picture.svg). The animation is CSS; a
reader who asked for less motion sees its end. first-sight-phone.svg is the same, for a phone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from examples.demo.demo_grip import CARD, SEED, half_managed, opened_s
from holdfast.core.contract import SITUATIONS, FloatArray
from holdfast.edge_runtime.engine import OpenedModel
from holdfast.edge_runtime.grip import GripSense
from holdfast.evaluation.style import SITUATION_COLOURS, with_label
from holdfast.simulation.loop.closed_loop import ClosedLoop, LoopController, LoopTruth
from holdfast.simulation.loop.people import LoopOutcome
from holdfast.simulation.scenes.protocol import PlannedTrial
from holdfast.simulation.scenes.scene import Scene
from holdfast.simulation.scenes.scene_file import read_scene_file

TEMPLATES = Path(__file__).parent
LABEL = (
    "Simulated, ten times slower. A bottle slips: without Holdfast it is lost; with Holdfast the "
    "slip is called, the grip tightens and the bottle is kept. In a quick hand-over a slip is "
    "called too, and the hand lets go when its wearer opens it."
)
BEFORE_S, AFTER_S = 0.2, 0.6
"""What is shown, from the beginning of the action."""
SLOWER = 10
PAUSE_S = 3.0
"""The end is shown for so long before it begins again; the picture begins with it."""
FRAME_S = 0.02
"""Of the trial, from one place of the object to the next; between them it moves evenly."""
PLOT_PX, TOP_PX, BOTTOM_PX = 250, 330, 440
"""Width of a plot, and its edges."""
HIGH_N = 16.0
PX_PER_MM = 1.3
LIKELY = 0.5
"""A sample is drawn as the slip whose probability is at least this."""


@dataclass(frozen=True)
class Seen:
    """One trial as it is drawn; arrays over the samples shown.

    t_s        from the beginning of the action
    moved_mm   path of the object
    situation  place in SITUATIONS
    """

    outcome: LoopOutcome
    t_s: FloatArray
    moved_mm: FloatArray
    grip_n: FloatArray
    load_n: FloatArray
    situation: list[int]


class _WatchedLoop(ClosedLoop):
    """A closed loop that also keeps where the objects were."""

    def note(self, period: int, target_n: FloatArray) -> None:
        """Write down one sample period."""
        super().note(period, target_n)
        self.position_m.append(self.world.position_m.copy())

    def run(self) -> list[LoopOutcome]:
        """Run to the end."""
        self.position_m: list[FloatArray] = []
        return super().run()


class _Watched:
    """A controller whose senses are kept."""

    def __init__(self, controller: LoopController) -> None:
        self._controller, self.mu_hat = controller, controller.mu_hat
        self.senses: list[GripSense] = []

    def step(self, sense: GripSense, now: LoopTruth) -> FloatArray:
        """[B] target, N a side."""
        self.senses.append(sense)
        return self._controller.step(sense, now)


@dataclass(frozen=True)
class Piece:
    """Samples of the same answer, as a piece of the band; px."""

    x: str
    width: str
    colour: str


@dataclass(frozen=True)
class Column:
    """What the template draws of one hand. moved_px, arrow: a frame each."""

    title: str
    end: str
    good: bool
    taken: bool
    moved_px: list[float]
    arrow: list[float]
    band: list[Piece]
    load: str
    grip: str


def picture(model: OpenedModel, across: int = 3) -> str:
    """The picture: a bottle in a bare hand, the same with the grip controlled, a hand-over.

    across: how many of these stand side by side, 3 or, for a phone, 1.
    """
    bare_fall, _, held_fall, held_pass = watch(model)
    columns = [
        _column("Without Holdfast: a slip", bare_fall, _lost(bare_fall), says=False),
        _column("With Holdfast: a slip", held_fall, _kept(held_fall)),
        _column("Its wearer opens the hand", held_pass, _taken(held_pass)),
    ]
    shown_s = BEFORE_S + AFTER_S
    cycle_s = SLOWER * shown_s + PAUSE_S
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        autoescape=True,
    )
    drawn = environment.get_template("demo_picture.svg").render(
        columns=columns,
        across=across,
        down=len(columns) // across,
        legend=list(
            zip(
                ("empty", "grasp", "hand-over", "slip"),
                SITUATION_COLOURS,
                strict=True,
            )
        ),
        plot=PLOT_PX,
        zero=f"{PLOT_PX * BEFORE_S / shown_s:.1f}",
        cycle_s=f"{cycle_s:g}",
        begin_s=f"{SLOWER * shown_s:g}",
        played=round(100 * SLOWER * shown_s / cycle_s, 1),
        after_ms=f"{1e3 * AFTER_S:.0f}",
        high_n=f"{HIGH_N:.0f}",
        slower=SLOWER,
    )
    return with_label(drawn, LABEL) + "\n"


def watch(model: OpenedModel) -> list[Seen]:
    """Fall and pass in a hand that does nothing, then both with the grip controlled."""
    scene = Scene(read_scene_file(str(CARD)), SEED)
    trials = scene.trials()
    watched: list[_Watched] = []

    def make(planned: Sequence[PlannedTrial], rate_hz: float) -> LoopController:
        watched.append(_Watched(half_managed(scene)(planned, rate_hz)))
        return watched[0]

    loop = _WatchedLoop(scene, [*trials, *trials], model, make)
    outcomes = loop.run()
    position_m, senses = np.array(loop.position_m), watched[0].senses
    return [_seen(one, k, position_m, senses) for k, one in enumerate(outcomes)]


def _seen(
    one: LoopOutcome, k: int, position_m: FloatArray, senses: Sequence[GripSense]
) -> Seen:
    t_s = one.begin_s + np.arange(len(one.grip_n)) / one.rate_hz - one.act_s
    first, stop = np.searchsorted(t_s, (-BEFORE_S, AFTER_S))
    shown = slice(int(first), int(stop))
    away_m = position_m[shown, k] - position_m[first, k]
    return Seen(
        one,
        t_s[shown],
        1e3 * np.sqrt((away_m * away_m).sum(axis=1)),
        one.grip_n[shown].astype(float),
        np.array([sense.load_n[k] for sense in senses[shown]]),
        [_situation(sense, k) for sense in senses[shown]],
    )


def _situation(sense: GripSense, k: int) -> int:
    if sense.empty[k]:
        return SITUATIONS.index("nothing")
    if sense.p_risky[k] >= LIKELY:
        return SITUATIONS.index("risky_slip")
    return SITUATIONS.index("safe_slip" if sense.p_safe[k] >= LIKELY else "grasp")


def _lost(one: Seen) -> str:
    return f"lost after {1e3 * (one.outcome.lost_s - one.outcome.act_s):.0f} ms"


def _kept(one: Seen) -> str:
    held = one.outcome
    t_s = held.begin_s + np.arange(len(held.p_risky)) / held.rate_hz - held.act_s
    noticed = (held.p_risky >= held.evidence_p) & (t_s >= 0.0)
    return f"noticed after {1e3 * t_s[noticed][0]:.0f} ms, kept"


def _taken(one: Seen) -> str:
    after_ms = 1e3 * (one.outcome.lost_s - opened_s(one.outcome))
    return f"let go {after_ms:.0f} ms after it was opened"


def _column(title: str, one: Seen, end: str, *, says: bool = True) -> Column:
    """says: whether there is a model whose answer is drawn."""
    taken = one.outcome.trial.action == "pass"
    x = PLOT_PX * (one.t_s + BEFORE_S) / (BEFORE_S + AFTER_S)
    up = -1.0 if taken else 1.0
    return Column(
        title,
        end,
        good=taken or not one.outcome.dropped,
        taken=taken,
        moved_px=_frames(one, up * PX_PER_MM * one.moved_mm),
        arrow=_frames(one, one.grip_n / HIGH_N),
        band=_band(x, one.situation) if says else [],
        load=_points(x, one.load_n),
        grip=_points(x, one.grip_n),
    )


def _frames(one: Seen, values: FloatArray) -> list[float]:
    frames_s = np.arange(-BEFORE_S, AFTER_S + FRAME_S / 2, FRAME_S)
    at: list[float] = np.interp(frames_s, one.t_s, values).tolist()
    return at


def _points(x: FloatArray, values_n: FloatArray) -> str:
    high = np.minimum(values_n, HIGH_N) / HIGH_N
    y = BOTTOM_PX - (BOTTOM_PX - TOP_PX) * high
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))


def _band(x: FloatArray, situation: Sequence[int]) -> list[Piece]:
    edges = [*x.tolist(), float(PLOT_PX)]
    pieces, start = [], 0
    for which, same in groupby(situation):
        stop = start + len(list(same))
        width = edges[stop] - edges[start]
        colour = SITUATION_COLOURS[which]
        pieces.append(Piece(f"{edges[start]:.1f}", f"{width:.1f}", colour))
        start = stop
    return pieces
