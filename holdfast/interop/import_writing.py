"""Imported trials as a set: `[<person>/]<object>/<action>/trial_<n>.csv`, with all beside them."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from holdfast.core.column_map import ColumnMap
from holdfast.core.contract import Json, channel_names
from holdfast.core.hand_card import (
    FEWEST_SENSORS,
    FINGERS_AT_MM,
    MOST_SENSORS,
    Side,
    find_hand_card,
)
from holdfast.core.toml_lines import toml_text
from holdfast.core.trial_file import TIME_COLUMN
from holdfast.core.trial_layout import HAND_FILE, MASSES_KEY, META, truth_path
from holdfast.core.writing import whole_folder, write_whole
from holdfast.interop.import_map import NAMES, ImportMap
from holdfast.interop.import_trials import PROVENANCE, ImportedTrial
from holdfast.training.datasets.trials import EMPTY_HAND

MAP_FILE = "import.toml"
"""The map, kept with what it made."""
THESIS_SENSORS = 6
"""Of a set without a hand card."""
SPREAD_MM = 2.0 * FINGERS_AT_MM[0]
"""Between the outermost sensors of a side, where nothing says it."""
THUMB_NAMES = ("thumb", "daumen", "pouce", "pulgar")


def write_set(
    out: Path, trials: Sequence[ImportedTrial], plan: ImportMap
) -> dict[str, str]:
    """Write all or nothing. Returns each trial's path below the set -> its source.

    Raises OutputError.
    """
    written: dict[str, str] = {}
    counts: dict[str, int] = {}
    with whole_folder(out) as folder:
        for trial in trials:
            place = folder_of(trial)
            counts[place] = counts.get(place, 0) + 1
            name = f"{place}/trial_{counts[place]}.csv"
            write_whole(folder / name, csv_of(trial))
            if trial.phases is not None:
                write_whole(truth_path(folder / name), truth_of(trial))
            written[name] = trial.source
        write_whole(folder / META, json.dumps(meta_of(plan, written), indent=1) + "\n")
        write_whole(folder / MAP_FILE, plan.columns.text)
        card = hand_card_text(plan.columns)
        if card:
            write_whole(folder / HAND_FILE, card)
    return written


def folder_of(trial: ImportedTrial) -> str:
    """The folder of a trial below its set."""
    parts = [trial.person, trial.object_name, trial.action]
    if trial.action == EMPTY_HAND:
        parts = [trial.person, EMPTY_HAND]
    return "/".join(part for part in parts if part)


def csv_of(trial: ImportedTrial) -> str:
    """The samples as the layout has them; a lost value is nan."""
    samples = trial.trial
    n_sensors = samples.raw.shape[1] // 3
    text = io.StringIO()
    header = ",".join([TIME_COLUMN, *channel_names(n_sensors)])
    table = np.column_stack([samples.t_s, samples.raw])
    formats = ["%.9f", *["%.9g"] * samples.raw.shape[1]]
    np.savetxt(text, table, formats, ",", header=header, comments="")
    return text.getvalue()


def truth_of(trial: ImportedTrial) -> str:
    """The phases of a trial."""
    phases = []
    for phase in trial.phases or ():
        phases.append(
            {
                "t0_s": round(phase.t0_s, 6),
                "t1_s": round(phase.t1_s, 6),
                "label": phase.label,
                "provenance": PROVENANCE,
            }
        )
    return json.dumps({"phases": phases}, indent=1) + "\n"


def meta_of(plan: ImportMap, written: dict[str, str]) -> Json:
    """The meta.json of the set, with the log that each trial came from."""
    facts = {key: value for key, value in plan.facts.items() if key not in NAMES}
    meta: Json = {"unit": plan.columns.unit_of_values, "kind": "recorded", **facts}
    if plan.masses_g:
        meta[MASSES_KEY] = dict(plan.masses_g)
    return {**meta, "imported": written}


def hand_card_text(columns: ColumnMap) -> str:
    """The hand card of a set: what the map names, else one that is proposed for its sensors.

    "" for six sensors without a card, which are the fingertips, and where no card has so many.
    """
    if columns.hand:
        card = find_hand_card(columns.hand, columns.path.parent)
        return card.read_text("utf-8")
    n_sensors = len(columns.sensors)
    is_hand = FEWEST_SENSORS <= n_sensors <= MOST_SENSORS
    if n_sensors == THESIS_SENSORS or not is_hand:
        return ""
    return proposed_hand(columns)


def sides_of(columns: ColumnMap) -> list[Side]:
    """The side of each sensor: by its name, else the first third on that of the thumb."""
    by_name = []
    for sensor in columns.sensors:
        by_name.append(any(word in sensor.x.lower() for word in THUMB_NAMES))
    n_thumb = by_name.count(True)
    n_sensors = len(by_name)
    # the thumb's side comes first in a card
    if not 0 < n_thumb < n_sensors or not all(by_name[:n_thumb]):
        n_thumb = max(1, n_sensors // 3)
    thumb: list[Side] = ["thumb"] * n_thumb
    return [*thumb, *(["opposing"] * (n_sensors - n_thumb))]  # type: ignore[list-item]


def proposed_hand(columns: ColumnMap) -> str:
    """A hand card for the sensors of a map, to be corrected: sides and places are a guess."""
    sides = sides_of(columns)
    lines = [
        f'name = "imported-{len(sides)}-sensors"',
        'about = "Proposed by holdfast import: correct sides and places"',
    ]
    for number, (side, sensor) in enumerate(
        zip(sides, columns.sensors, strict=True), 1
    ):
        of_side = [k for k, one in enumerate(sides, 1) if one == side]
        along_mm = _place_mm(of_side.index(number), len(of_side))
        lines += [
            "",
            f"[[sensors]]  # {sensor.x}, {sensor.y}, {sensor.z}".replace("\n", " "),
            f"name = {toml_text(f'sensor-{number}')}",
            f"side = {toml_text(side)}",
            f"along_mm = {along_mm:g}",
        ]
    return "\n".join(lines) + "\n"


def _place_mm(k: int, count: int) -> float:
    """The k-th of evenly spread places about 0, the uppermost first."""
    return round(SPREAD_MM * (0.5 - k / (count - 1)), 1) if count > 1 else 0.0
