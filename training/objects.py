"""The objects of the thesis, and what makes one light or heavy.

An object without a known mass has no weight class, and a guess would put wrong labels on all its
windows. The mass comes from MASSES_G or from `meta.json` beside the recordings.
"""

from __future__ import annotations

import sys
from pathlib import Path

from edge_runtime.contract import LIGHT_BELOW_G
from edge_runtime.errors import LabelError
from edge_runtime.reading import Json, json_of, text_of
from edge_runtime.trial_layout import MASSES_G

ALIASES = {"colabottle": "full-bottle"}


def object_name(folder_name: str) -> str:
    """The table's name of a folder: `softball`, `Soft_Ball` and `soft-ball` are one object."""
    plain = plain_word(folder_name)
    known = {plain_word(name): name for name in MASSES_G} | ALIASES
    return known.get(plain, folder_name)


def plain_word(name: str) -> str:
    """Lower case, letters and digits only."""
    return "".join(letter for letter in name.lower() if letter.isalnum())


def is_heavy(mass_g: float) -> bool:
    """Heavy is 150 g and more."""
    return mass_g >= LIGHT_BELOW_G


def mass_g(folder: Path) -> float:
    """Mass of the object a folder is named after, g: from its `meta.json`, else from the table.

    Raises LabelError where neither knows it, or where the mass is no positive number.
    """
    name = object_name(folder.name)
    mass = read_json(folder / "meta.json").get("mass_g")
    if mass is None and name in MASSES_G:
        return MASSES_G[name]
    if mass is None:
        raise LabelError(
            f"no mass given for object {folder.name!r}",
            where=folder,
            cause="an object whose mass Holdfast does not know",
            next_step=f'weigh it and add "mass_g" to {folder / "meta.json"}: {{"mass_g": 120.0}}',
        )
    if (
        isinstance(mass, bool)
        or not isinstance(mass, int | float)
        or not 0.0 < mass <= sys.float_info.max
    ):
        raise LabelError(
            f"mass_g is {mass!r}", where=folder / "meta.json", next_step="write the mass in gram"
        )
    return float(mass)


def read_json(path: Path) -> Json:
    """A JSON object beside the recordings; empty without the file. Raises LabelError."""
    try:
        value = json_of(text_of(path))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise LabelError(
            f"cannot be read as JSON ({type(error).__name__})",
            where=path,
            next_step="mend or remove it",
        ) from None
    if not isinstance(value, dict):
        raise LabelError(
            "holds no JSON object", where=path, next_step="write {..} with the keys by name"
        )
    return value
