"""B trials in a closed loop: physics, sensors, model file, controller, drive, once a sample."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from edge_runtime.contract import FloatArray
from edge_runtime.model import Model
from simulation.closed_loop.actuator import Actuator, Drive
from simulation.closed_loop.answers import HandModels
from simulation.closed_loop.people import Habits, Wearer
from simulation.closed_loop.physics import HandsAndObjects, Spans
from simulation.closed_loop.sensing import LoopSensors
from simulation.protocol import PlannedTrial
from simulation.run import TrialMotion
from simulation.scene import Scene
from simulation.script import grid_of


def spans_of(scene: Scene, trials: Sequence[PlannedTrial], before: int) -> Spans:
    grids = [grid_of(t, scene.card.rate_hz, scene.card.step_s) for t in trials]
    moves = np.array([round(g.start_s * scene.card.rate_hz) for g in grids])
    ends = np.array([int(g.sample[-1]) for g in grids])
    counts = np.array([g.n_samples for g in grids])
    return Spans(np.maximum(moves - before, 0), moves, ends, counts)


@dataclass
class Record:
    p_risky: FloatArray
    p_safe: FloatArray
    known: FloatArray
    grip_n: FloatArray
    load_n: FloatArray
    slip: FloatArray
    target_n: FloatArray
    actual_n: FloatArray
    force_n: FloatArray
    position: FloatArray


def run(scene, trials, model: Model, controller_of, drive=Drive(), habits=Habits(), delay=0):
    card = model.card
    before = card.settle_samples + card.preparation.bias_rows + 5
    spans = spans_of(scene, trials, before)
    lanes = len(trials)
    act = Actuator(drive, trials)
    world = HandsAndObjects(trials, scene._step_settings([], lanes), spans, act, habits)
    sensors = LoopSensors(scene, trials, spans.counts)
    models = HandModels(model, lanes)
    wearer = Wearer(trials, habits, scene.seed)
    controller = controller_of(lanes, card.rate_hz, trials, spans, world)
    n = spans.periods + 1
    rec = {
        k: np.zeros((n, lanes), dtype=np.float32)
        for k in (
            "p_risky",
            "p_safe",
            "known",
            "grip_n",
            "load_n",
            "slip",
            "target_n",
            "actual_n",
            "empty",
        )
    }
    F = np.zeros((n, lanes, world.forces_n.shape[1], 3), dtype=np.float32)
    pos = np.zeros((n, lanes, 3), dtype=np.float32)
    target = act.own_n.copy()
    queue = [target] * delay
    for p in range(n):
        rows = np.minimum(spans.begins + p, spans.counts - 1)
        r, lost = sensors.read(rows, world.forces_n)
        sense = models.answer(r.values.reshape(lanes, -1), r.valid & ~lost[:, None])
        t_s = rows / card.rate_hz
        from dataclasses import replace

        ov = wearer.override(t_s, act.grip_n - act.own_n, 1 / card.rate_hz)
        sense = replace(sense, opening=wearer.opening(t_s), overridden=t_s >= wearer.overrode_s)
        want = controller.want(sense)
        want = np.where(sense.opening | sense.overridden, 0.0, want)
        target = np.maximum(want, act.own_n)
        for k in ("p_risky", "p_safe", "known", "grip_n", "load_n", "slip", "empty"):
            rec[k][p] = getattr(sense, k)
        rec["target_n"][p] = want
        rec["actual_n"][p] = act.grip_n
        F[p] = world.forces_n
        pos[p] = world.position_m
        queue.append(target)
        now = queue.pop(0)
        if p < spans.periods:
            world.advance(p, now)
    return spans, world, wearer, rec, F, pos
