"""Simulated trials on disk: the thesis' layout, with the truth of each trial, and the scene itself.

OUT/card.toml, OUT/meta.json     the scene file as it was read; name, unit, seed, rate, effects
OUT/hand.toml                    the hand card, where the scene names one
OUT/<object>/meta.json           its mass
OUT/<object>/<action>/
    trial_<n>.csv                Time, X1, Y1, Z1 .. Z6
    trial_<n>.truth.json         phases, events, draws, scene and seed
    trial_<n>.motion.csv         object and hand, mm; with `rotation` the object's turn, degrees
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from holdfast.core.contract import Json
from holdfast.core.hand_card import HandCard
from holdfast.core.table import Column, csv_bytes, trial_csv
from holdfast.core.trial_file import TIME_COLUMN
from holdfast.core.trial_layout import HAND_FILE
from holdfast.core.writing import require_new, whole_folder, write_whole
from holdfast.simulation.effects.effect import Drawn, Signal
from holdfast.simulation.scenes.protocol import PlannedTrial, Trials
from holdfast.simulation.scenes.scene import BATCH, Scene, SimulatedTrial, shifted_s
from holdfast.simulation.scenes.stepper import Done

KIND = "simulated"
"""Value of "kind" in the meta.json of a set."""
STREAM = "daily"
"""Folder of recordings that are several trials joined."""
DECIMALS = {"N": 4, "uT": 1, "count": 0}
"""Of a sample, finer than any sensor's noise."""
TIME_DECIMALS = 6
"""Of a time in s."""
MOTION_DECIMALS = 3
"""Of a position in mm."""
Recording = tuple[Path, list[PlannedTrial]]
"""Path without its ending, and the trials that are joined in it."""


def write_set(
    scene: Scene, out: Path, total: int | None = None, done: Done = lambda n: None
) -> int:
    """Simulate a scene's trials into a new folder; returns the number of recordings.

    done: called now and then with the number of trials that are simulated. The folder gets its
    name when all of it is written, so an interrupted run leaves none. Raises OutputError.
    """
    require_new(out)
    with whole_folder(out) as unfinished:
        return _fill(scene, unfinished, scene.trials(total), done)


