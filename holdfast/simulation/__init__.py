"""Scenes: the physics of a hand, an object and the people who disturb them.

scene_file.py reads a scene file, protocol.py draws its trials, script.py turns them into inputs of
core.py, run.py steps them in batches, truth.py reads the events, folder.py writes all of it. A
scene runs only the effects that it names: effect.py says what an effect is and lists them all.
With a controller in the scene file, closed_loop.py steps the trials together with sensors, model
and drive.
"""

from __future__ import annotations

from pathlib import Path

SCENES = Path(__file__).resolve().parent / "cards"
"""The folder of the scene files that are installed with Holdfast."""
STYLES = SCENES / "styles.toml"


def shipped_scenes() -> list[str]:
    """Names of the shipped scenes, sorted; found without numpy, so that `--help` is quick."""
    return sorted(path.stem for path in SCENES.glob("*.toml") if path != STYLES)
