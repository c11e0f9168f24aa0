"""Short scenes for closed loops, and hands that do what a test wants."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.edge_runtime.grip import GripSense
from holdfast.edge_runtime.model import Model
from holdfast.simulation.loop.closed_loop import ClosedLoop, LoopTruth
from holdfast.simulation.scenes.protocol import PlannedTrial
from holdfast.simulation.scenes.scene import Scene
from holdfast.simulation.scenes.scene_file import read_scene_file
from holdfast.simulation.scenes.script_times import Times

MODEL = Path(__file__).resolve().parents[2] / "models" / "holdfast-150hz.onnx"
SLOWER = MODEL.with_name("holdfast-50hz.onnx")
"""A third of the samples, for what is the same at any rate."""
ACTIONS = {
    "pass": "soft-ball",
    "pull": "soft-ball",
    "fall": "full-bottle",
    "put-down": "basket-ball",
    "hold": "hard-ball",
}
"""Action -> object."""
SHORT = "close_at_s = 0.75\nhold_s = 0.9\ntail_s = 0.4\nweak_share = 0\nopen_after_s = 0.6\n"
WHOLE_BRUSH = "[effects.brush]\ncount = 5\n[effects.averaging]\n"


@cache
def model() -> Model:
    """The shipped model, opened once."""
    return Model(str(MODEL))


@cache
def slower() -> Model:
    """The one of a third of the samples."""
    return Model(str(SLOWER))


def row(action: str, more: str = "", name: str = "") -> str:
    """One short trial of a card. more: lines that take precedence."""
    keys = {line.split(" =")[0] for line in more.splitlines()}
    if action not in ("pass", "put-down"):
        keys |= {"open_after_s"}
    lines = [line for line in SHORT.splitlines() if line.split(" =")[0] not in keys]
    first = (
        f'[[trials]]\nobjects = ["{name or ACTIONS[action]}"]\naction = "{action}"\n'
    )
    return first + "\n".join(lines) + "\n" + more + "\n"


def card_text(*rows: str, effects: str = "", rate_hz: int = 150) -> str:
    """A card with two steps a sample."""
    step_s = 0.525 / rate_hz
    head = f"[record]\nrate_hz = {rate_hz}\n[physics]\nstep_s = {step_s:g}\n"
    return head + "".join(rows) + effects


slow_card = partial(card_text, rate_hz=50)


def scene_of(folder: Path, text: str, seed: int = 0) -> Scene:
    """The scene of a card's text."""
    path = folder / "short.toml"
    path.write_text(text, encoding="utf-8")
    return Scene(read_scene_file(str(path)), seed)


class Firm:
    """From the action on every hand wants grip_n, until its wearer overrides; it notes it all."""

    def __init__(self, trials: Sequence[PlannedTrial], grip_n: float) -> None:
        self.act_s, self.grip_n = np.array([Times.of(t).act for t in trials]), grip_n
        self.mu_hat = np.full(len(trials), np.nan)
        self.noted: list[tuple[FloatArray, GripSense]] = []

    def step(self, sense: GripSense, now: LoopTruth) -> FloatArray:
        """[B] N a side."""
        self.noted.append((now.t_s, sense))
        wants = (now.t_s >= self.act_s) & ~sense.overridden
        target_n: FloatArray = np.where(wants, self.grip_n, 0.0)
        return target_n


def forces_in(loop: ClosedLoop) -> FloatArray:
    """Run a loop to its end; forces at every sample, [periods, B, S, 3]."""
    forces: list[Any] = []
    for period in range(loop.spans.periods):
        loop.world.advance(period, loop.decide(period))
        forces.append(loop.world.forces_n.copy())
    return np.array(forces)
