"""Imported trials as a set: `[<person>/]<object>/<action>/trial_<n>.csv`, with all beside them."""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np

from holdfast.core.column_map import SensorColumns
from holdfast.core.contract import FloatArray, Json
from holdfast.core.hand_card import (
    FEWEST_SENSORS,
    FINGERS_AT_MM,
    MOST_SENSORS,
    find_hand_card,
)
from holdfast.core.table import trial_csv
from holdfast.core.trial_file import Trial
from holdfast.core.trial_layout import HAND_FILE, MASSES_KEY, META
from holdfast.core.writing import write_whole
from holdfast.data.metrics import run_starts
from holdfast.interop.map import ImportMap, map_text, toml_text
from holdfast.interop.sensors import THUMB


def write_csv(path: Path, trial: Trial, absent: Collection[str] = ()) -> None:
    """The samples as the layout has them; a lost value is nan. absent: what is not measured."""
    decimals = decimals_of(trial.t_s), decimals_of(trial.raw)
    write_whole(path, trial_csv(trial.t_s, trial.raw, *decimals, absent))


def decimals_of(values: FloatArray) -> int:
    """How many decimals all values need, of nine: a thousandth of a unit of any sensor."""
    known = np.nan_to_num(values)
    digits = len(str(int(np.abs(known).max())))
    # as exact as float64 is
    most = min(9, 15 - digits)
    exact = known.round(most)
    return next(n for n in range(most + 1) if (known.round(n) == exact).all())


def truth_of(trial: Trial, labels: np.ndarray) -> str:
    """The phases of a trial: runs of equal labels [T], "" for none."""
    ends_s = np.append(trial.t_s, trial.t_s[-1] + 1.0 / trial.rate_hz).round(6).tolist()
    phases = []
    for first, stop in pairwise([*run_starts(labels), len(labels)]):
        if labels[first]:
            phases.append(
                {
                    "t0_s": ends_s[first],
                    "t1_s": ends_s[stop],
                    "label": labels[first],
                    "provenance": "events",
                }
            )

    return json.dumps({"phases": phases}, indent=1) + "\n"


def write_beside(folder: Path, plan: ImportMap, near: Path, written: Json) -> None:
    """Write meta.json, the map and the hand card of a set.

    near: a path in whose folder the hand card of the map may be. written: trial -> its log.
    """
    facts = plan.facts
    meta: Json = {"unit": plan.unit_of_values, "kind": facts.kind or "recorded"}
    if facts.action_at_s:
        meta["action_at_s"] = facts.action_at_s
    meta |= {MASSES_KEY: plan.masses_g, "imported": written}
    write_whole(folder / META, json.dumps(meta, indent=1) + "\n")
    card = hand_card_text(plan, near)
    if card:
        write_whole(folder / HAND_FILE, card)
        plan = msgspec.structs.replace(plan, hand=HAND_FILE)

    write_whole(folder / "import.toml", map_text(plan))


def thumb_sensors(sensors: Sequence[SensorColumns]) -> int:
    """How many sensors, the first ones, a proposed card has on the thumb's side.

    By the names, else a third; 0 where no card is proposed: of six sensors, which are the
    fingertips, and where no card has so many.
    """
    n_sensors = len(sensors)
    if n_sensors == 6 or not FEWEST_SENSORS <= n_sensors <= MOST_SENSORS:
        return 0
    named = sum(bool(THUMB.search(sensor.x)) for sensor in sensors)
    return named if 0 < named < n_sensors else max(1, n_sensors // 3)


def hand_card_text(plan: ImportMap, near: Path) -> str:
    """The hand card of a set: what the map names, else one that is proposed for its sensors.

    "" where none is proposed.
    """
    if plan.hand:
        return find_hand_card(plan.hand, near.parent).read_text("utf-8")
    n_sensors, n_thumb = len(plan.sensors), thumb_sensors(plan.sensors)
    if not n_thumb:
        return ""
    sensors: list[Json] = []
    for side, count in (("thumb", n_thumb), ("opposing", n_sensors - n_thumb)):
        for along_mm in np.linspace(FINGERS_AT_MM[0], FINGERS_AT_MM[-1], count):
            sensors.append(
                {
                    "name": f"sensor-{len(sensors) + 1}",
                    "side": side,
                    "along_mm": round(along_mm, 1),
                }
            )

    return toml_text(
        {
            "name": f"imported-{n_sensors}-sensors",
            "about": "Proposed by holdfast import: correct sides and places",
            "sensors": sensors,
        }
    )
