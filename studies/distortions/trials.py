"""The set of trials: simulated once a process, each distorted, prepared as on the hand."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from holdfast.core.contract import RISKY_SLIP, SITUATIONS, BoolArray, FloatArray
from holdfast.data.recording import Recording
from holdfast.data.timeline import Phase, RiskyEvent
from holdfast.edge_runtime.preparation import Preparation
from holdfast.simulation.effects.effect import stream
from holdfast.simulation.scenes.protocol import PlannedTrial
from holdfast.simulation.scenes.scene import Scene
from holdfast.simulation.scenes.scene_file import read_scene_file
from holdfast.simulation.scenes.truth import Truth
from studies.distortions.law import PlanRequest, distorted
from studies.distortions.table import Distortion

NOTHING_ACTION = "nothing"


@dataclass(frozen=True)
class FeltTrial:
    """A trial as the sensors met it. t_s [T]; forces_n [T, S, 3] on them; truth by the physics."""

    planned: PlannedTrial
    t_s: FloatArray
    forces_n: FloatArray
    truth: Truth


@dataclass(frozen=True)
class FeltSet:
    """A scene and its trials, in their order."""

    scene: Scene
    trials: tuple[FeltTrial, ...]


@lru_cache(maxsize=2)
def felt_set(card: str, trials: int | None, seed: int) -> FeltSet:
    """Simulate the trials of a card. Raises CardError."""
    # Kept in every process: the same trials are distorted in many ways.
    scene = Scene(read_scene_file(card), seed)
    felt = {}
    for simulated in scene.run(scene.trials(trials)):
        motion = simulated.motion
        # The steps of the physics are many and needed no more.
        felt[simulated.trial.number] = FeltTrial(
            simulated.trial, motion.t_s, motion.forces_n, simulated.truth
        )
    return FeltSet(scene, tuple(felt[number] for number in sorted(felt)))


def readings_of(
    of: FeltSet, trial: FeltTrial, distortion: Distortion
) -> tuple[FloatArray, BoolArray]:
    """(values [T, S, 3] in N, valid [T, S]) that the distorted sensors report."""
    law = distortion.law
    forces_n = trial.forces_n
    all_valid = np.ones(forces_n.shape[:2], dtype=np.bool_)
    rng = law_stream(of.scene.seed, trial.planned, distortion)
    request = PlanRequest(rng, trial.t_s, trial.planned.hand.sensor_sides)

    if law is not None and distortion.where == "forces":
        forces_n, _ = distorted(law, forces_n, all_valid, request)
    signal, _ = of.scene.sense(trial.planned, trial.t_s, forces_n)
    if law is not None and distortion.where == "readings":
        return distorted(law, signal.values, signal.valid, request)
    return signal.values, signal.valid


def law_stream(
    seed: int, trial: PlannedTrial, distortion: Distortion
) -> np.random.Generator:
    """The random stream of a distortion in a trial, the same for a recording and for a loop."""
    return stream(seed, trial.number, f"distortion {distortion.name}")


def recording_of(
    of: FeltSet, trial: FeltTrial, distortion: Distortion, preparation: Preparation
) -> Recording:
    """The distorted trial as the model gets it, with its labels."""
    values, valid = readings_of(of, trial, distortion)
    raw = values.reshape(len(values), -1)
    name = str(trial.planned.number)
    planned = trial.planned
    phases, events = _labels(trial)
    return Recording(
        trial_id=name,
        group=name,
        samples=preparation.apply(raw),
        valid=valid,
        rate_hz=of.scene.file.rate_hz,
        unit=of.scene.file.unit,
        object_name=planned.object.name,
        action=planned.action,
        phases=phases,
        events=events,
    )


def _labels(trial: FeltTrial) -> tuple[tuple[Phase, ...], tuple[RiskyEvent, ...]]:
    """Phases and events of the truth, as a reader finds them in its file."""
    truth = trial.truth
    phases = []
    events = []
    for entry in truth.to_json()["phases"]:
        start_s = entry["t0_s"]
        stop_s = entry["t1_s"]
        first, stop = np.searchsorted(trial.t_s, [start_s, stop_s]).tolist()
        situation = SITUATIONS.index(entry["label"])
        if first < stop:
            phases.append(Phase(first, stop, situation))
        if situation != RISKY_SLIP:
            continue
        gross_s = truth.gross_slip_s
        inside = gross_s is not None and start_s <= gross_s <= stop_s
        events.append(RiskyEvent(start_s, gross_s if inside else None, stop_s))
    return tuple(phases), tuple(events)
