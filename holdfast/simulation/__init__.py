"""For: scenes: the physics of a hand, an object and the people who disturb them.
May import: edge_runtime, core.
Begin with: scene.py, a scene and its trials; closed_loop.py steps them with model and drive.

scene_file.py reads a scene file, actions/ has what happens in a trial, protocol.py draws trials,
script.py turns them into inputs of core.py, stepper.py steps them in batches, truth.py reads the
events, folder.py writes all of it. A scene runs only the effects that it names: effect.py defines
an effect and lists them all.
"""

from __future__ import annotations

from pathlib import Path

from holdfast.core.schema import card_names

SCENES = Path(__file__).resolve().parent / "cards"
"""The folder of the scene files that are installed with Holdfast."""
STYLES = SCENES.parent / "styles.toml"


def shipped_scenes() -> list[str]:
    """Names of the shipped scenes, sorted; found without numpy, so that `--help` is quick."""
    return card_names(SCENES)
