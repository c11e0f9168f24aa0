"""The demo's trials, simulated in another process while the demo loads its libraries and trains.

    python -m examples.demo.demo_trials FOLDER

It writes FOLDER/train, then FOLDER/unseen, and prints the name of each when it is complete.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

from holdfast.simulation.scenes.folder import write_recording, write_set
from holdfast.simulation.scenes.scene import Scene
from holdfast.simulation.scenes.scene_file import read_scene_file

RATE_HZ = 150.0
TRIALS = 120
TRAINED_STEP_S = 0.003
"""Of the physics, where a slip begins some tenths of a millisecond earlier or later: three times as
quick. The trials that are shown have the usual step."""
TRAINED_SEED, UNSEEN_SEED = 0, 1
SHOWN = ("fall", "pass")
"""A slip and a hand-over: the first of each that an unseen seed planned, not picked by hand."""
TRAIN, UNSEEN = "train", "unseen"


def run(work: Path) -> None:
    """Write both sets; prints a line for each."""
    card = read_scene_file("thesis", rate_hz=RATE_HZ)
    coarse = replace(card, step_s=TRAINED_STEP_S)
    write_set(Scene(coarse, TRAINED_SEED), work / TRAIN, TRIALS)
    print(TRAIN, flush=True)
    write_shown(Scene(card, UNSEEN_SEED), work / UNSEEN)
    print(UNSEEN, flush=True)


def write_shown(scene: Scene, folder: Path) -> None:
    """Simulate the first trial of each action in SHOWN, as a set in the usual layout."""
    trials = scene.trials(TRIALS)
    chosen = [next(t for t in trials if t.action == action) for action in SHOWN]
    for one in scene.run_together(chosen):
        write_recording(
            folder / one.trial.object.name / one.trial.action / "trial_1", scene, [one]
        )


if __name__ == "__main__":
    run(Path(sys.argv[1]))
