"""Scenes: the physics of a hand, an object and the people who disturb them.

scene_file.py reads a scene file, actions/ has what happens in a trial, protocol.py draws trials,
script.py turns them into inputs of core.py, stepper.py steps them in batches, truth.py reads the
events, folder.py writes all of it. A scene runs only the effects that it names: effect.py defines
an effect and lists them all. closed_loop.py steps trials together with sensors, model and drive.
"""

from __future__ import annotations

from pathlib import Path

from holdfast.core.errors import CardError

SCENES = Path(__file__).resolve().parent / "cards"
"""The folder of the scene files that are installed with Holdfast."""
STYLES = SCENES / "styles.toml"


def shipped_scenes() -> list[str]:
    """Names of the shipped scenes, sorted; found without numpy, so that `--help` is quick."""
    return sorted(path.stem for path in SCENES.glob("*.toml") if path != STYLES)


def find_scene_file(name: str) -> Path:
    """A shipped scene by name, or a file. Raises CardError."""
    if name in shipped_scenes():
        return SCENES / f"{name}.toml"

    try:
        if Path(name).is_file():
            return Path(name)
    except OSError:
        pass  # a name that no file can have

    raise CardError(
        f"no scene {name!r}",
        cause="neither a shipped scene nor a file",
        next_step=f"choose from {', '.join(shipped_scenes())}",
    )
