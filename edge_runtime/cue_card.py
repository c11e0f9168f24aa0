"""The card (TOML) of the vibration cues: cues.toml beside this file, or the user's own."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from holdfast.edge_runtime.card_file import CardReader, read_toml
from holdfast.edge_runtime.cues import KINDS, UNKNOWN, CueRule, CueTable, Pattern
from holdfast.edge_runtime.errors import CardError, DataNotFound
from holdfast.edge_runtime.reading import Json

SHIPPED = Path(__file__).with_name("cues.toml")
SECTIONS = ("title", "most_per_s", "cues")
KEYS = ("pulses", "on_ms", "off_ms", "strength", "after_ms", "repeat_ms", "urgent")
MOST_PER_S, MOST_PULSES, SHORTEST_MS, LONGEST_MS = 10, 10, 10, 60_000


def read_cues(path: Path = SHIPPED) -> CueTable:
    """Read and check a card. Raises CardError, DataNotFound."""
    try:
        _, raw = read_toml(path)
    except FileNotFoundError:
        raise DataNotFound(
            "no such card of cues", where=path, next_step="docs/feedback.md has the table"
        ) from None
    return _CueReader(path).cues(raw)


class _CueReader(CardReader):
    """Checks one card of cues."""

    def cues(self, raw: Json) -> CueTable:
        self.require_known(raw, SECTIONS, "section")
        tables = self.table(raw, "cues")
        self.require_known(tables, KINDS, "[cues]")
        rules = {
            name: self.rule(f"cues.{name}", self.require_table(f"cues.{name}", table))
            for name, table in tables.items()
        }
        self._require_own_unknown(rules)
        most = self.whole("most_per_s", raw.get("most_per_s"), 1, MOST_PER_S)
        return CueTable(rules, most)

    def rule(self, key: str, table: Json) -> CueRule:
        self.require_known(table, KEYS, key)
        pulses = self.whole(f"{key}.pulses", table.get("pulses"), 1, MOST_PULSES)
        shortest_off_ms = SHORTEST_MS if pulses > 1 else 0
        urgent = table.get("urgent", False)
        if not isinstance(urgent, bool):
            raise self.refused(f"{key}.urgent", urgent, "true or false")
        pattern = Pattern(
            pulses,
            self.whole(f"{key}.on_ms", table.get("on_ms"), SHORTEST_MS, LONGEST_MS),
            self.whole(f"{key}.off_ms", table.get("off_ms"), shortest_off_ms, LONGEST_MS),
            self.strength(f"{key}.strength", table.get("strength")),
        )
        after_ms, repeat_ms = (
            self.whole(f"{key}.{name}", table.get(name, 0), 0, LONGEST_MS)
            for name in ("after_ms", "repeat_ms")
        )
        return CueRule(pattern, after_ms, repeat_ms, urgent)

    def whole(self, key: str, value: Any, least: int, most: int) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
            raise self.refused(key, value, f"a whole number from {least} to {most}")
        return value

    def strength(self, key: str, value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.refused(key, value, "a number above 0, at most 1")
        if not math.isfinite(value) or not 0.0 < value <= 1.0:
            raise self.refused(key, value, "a number above 0, at most 1")
        return float(value)

    def _require_own_unknown(self, rules: dict[str, CueRule]) -> None:
        """The wearer must feel that the state is not known, and take it for nothing else."""
        if UNKNOWN not in rules:
            raise CardError(
                "no [cues.unknown]",
                where=self.path,
                cause="without it, a hand that feels nothing is silent like a safe one",
                next_step="give it a pattern of its own",
            )
        felt = _felt(rules[UNKNOWN].pattern)
        for name, rule in rules.items():
            if name != UNKNOWN and _felt(rule.pattern) == felt:
                raise CardError(
                    f"[cues.{name}] and [cues.unknown] have the same pulses",
                    where=self.path,
                    cause="a wearer does not tell them apart by strength alone",
                    next_step="give unknown a pattern of its own",
                )


def _felt(pattern: Pattern) -> tuple[int, int, int]:
    """A pattern without its strength; the pause after a single pulse is not felt."""
    return pattern.pulses, pattern.on_ms, pattern.off_ms if pattern.pulses > 1 else 0
