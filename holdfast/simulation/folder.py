"""Simulated trials on disk: the thesis' layout, a truth beside each trial, and the card itself.

OUT/card.toml, OUT/meta.json     the card as it was read; name, unit, seed, rate, effects
OUT/<object>/meta.json           its mass
OUT/<object>/<action>/
    trial_<n>.csv                Time, X1, Y1, Z1 .. Z6 (and valid1 .. if an effect invalidates)
    trial_<n>.truth.json         phases, events, draws, card and seed
    trial_<n>.motion.csv         object and hand, mm
    trial_<n>.grip.csv           with a controller on the card: its commands, the drive's grip
    trial_<n>.frames.npz         with a camera on the card: frames, time stamps and scale
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.contract import FloatArray, channel_names
from holdfast.core.errors import OutputError
from holdfast.core.reading import Json
from holdfast.core.trial_file import TIME_COLUMN
from holdfast.core.writing import require_writable, whole_folder, write_whole
from holdfast.simulation.camera_frames import Camera
from holdfast.simulation.card import Card
from holdfast.simulation.closed_loop.drive import COLUMNS, GripRecord
from holdfast.simulation.effect import Drawn, Signal
from holdfast.simulation.effects import EFFECTS
from holdfast.simulation.run import Done
from holdfast.simulation.scene import BATCH, Scene, SimulatedTrial
from holdfast.simulation.table import csv_bytes

KIND = "simulated"
STREAM = "daily"
"""Folder of recordings that are several trials joined."""
THING_KEYS = ("mass_g", "friction", "kinetic_share", "stiffness_n_per_m")
"""Of the object, in the truth: what decides whether a grip holds (friction before its factor)."""
DECIMALS = {"N": 4, "uT": 1, "count": 0}
SIMULATED_SHARE = 0.8
"""Share of a trial's time that simulating takes; the rest is for writing it."""


def write_set(
    scene: Scene, out: Path, total: int | None = None, done: Done = lambda n: None
) -> int:
    """Simulate a card's trials into a new folder; returns the number of recordings.

    done: called now and then with the trials' worth of work that is done. The folder gets its name
    when all of it is written, so an interrupted run leaves none. Raises OutputError.
    """
    require_new(out)
    with whole_folder(out) as unfinished:
        return _fill(scene, unfinished, scene.trials(total), done)


def _fill(scene: Scene, out: Path, trials: Sequence[Any], done: Done) -> int:
    """Write a whole set; returns the number of recordings. Raises OutputError."""
    card = scene.card
    write_whole(out / "card.toml", card.text)
    write_whole(out / "meta.json", _json(_meta(card, scene.seed)))
    for thing in {
        t.thing.name: t.thing for t in trials if t.action != "nothing"
    }.values():
        write_whole(out / thing.name / "meta.json", _json({"mass_g": thing.mass_g}))
    if card.join > 1:
        return _write_streams(scene, out, trials, done)
    names = _names(trials)
    work = _Work(done)
    for one in scene.run(trials, work.simulated):
        write_recording(out / names[one.trial.number], scene, [one])
        work.written(1)
    return len(trials)


class _Work:
    """Counts the work: a trial counts in part when simulated, in full when written."""

    def __init__(self, done: Done) -> None:
        self.done, self.before, self.n_simulated, self.n_written = done, 0.0, 0.0, 0

    def simulated(self, trials: float) -> None:
        self.n_simulated = self.before + trials
        self._report()

    def written(self, trials: int) -> None:
        self.n_written += trials
        self._report()

    def _report(self) -> None:
        self.done(
            SIMULATED_SHARE * self.n_simulated
            + (1.0 - SIMULATED_SHARE) * self.n_written
        )


