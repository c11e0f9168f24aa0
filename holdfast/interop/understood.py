"""What an import has understood: answers, questions, logs with their time and sensors."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from holdfast.core.column_map import SensorColumns, TimeColumn
from holdfast.interop.columns import NO_TOUCH, FoundTime, Touch
from holdfast.interop.logs import LogPlace
from holdfast.interop.map import ImportMap
from holdfast.interop.streams import Columns, ForeignLog

Files = dict[str, list[LogPlace]]
"""Name of a log -> its file, or a file for each finger."""


@dataclass(frozen=True)
class Answers:
    """What the command line says. action: a word for all trials, or `word=action,word=action`.

    person, object: a name, or several of those in the paths. normal: x, y or z. rate: in Hz.
    """

    action: str = ""
    person: str = ""
    object: str = ""
    unit: str = ""
    rate: float | None = None
    normal: str = ""

    @property
    def actions(self) -> dict[str, str]:
        """Words of the logs -> actions."""
        pairs = [one.split("=", 1) for one in self.action.split(",") if "=" in one]
        return {word.strip(): action.strip() for word, action in pairs}

    @property
    def whole_action(self) -> str:
        """The action of all trials; "" where words are mapped."""
        return "" if "=" in self.action else self.action


@dataclass
class Understood:
    """Maps, each with its logs, in words, and what is left to be asked.

    questions: the option of `holdfast import` that answers it, and what nothing in the logs says.
    kept: name -> a log that need not be read again, because it is the only one.
    """

    plans: list[tuple[ImportMap, Files]] = field(default_factory=list)
    lines: list[str] = field(default_factory=list)
    questions: list[tuple[str, str]] = field(default_factory=list)
    kept: dict[str, ForeignLog] = field(default_factory=dict)

    def add(self, name: str, text: str) -> None:
        """A line of the table."""
        line = f"{name:<11}{text}"
        if line not in self.lines:
            self.lines.append(line)

    def ask(self, option: str, text: str) -> None:
        """A question."""
        self.questions.append((option, text))


@dataclass
class Sample:
    """A log and what it is: its columns on one clock, its time and sensors; none of a table.

    Of the readings only the first rows are kept. marks: columns that may hold labels.
    touched: what a touch does, over all rows. size: the unit by size, and why.
    """

    files: list[LogPlace]
    log: ForeignLog
    columns: Columns
    time: FoundTime | None
    sensors: list[SensorColumns]
    why: str
    marks: set[str] = field(default_factory=set)
    touched: Touch = NO_TOUCH
    size: tuple[str, str] = ("", "")

    @property
    def form(self) -> tuple[str, ...]:
        """What logs of one program have in common."""
        return tuple(name for sensor in self.sensors for name in sensor.axes)

    @property
    def stamps_s(self) -> np.ndarray:
        """[T] on the log's clock."""
        rows = np.arange(max(map(len, self.columns.values())))
        time = self.time.time if self.time else TimeColumn(rate_hz=1.0)
        return self.columns.get(time.column, rows) * (1e-9 * time.unit_ns)
