"""The shipped cards; apart from card.py, so that `--help` can name them without numpy."""

from __future__ import annotations

from pathlib import Path

CARDS = Path(__file__).resolve().parent / "cards"
STYLES = CARDS / "styles.toml"


def shipped() -> list[str]:
    """Names of the shipped cards, sorted."""
    return sorted(path.stem for path in CARDS.glob("*.toml") if path != STYLES)