def require_new(out: Path) -> None:
    """Raise OutputError for a folder with anything in it: nothing is ever overwritten."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise OutputError(
            "exists already",
            where=out,
            next_step="name a new folder, or remove this one",
        )
    require_writable(out)


def write_recording(path: Path, scene: Scene, trials: Sequence[SimulatedTrial]) -> None:
    """Write samples, truth and motion of one trial or of several end to end.

    path: without its ending.
    """
    signal, starts_s, drawn = scene.join(trials)
    write_whole(path.with_name(f"{path.name}.csv"), _samples(signal, scene))
    write_whole(path.with_name(f"{path.name}.motion.csv"), _motion(trials, starts_s))
    write_whole(
        path.with_name(f"{path.name}.truth.json"),
        _json(_truth(scene, trials, starts_s, drawn)),
    )
    if trials[0].grip:
        write_whole(
            path.with_name(f"{path.name}.grip.csv"), _grip(signal.t_s, trials[0].grip)
        )
    if scene.camera:
        write_whole(
            path.with_name(f"{path.name}.frames.npz"),
            _film(scene, trials[0], scene.camera),
        )


def _write_streams(scene: Scene, out: Path, trials: Sequence[Any], done: Done) -> int:
    """Write recordings of card.join trials of an object each, in random order.

    Many recordings are simulated together.
    """
    streams = list(_streams(scene, out, trials))
    together = max(1, BATCH // scene.card.join)
    work = _Work(done)
    for start in range(0, len(streams), together):
        some = streams[start : start + together]
        trials = [trial for _, chosen in some for trial in chosen]
        simulated = {one.trial.number: one for one in scene.run(trials, work.simulated)}
        work.before += len(trials)
        for path, chosen in some:
            write_recording(path, scene, [simulated[trial.number] for trial in chosen])
            work.written(len(chosen))
    return len(streams)


def _streams(
    scene: Scene, out: Path, trials: Sequence[Any]
) -> Iterator[tuple[Path, list[Any]]]:
    """Yields the path without its ending, and the trials, of each recording."""
    for name in dict.fromkeys(t.thing.name for t in trials):
        here = [t for t in trials if t.thing.name == name]
        order = np.random.default_rng([scene.seed, len(here)]).permutation(len(here))
        for number, start in enumerate(range(0, len(here), scene.card.join), 1):
            yield (
                out / name / STREAM / f"trial_{number}",
                [here[k] for k in order[start : start + scene.card.join]],
            )


def _names(trials: Sequence[Any]) -> dict[int, str]:
    """Trial number -> <object>/<action>/trial_<n>, n counting within the folder."""
    counts: dict[str, int] = {}
    names = {}
    for trial in trials:
        folder = (
            "nothing"
            if trial.action == "nothing"
            else f"{trial.thing.name}/{trial.action}"
        )
        counts[folder] = counts.get(folder, 0) + 1
        names[trial.number] = f"{folder}/trial_{counts[folder]}"
    return names


def _meta(card: Card, seed: int) -> Json:
    return {
        "name": card.name,
        "title": card.title,
        "kind": KIND,
        "unit": card.unit,
        "rate_hz": card.rate_hz,
        "recordings by": "nobody: simulated",
        "redistributable": True,
        "card_sha256": card.sha256,
        "seed": seed,
        "step_s": card.step_s,
        "effects": list(card.effects),
        **({} if card.controller is None else {"controller": card.controller.name}),
    }


def _samples(signal: Signal, scene: Scene) -> bytes:
    n_sensors = signal.values.shape[1]
    header = [TIME_COLUMN, *channel_names(n_sensors)]
    columns: list[tuple[FloatArray, int]] = [(signal.t_s, 6)]
    columns += [
        (column, DECIMALS[signal.unit])
        for column in signal.values.reshape(len(signal.t_s), -1).T
    ]
    if any(EFFECTS[name].marks_invalid for name in scene.card.effects):
        header += [f"valid{k}" for k in range(1, n_sensors + 1)]
        columns += [(column.astype(np.float64), 0) for column in signal.valid.T]
    return csv_bytes(header, columns)


def _motion(trials: Sequence[SimulatedTrial], starts_s: Sequence[float]) -> bytes:
    t_s = np.concatenate(
        [one.motion.t_s + start for one, start in zip(trials, starts_s, strict=True)]
    )
    object_mm = 1e3 * np.concatenate([one.motion.position_m for one in trials])
    hand = [
        one.hand_m if one.hand_m is not None else np.zeros_like(one.motion.position_m)
        for one in trials
    ]
    hand_mm = 1e3 * np.concatenate(hand)
    header = [
        "Time",
        *(f"object_{axis}_mm" for axis in "xyz"),
        *(f"hand_{axis}_mm" for axis in "xyz"),
    ]
    return csv_bytes(
        header,
        [(t_s, 6), *((column, 3) for column in np.hstack([object_mm, hand_mm]).T)],
    )


def _grip(t_s: FloatArray, grip: GripRecord) -> bytes:
    return csv_bytes([TIME_COLUMN, *COLUMNS], [(t_s, 6), *grip.columns()])


def _film(scene: Scene, one: SimulatedTrial, camera: Camera) -> bytes:
    """An .npz: frames [K, H, W] uint8, time_s [K] ends of the exposures, the camera's numbers."""
    time_s, frames = scene.film(one, camera)
    packed = io.BytesIO()
    numbers: dict[str, Any] = {
        name: np.float64(value) for name, value in asdict(camera).items()
    }
    np.savez_compressed(packed, frames=frames, time_s=time_s, **numbers)
    return packed.getvalue()


def _truth(
    scene: Scene,
    simulated: Sequence[SimulatedTrial],
    starts_s: Sequence[float],
    drawn: Mapping[str, Drawn],
) -> Json:
    """The sidecar of a recording: all its phases, and each trial's events, draws and origin."""
    shifts = zip(simulated, starts_s, strict=True)
    parts = [one.truth.shifted(start).to_json() for one, start in shifts]
    card = {
        "card": scene.card.name,
        "card_sha256": scene.card.sha256,
        "seed": scene.seed,
    }
    phases = [phase for part in parts for phase in part.pop("phases")]
    trials = [
        _origin(one, drawn) | part for one, part in zip(simulated, parts, strict=True)
    ]
    return {
        "phases": phases,
        **card,
        **(trials[0] if len(trials) == 1 else {"trials": trials}),
    }


def _origin(one: SimulatedTrial, sensors: Mapping[str, Drawn]) -> Json:
    trial = one.trial
    return {
        "number": trial.number,
        "object": trial.thing.name,
        "action": trial.action,
        "style": trial.style,
        "supported": bool(trial.supported),
        "grip_n": round(trial.grip_n, 4),
        "thing": {name: getattr(trial.thing, name) for name in THING_KEYS},
        "drawn": {name: round(value, 6) for name, value in trial.drawn.items()},
        "effects": {**one.effects, **sensors},
    } | ({"controller": one.grip.to_json()} if one.grip else {})


def _json(value: object) -> str:
    return json.dumps(value, indent=1) + "\n"
