"""Sets that no choice may see (locked.toml): recognised by what stands in their own files.

A choice is a fit, a threshold, a setting of a controller, or which features to use. Whatever makes
one asks `require_open` first. Scoring a locked set is what it is there for, and is not refused.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from datetime import date
from functools import cache
from pathlib import Path

import msgspec

from holdfast.core.contract import Json
from holdfast.core.errors import SetLocked
from holdfast.core.schema import read
from holdfast.core.trial_layout import META, read_json

FILE = Path(__file__).with_name("locked.toml")
TRUTHS = "*.truth.json"


class Seeds(msgspec.Struct, frozen=True):
    """Seeds from first to last, both included, and what they are for.

    locked_on: the day; None for seeds that are open.
    """

    first: int
    last: int
    about: str
    locked_on: date | None = None


class Style(msgspec.Struct, frozen=True):
    """A scene, and the SHA-256 of its file."""

    scene: str
    sha256: str


class People(msgspec.Struct, frozen=True):
    """The people of a public set that choices may see; any other person of it is locked."""

    set: str
    development: tuple[str, ...]
    about: str


class LockedSets(msgspec.Struct, frozen=True):
    """What locked.toml says.

    locked_on    the day of the styles; seeds have their own
    seeds        locked for every scene
    styles       locked at every seed
    development  seeds for choices
    people       of public sets, those for choices
    """

    locked_on: date
    seeds: tuple[Seeds, ...]
    styles: tuple[Style, ...]
    development: Seeds
    people: tuple[People, ...] = ()

    def lock_of_seed(self, seed: int) -> Seeds | None:
        """The entry that locks a seed, the later one where two do; None for an open seed."""
        found = [one for one in self.seeds if one.first <= seed <= one.last]
        return found[-1] if found else None

    def reason(self, origin: Json, *, styles: bool = True) -> str:
        """Why the set of this origin is locked, or "".

        origin: the keys of a set's meta.json, or of a recording's truth: name or card, card_sha256,
        seed. A recorded set has none of them and is open. styles: locked styles count too.
        """
        sha256 = origin.get("card_sha256")
        if not isinstance(sha256, str):
            return ""

        seed = origin.get("seed")
        locked = self.lock_of_seed(seed) if isinstance(seed, int) else None
        if locked is not None:
            return f"seed {seed} is locked since {locked.locked_on} ({locked.about})"
        if not styles:
            return ""

        name = origin.get("name") or origin.get("card")
        for style in self.styles:
            # By its name too: another version of the scene is still that style.
            if style.scene == name or style.sha256 == sha256:
                since = f"since {self.locked_on}"
                return f"the style {style.scene} is locked at every seed, {since}"
        return ""


@cache
def locked_sets() -> LockedSets:
    """The sets that locked.toml names, read once."""
    return read(FILE, LockedSets)


def lock_of(folder: Path, *, styles: bool = True) -> str:
    """Why the set in a folder is locked, or "" for one that is open.

    The folder may be a part of a set, or hold recordings that were copied out of several sets.
    styles: locked styles count too.
    """
    for origin in _origins(folder):
        reason = locked_sets().reason(origin, styles=styles)
        if reason:
            return reason
    return ""


def _origins(folder: Path) -> Iterator[Json]:
    """What the files of a folder say of where they come from."""
    inside = folder.resolve()
    # A part of a set, SET/OBJECT/ACTION at most, has its meta.json further up.
    for parent in (inside, *inside.parents[:2]):
        if (parent / META).is_file():
            yield read_json(parent / META)
            break

    # A copied recording keeps its truth beside it, whatever folder it lies in.
    for path in sorted(inside.rglob(TRUTHS)):
        yield read_json(path)


def require_open(folder: Path, choice: str, *, styles: bool = True) -> None:
    """Raise SetLocked where a choice would see a locked set.

    choice: what would be chosen. styles: locked styles count too; not where a model is fitted to
    one person, because a style stands for a person there.
    """
    reason = lock_of(folder, styles=styles)
    if not reason:
        return

    sets = locked_sets()
    development = sets.development
    raise SetLocked(
        f"{choice} may not see this set: {reason}",
        where=folder,
        cause="it was simulated for a last test",
        next_step="simulate another set for this, "
        f"with a --seed from {development.first} to {development.last}",
    )


def require_open_people(set_name: str, people: Iterable[str], choice: str) -> None:
    """Raise SetLocked where a choice would see a locked person of a public set.

    people: of the recordings that the choice sees.
    """
    for of_set in locked_sets().people:
        locked = sorted(set(people) - set(of_set.development))
        if of_set.set == set_name and locked:
            raise SetLocked(
                f"{choice} may not see {', '.join(locked)} of {set_name}: {of_set.about}",
                where=set_name,
                cause="these people are there for a last test",
                next_step="score a model on them with holdfast evaluate; learn from "
                + ", ".join(of_set.development),
            )
