"""For: scenes: the physics of a hand, an object and the people who disturb them.
May import: edge_runtime, core.
Begin with: scenes/scene.py, a scene and its trials; loop/closed_loop.py steps them with model and
drive.

Inside, imports go down only: loop, scenes, physics, effects. actions/ has what happens in a trial:
scenes know its table, and load the modules below it, which read scenes, by name.
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
