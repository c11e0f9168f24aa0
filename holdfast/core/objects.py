"""The objects of the thesis, and what makes one light or heavy.

An object without a known mass has no weight class, and a guess would put wrong labels on all its
windows. The mass comes from `meta.json` beside the recordings, else from "masses_g" of the set's
meta.json, else from MASSES_G.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from holdfast.core.contract import LIGHT_BELOW_G
from holdfast.core.errors import LabelError
from holdfast.core.reading import Json, json_of, text_of
from holdfast.core.trial_layout import MASSES_G, META

MASSES_KEY, TABLE = "masses_g", "table"
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


@dataclass(frozen=True)
class Mass:
    """Mass of an object, and the file that gives it ("table" for MASSES_G)."""

    mass_g: float
    source: str

    @property
    def heavy(self) -> bool:
        """150 g and more."""
        return is_heavy(self.mass_g)


def mass_g(folder: Path) -> float:
    """Mass of the object a folder is named after, g. Raises LabelError."""
    return mass_of(folder).mass_g


def mass_of(folder: Path, masses_g: Json | None = None) -> Mass:
    """Mass of the object a folder is named after: its `meta.json`, the set's, or the table.

    masses_g: "masses_g" of the set's meta.json. Raises LabelError where none knows the mass, or
    where it is no positive number.
    """
    beside = folder / META
    mass = read_json(beside).get("mass_g")
    if mass is not None:
        return _checked(mass, str(beside), folder.name)
    known = named_mass(folder.name, masses_g)
    if known is None:
        raise LabelError(
            f"no mass given for object {folder.name!r}",
            where=folder,
            cause="an object whose mass Holdfast does not know",
            next_step=f'weigh it and add "mass_g" to {beside}: {{"mass_g": 120.0}}',
        )
    return known


def named_mass(name: str, masses_g: Mapping[str, Any] | None = None) -> Mass | None:
    """The mass of an object by the set's masses_g, else by the table; None where neither knows it.

    Raises LabelError for a mass that is no positive number.
    """
    of_set = {object_name(other): mass for other, mass in (masses_g or {}).items()}
    table = object_name(name)
    if table in of_set:
        return _checked(of_set[table], MASSES_KEY, name)
    return Mass(MASSES_G[table], TABLE) if table in MASSES_G else None


def _checked(mass: Any, source: str, name: str) -> Mass:
    if (
        isinstance(mass, bool)
        or not isinstance(mass, int | float)
        or not 0.0 < mass <= sys.float_info.max
    ):
        raise LabelError(
            f"the mass of {name!r} is {mass!r}",
            where=source,
            next_step="write the mass in gram",
        )
    return Mass(float(mass), source)


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
            "holds no JSON object",
            where=path,
            next_step="write {..} with the keys by name",
        )
    return value