def _fill(scene: Scene, out: Path, trials: Trials, done: Done) -> int:
    """Write a whole set; returns the number of recordings. Raises OutputError."""
    # The set carries its own scene file and seed, from which it can be simulated again.
    write_whole(out / "card.toml", scene.file.text)
    write_whole(out / "meta.json", _json(_meta(scene, trials)))
    if scene.file.hand.text:
        write_whole(out / HAND_FILE, scene.file.hand.text)

    # The thesis' layout: light and heavy follow from the mass of the folder.
    masses_g = {}
    for trial in trials:
        if trial.action != "nothing":
            masses_g[trial.object.name] = trial.object.mass_g
    for name, mass_g in masses_g.items():
        write_whole(out / name / "meta.json", _json({"mass_g": mass_g}))

    if scene.file.join > 1:
        recordings = list(_streams(scene, out, trials))
        together = max(1, BATCH // scene.file.join)
    else:
        # Recordings are written in the order in which trials are simulated.
        recordings = [(out / name, [trial]) for name, trial in _named(trials)]
        together = max(1, len(recordings))

    before = 0
    for start in range(0, len(recordings), together):

        def report(trials: float, before: int = before) -> None:
            done(before + trials)

        part = recordings[start : start + together]
        before += _write_recordings(scene, part, report)
    return len(recordings)


def _write_recordings(scene: Scene, recordings: Sequence[Recording], done: Done) -> int:
    """Simulate recordings together, and write each as soon as all its trials are there.

    Returns their number of trials; done: called with the number that is simulated.
    """
    recording_of = {}
    trials = []
    for path, joined in recordings:
        trials += joined
        for trial in joined:
            recording_of[trial.number] = path, joined

    ready: dict[int, SimulatedTrial] = {}
    for simulated in scene.run(trials, done):
        path, joined = recording_of[simulated.trial.number]
        ready[simulated.trial.number] = simulated
        if all(trial.number in ready for trial in joined):
            complete = [ready.pop(trial.number) for trial in joined]
            write_recording(path, scene, complete)

    return len(trials)


def write_recording(path: Path, scene: Scene, trials: Sequence[SimulatedTrial]) -> None:
    """Write samples, truth and motion of one trial or of several end to end.

    path: without its ending.
    """
    signal, starts_s, drawn = scene.join(trials)
    truth = _truth(scene, trials, starts_s, drawn)
    parts: dict[str, bytes | str] = {
        "csv": _samples(signal, scene.file.hand),
        "motion.csv": _motion(trials, starts_s, turns="rotation" in scene.file.effects),
        "truth.json": _json(truth),
    }

    for ending, content in parts.items():
        write_whole(path.with_name(f"{path.name}.{ending}"), content)


def _streams(scene: Scene, out: Path, trials: Trials) -> Iterator[Recording]:
    """Recordings of `join` trials of an object each, in random order."""
    join = scene.file.join
    for name in dict.fromkeys(trial.object.name for trial in trials):
        same = [trial for trial in trials if trial.object.name == name]
        # Daily life has no blocks of the same action.
        rng = np.random.default_rng([scene.seed, len(same)])
        order = rng.permutation(len(same))
        for start in range(0, len(same), join):
            number = start // join + 1
            joined = [same[k] for k in order[start : start + join]]
            yield out / name / STREAM / f"trial_{number}", joined


def _named(trials: Trials) -> Iterator[tuple[str, PlannedTrial]]:
    """Trials with <object>/<action>/trial_<n>, n counting within the folder."""
    counts: dict[str, int] = {}
    for trial in trials:
        folder = f"{trial.object.name}/{trial.action}"
        if trial.action == "nothing":
            folder = "nothing"
        counts[folder] = counts.get(folder, 0) + 1
        yield f"{folder}/trial_{counts[folder]}", trial


def _meta(scene: Scene, trials: Trials) -> Json:
    """The meta.json of a set: what its files are, and where they come from."""
    file = scene.file
    meta: Json = {
        "name": file.name,
        "title": file.title,
        "kind": KIND,
        "unit": file.unit,
        "rate_hz": file.rate_hz,
        "recordings by": "nobody: simulated",
        "redistributable": True,
        "card_sha256": file.sha256,
        "seed": scene.seed,
        "step_s": file.step_s,
        "effects": list(file.effects),
    }
    if file.hand.text:
        meta["hand"] = {"card": file.hand.name, "sha256": file.hand.sha256}
    if any("used" in row.values for row in file.rows):
        # Holds that no hand can grip, or whose grip no sensor sees, are drawn again.
        refused = sum(trial.refused for trial in trials)
        meta["draws"] = {"kept": len(trials), "refused": refused}

    return meta


def _samples(signal: Signal, hand: HandCard) -> bytes:
    """The CSV of a recording: times, and the channels that the hand measures."""
    values = signal.values.reshape(len(signal.t_s), -1)
    decimals = DECIMALS[signal.unit]
    absent = hand.unmeasured_names
    return trial_csv(signal.t_s, values, TIME_DECIMALS, decimals, absent)


def _motion(
    trials: Sequence[SimulatedTrial], starts_s: Sequence[float], *, turns: bool
) -> bytes:
    """The CSV of positions in mm: of the object in the hand, which may turn, and of the hand."""
    motions = [simulated.motion for simulated in trials]
    places_m = {
        "object": np.concatenate([motion.position_m for motion in motions]),
        "hand": np.concatenate([simulated.hand_m for simulated in trials]),
    }
    header = [TIME_COLUMN]
    columns: list[Column] = [(shifted_s(trials, starts_s), TIME_DECIMALS)]

    if turns:
        # A step ends at each sample.
        turned_rad = [np.interp(one.t_s, one.at_s, one.turned_rad) for one in motions]
        header.append("object_turn_deg")
        columns.append((np.degrees(np.concatenate(turned_rad)), MOTION_DECIMALS))

    for what, place_m in places_m.items():
        place_mm = 1e3 * place_m
        for axis, column in zip("xyz", place_mm.T, strict=True):
            header.append(f"{what}_{axis}_mm")
            columns.append((column, MOTION_DECIMALS))

    return csv_bytes(header, columns)


def _truth(
    scene: Scene,
    simulated: Sequence[SimulatedTrial],
    starts_s: Sequence[float],
    drawn: Mapping[str, Drawn],
) -> Json:
    """The sidecar of a recording: all its phases, and each trial's events, draws and origin."""
    phases = []
    trials = []
    for trial, start_s in zip(simulated, starts_s, strict=True):
        events = trial.truth.to_json(start_s)
        phases += events.pop("phases")
        trials.append(_origin(trial, drawn) | events)

    truth: Json = {
        "phases": phases,
        "card": scene.file.name,
        "card_sha256": scene.file.sha256,
        "seed": scene.seed,
    }
    # The file of one trial has its keys at the top.
    if len(trials) == 1:
        return truth | trials[0]
    return truth | {"trials": trials}


def _origin(simulated: SimulatedTrial, sensors: Mapping[str, Drawn]) -> Json:
    """What was drawn for a trial; the object's numbers decide whether a grip holds it."""
    trial = simulated.trial
    held = simulated.trial.object
    # a hold that a table bears uses no number of its friction, and JSON has no infinity
    drawn = {
        name: round(value, 6) if math.isfinite(value) else None
        for name, value in trial.drawn.items()
    }
    return {
        "number": trial.number,
        "object": held.name,
        "action": trial.action,
        "style": trial.style,
        "supported": bool(trial.supported),
        "grip_n": round(trial.grip_n, 4),
        "thing": {
            "mass_g": held.mass_g,
            "friction": held.friction,
            "kinetic_share": held.kinetic_share,
            "stiffness_n_per_m": held.stiffness_n_per_m,
        },
        "drawn": drawn,
        "effects": {**simulated.effects, **sensors},
    }


def _json(value: object) -> str:
    """JSON as it is written in a set, one key a line."""
    return json.dumps(value, indent=1, allow_nan=False) + "\n"
