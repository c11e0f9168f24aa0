"""The price list of effects: what each adds to a simulated sample, in one run, beside the core's own price.

Effects of the loop are priced by running the same trials with and without them (median of pairs taken in turns),
effects of the sensor by calling them on the same recordings, a camera by filming one. CPU time; ns per sample of six
fingertips.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from simulation.camera.frames import CAMERA, Camera
from simulation.card import read_card
from simulation.effect import stream
from simulation.effects import EFFECTS
from simulation.scene import Scene

LANES = 200
PAIRS = 3
RATE_HZ = 150.0
CARD = """
[record]
rate_hz = {rate}
[[trials]]
objects = ["soft-ball", "hard-ball"]
action = "pull"
count = {half}
{effects}
"""


def scene_with(*names: str, lanes: int = LANES) -> Scene:
    """The pull on two balls, with these effects and what they need."""
    needed = {need for name in names for need in EFFECTS[name].needs}
    told = "\n".join(f"[effects.{name}]" for name in EFFECTS if name in needed | set(names))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "price.toml"
        path.write_text(CARD.format(rate=RATE_HZ, half=lanes // 2, effects=told), encoding="utf-8")
        return Scene(read_card(str(path)), 0)


def prices(*, lanes: int = LANES, pairs: int = PAIRS) -> list[dict[str, Any]]:
    """One row an effect: name, stage, ns_per_sample it adds, and that over the core's own; the core first."""
    empty = scene_with(lanes=lanes)
    core = min(_run_ns(empty) for _ in range(pairs))
    rows = [{"effect": "(core alone)", "stage": "core", "ns_per_sample": core, "over_core": 1.0}]
    for name, effect in EFFECTS.items():
        price = PRICED[effect.stage](name, lanes, pairs)
        rows.append({"effect": name, "stage": effect.stage, "ns_per_sample": price, "over_core": price / core})
    return rows


def empty_list_over_core(*, lanes: int = LANES, pairs: int = 5) -> float:
    """CPU time with `[effects]` empty over CPU time of a card without the section; both in turns."""
    without, with_empty = scene_with(lanes=lanes), scene_with(lanes=lanes)
    ratios = [_run_ns(with_empty) / _run_ns(without) for _ in range(pairs)]
    return statistics.median(ratios)


def _run_ns(scene: Scene) -> float:
    trials = scene.trials()
    started = time.process_time_ns()
    told = scene.run_together(trials)
    spent = time.process_time_ns() - started
    return spent / sum(len(one.signal.t_s) for one in told)


def _loop_price(name: str, lanes: int, pairs: int) -> float:
    plain, more = scene_with(lanes=lanes), scene_with(name, lanes=lanes)
    return statistics.median(_run_ns(more) - _run_ns(plain) for _ in range(pairs))


def _sensor_price(name: str, lanes: int, pairs: int) -> float:
    scene = scene_with(*EFFECTS[name].needs, lanes=lanes)
    drawn = EFFECTS[name].draw({}, stream(0, 0, name))
    signals = [one.signal for one in scene.run_together(scene.trials())]
    spent = []
    for _ in range(pairs):
        started = time.process_time_ns()
        for signal in signals:
            EFFECTS[name].make(signal, drawn, stream(0, 1, name))
        spent.append(time.process_time_ns() - started)
    return statistics.median(spent) / sum(len(signal.t_s) for signal in signals)


def _camera_price(name: str, lanes: int, pairs: int) -> float:
    scene, camera = scene_with(lanes=2), Camera(**{name: p.default for name, p in CAMERA.items()})
    (told,) = scene.run_together(scene.trials()[:1])
    started = time.process_time_ns()
    scene.film(told, camera)
    return (time.process_time_ns() - started) / len(told.signal.t_s)


PRICED: dict[str, Callable[[str, int, int], float]] = {
    "physics": _loop_price, "sensor": _sensor_price, "camera": _camera_price,
}  # fmt: skip
