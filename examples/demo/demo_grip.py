"""The end of the demo: the loop is closed. A bottle is caught. A quick hand-over is called a slip,
and the hand lets go as soon as its wearer opens it, whatever is asked for.

Each trial runs twice in one scene: in a hand that does nothing, and in one whose grip is controlled
by the released model. All of it is simulated.
"""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.edge_runtime.grip import GripSense
from holdfast.edge_runtime.model import Model
from holdfast.evaluation.style import OURS, QUIET, WARNING, labelled, svg
from holdfast.simulation.loop.closed_loop import (
    ClosedLoop,
    LoopController,
    LoopTruth,
    Make,
    managed,
)
from holdfast.simulation.loop.people import LoopOutcome
from holdfast.simulation.scenes.protocol import PlannedTrial
from holdfast.simulation.scenes.scene import Scene
from holdfast.simulation.scenes.scene_file import read_scene_file

CARD = Path(__file__).parent / "demo_grip.toml"
SEED = 6
NAMES = {"fall": "a bottle let go", "pass": "a quick hand-over"}


@dataclass(frozen=True)
class TwoHands:
    """One trial in a hand that does nothing, and in one that answers."""

    bare: LoopOutcome
    held: LoopOutcome

    @property
    def sentence(self) -> str:
        """What became of it."""
        name = NAMES[self.bare.trial.action]
        before, after = (_fate(one) for one in (self.bare, self.held))
        return f"{name}: without Holdfast {before}, with it {after}"


def close_the_loop(model: Model) -> list[TwoHands]:
    """Both trials, in both hands."""
    scene = Scene(read_scene_file(str(CARD)), SEED)
    trials = scene.trials()
    loop = ClosedLoop(scene, [*trials, *trials], model, half_managed(scene))
    outcomes = loop.run()
    n = len(trials)
    return [TwoHands(outcomes[k], outcomes[n + k]) for k in range(n)]


class _Half:
    """Controls the second half of the hands; the others keep their own grip."""

    def __init__(self, controller: LoopController, lanes: int) -> None:
        self._controller, self.mu_hat = controller, controller.mu_hat
        self._controlled = np.arange(lanes) >= lanes // 2

    def step(self, sense: GripSense, now: LoopTruth) -> FloatArray:
        """[B] target, N a side."""
        target_n = self._controller.step(sense, now)
        self.mu_hat = self._controller.mu_hat
        wanted: FloatArray = np.where(self._controlled, target_n, 0.0)
        return wanted


def half_managed(scene: Scene) -> Make:
    """A maker of a controller that leaves the first half of the hands alone."""
    make = managed(scene)

    def both(trials: Sequence[PlannedTrial], rate_hz: float) -> LoopController:
        return _Half(make(trials, rate_hz), len(trials))

    return both


def opened_s(one: LoopOutcome) -> float:
    """When the wearer of a hand began to open it, on the trial's clock."""
    t_s = one.begin_s + np.arange(len(one.own_n)) / one.rate_hz
    opens = (one.own_n < one.trial.grip_n - 0.01) & (t_s > one.act_s)
    return float(t_s[opens.argmax()])


def _fate(one: LoopOutcome) -> str:
    if one.trial.action == "pass":
        after_ms = 1e3 * (one.lost_s - opened_s(one))
        if after_ms > 0.0:
            return f"let go {after_ms:.0f} ms after its wearer opened"
        return f"torn away {-after_ms:.0f} ms before its wearer opened"
    return (
        f"lost after {1e3 * (one.lost_s - one.act_s):.0f} ms" if one.dropped else "kept"
    )


def section(pairs: Sequence[TwoHands]) -> str:
    """The section of the demo's report, HTML."""
    lines = "".join(f"<li>{html.escape(one.sentence)}</li>" for one in pairs)
    return f"""<h2>The loop closed</h2>
<p class=note>The grip of a hand that does nothing, and of one that the model controls, in the same
scene. Dotted: contact ends. Two trials, chosen to show it; simulated.</p>
<ul>{lines}</ul><div class=wide>{picture(pairs)}</div>"""


def picture(pairs: Sequence[TwoHands]) -> str:
    """The grip over time in both hands, one panel a trial; SVG."""
    with labelled("simulated", 9.0, 2.8) as figure:
        for place, pair in enumerate(pairs, 1):
            axes = figure.add_subplot(1, len(pairs), place)
            for one, colour, name in (
                (pair.bare, QUIET, "does nothing"),
                (pair.held, OURS, "grip controlled"),
            ):
                t_s = one.begin_s + np.arange(len(one.grip_n)) / one.rate_hz - one.act_s
                shown = (t_s > -0.3) & (t_s < 1.0)
                axes.plot(t_s[shown], one.grip_n[shown], color=colour, label=name)
                if np.isfinite(one.lost_s):
                    axes.axvline(one.lost_s - one.act_s, color=colour, linestyle=":")
            axes.axvline(0.0, color=WARNING, linewidth=0.8)
            axes.set(title=NAMES[pair.bare.trial.action], xlabel="s since it began")
            axes.set_ylabel("grip, N a side" if place == 1 else "")
            axes.legend(fontsize=8, frameon=False)
        return svg(figure)
