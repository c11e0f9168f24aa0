"""What gave the load onsets of a set: a scene, a camera or a pressed key."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from holdfast.core.contract import RISKY_SLIP, SITUATIONS, Json
from holdfast.core.trial_layout import TACTILE, read_json, truth_path
from holdfast.training.recording import Recording

RISKY = SITUATIONS[RISKY_SLIP]


def onsets_by(root: Path, recordings: Sequence[Recording]) -> dict[str, int]:
    """Provenance (scene, camera, key) -> number of risky events whose onset it gave."""
    count: Counter[str] = Counter()
    for recording in recordings:
        truth = read_json(truth_path(_csv(root, recording.trial_id)))
        for phase in _phases(truth):
            # Older truths do not name what gave a label.
            if phase.get("label") == RISKY and "provenance" in phase:
                count[str(phase["provenance"])] += 1
    return dict(sorted(count.items()))


def onsets_in_words(by: dict[str, int]) -> str:
    """What gave the load onsets, where a camera or a person did; "" for a scene or a script."""
    # A scene and a script know their onsets exactly, and need no such note.
    if not by.keys() & {"camera", "key"}:
        return ""
    parts = [f"{name} {count}" for name, count in by.items()]
    counts = ", ".join(parts)
    return (
        f"source of load onsets: {counts}; a camera gives the object's first motion, a pressed key "
        "is late"
    )


def _phases(content: Json) -> list[Json]:
    phases = content.get("phases", [])
    # An older or hand-written file may hold anything here.
    if not isinstance(phases, list):
        return []
    return [phase for phase in phases if isinstance(phase, dict)]


def _csv(root: Path, trial_id: str) -> Path:
    """The CSV of a trial: tactile.csv in its folder (or in the root itself), or trial_n.csv."""
    # One recorded trial may be given by itself, and is then the root.
    for folder in (root, root / trial_id):
        if (folder / TACTILE).is_file():
            return folder / TACTILE
    return root / f"{trial_id}.csv"
