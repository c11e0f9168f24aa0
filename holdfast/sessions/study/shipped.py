"""The shipped protocol cards and questionnaires, found by name."""

from __future__ import annotations

from pathlib import Path

from holdfast.core.errors import DataNotFound

HERE = Path(__file__).resolve().parent


CARDS, QUESTIONNAIRES = HERE / "cards", HERE / "questionnaires"


def names_in(folder: Path) -> list[str]:
    """Names of the shipped files of one kind, sorted."""
    return sorted(path.stem for path in folder.glob("*.toml"))


def found(name: str, folder: Path, what: str) -> Path:
    """A file by its path, or a shipped one by its name. Raises DataNotFound."""
    path = Path(name)
    if path.is_file():
        return path
    names = names_in(folder)
    if name in names:
        return folder / f"{name}.toml"
    raise DataNotFound(
        f"no such {what}",
        where=name,
        cause="a name misspelt, or a path from another folder",
        next_step=f"give a TOML file, or one of {', '.join(names)}",
    )
