"""What an import has understood: answers, questions, logs with their time and sensors."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from holdfast.core.column_map import SensorColumns, TimeColumn
from holdfast.core.contract import UNIT_OF, BoolArray, FloatArray
from holdfast.core.errors import UsageError
from holdfast.core.trial_layout import SITUATION_OF_ACTION
from holdfast.data.datasets.trials import action_of
from holdfast.interop.columns import usual_step
from holdfast.interop.logs import LogPlace
from holdfast.interop.map import ImportMap
from holdfast.interop.streams import LOG_TIME, Columns, ForeignLog

Files = dict[str, list[LogPlace]]
"""Name of a log -> its file, or a file for each finger."""


@dataclass(frozen=True)
class Answers:
    """What the command line says. action: a word for all trials, or `word=action,word=action`.

    person, object: a name, or several of those in the paths. normal: x, y or z. rate: in Hz.
    Raises UsageError for an unknown unit.
    """

    action: str = ""
    person: str = ""
    object: str = ""
    unit: str = ""
    rate: float | None = None
    normal: str = ""

    def __post_init__(self) -> None:
        if self.unit not in ("", *UNIT_OF):
            raise UsageError(
                f"--unit {self.unit}", next_step=f"one of {', '.join(UNIT_OF)}"
            )

    @property
    def actions(self) -> dict[str, str]:
        """Words of the logs -> actions."""
        pairs = [one.split("=", 1) for one in self.action.split(",") if "=" in one]
        return {word.strip(): action.strip() for word, action in pairs}

    @property
    def whole_action(self) -> str:
        """The action of all trials; "" where words are mapped."""
        return "" if "=" in self.action else self.action


def situation_of(action: str) -> str:
    """The situation that an action of the command line stands for; "" for none."""
    return SITUATION_OF_ACTION.get(action_of(action) or "", "")


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


@dataclass(frozen=True)
class Sample:
    """A log with readings: its columns on one clock, its time and sensors.

    form: the columns of its sensors, which logs of one program have in common. Of the readings only
    the first rows are kept. why: what makes them sensors. marks: columns that may hold labels.
    effects, touched: what `touch` gives of all rows. size: the unit, and why.
    """

    files: list[LogPlace]
    log: ForeignLog
    columns: Columns
    time: TimeColumn | None
    sensors: list[SensorColumns]
    form: tuple[str, ...]
    why: str
    marks: list[str]
    effects: FloatArray
    touched: BoolArray
    size: tuple[str, str]

    @property
    def stamps_s(self) -> np.ndarray:
        """[T] on the log's clock."""
        rows = np.arange(len(self.touched))
        time = self.time or TimeColumn(rate_hz=1.0)
        return self.columns.get(time.column, rows) * (1e-9 * time.unit_ns)

    @property
    def time_text(self) -> str:
        """Where the time comes from."""
        time = self.time
        if time is None:
            return "not known"
        if time.column == LOG_TIME:
            return "stamps of the log"
        if time.rate_hz:
            what = (
                f"{time.column} counts samples" if time.column else "rows are counted"
            )
            of_log = self.log.about.get("rate_hz")
            by = ", by the head of the log" if time.rate_hz == of_log else " as given"
            return f"{what}, {time.rate_hz:g} Hz{by}"
        hz = 1.0 / usual_step(self.stamps_s[:50_000])
        return f"{time.column}, {hz:.4g} Hz, in {time.unit} by its steps"
