"""What an import proposes: answers, logs with their time and sensors, maps, questions."""

from __future__ import annotations

from dataclasses import dataclass, field

from holdfast.core.column_map import SensorColumns, TimeColumn
from holdfast.core.contract import UNIT_OF, FloatArray
from holdfast.core.errors import UsageError
from holdfast.core.trial_layout import SITUATION_OF_ACTION
from holdfast.data.datasets.trials import FOLDERS, action_of
from holdfast.interop.beside import Files
from holdfast.interop.evidence import Evidence
from holdfast.interop.formats.logs import LogPlace
from holdfast.interop.formats.streams import Columns, ForeignLog
from holdfast.interop.labels import action_of_sentence
from holdfast.interop.map import ImportMap


@dataclass(frozen=True)
class Answers:
    """What the command line says. action: a word for all trials, and `word=action`, by commas.

    person, object: a name, or several of those in the paths. normal: x, y or z. rate: in Hz.
    sensors: patterns of the columns of readings. fingers: words of the files of a trial. labels: a
    column or a table of events. unwrap: of 16 bits. Raises UsageError for an unknown unit or
    action.
    """

    action: str = ""
    person: str = ""
    object: str = ""
    unit: str = ""
    sensors: str = ""
    fingers: str = ""
    labels: str = ""
    rate: float | None = None
    normal: str = ""
    unwrap: bool = False

    def __post_init__(self) -> None:
        if self.unit not in ("", *UNIT_OF):
            raise UsageError(
                f"--unit {self.unit}", next_step=f"one of {', '.join(UNIT_OF)}"
            )
        for action in filter(None, [*self.actions.values(), self.whole_action]):
            if action_of(action) is None:
                raise UsageError(
                    f"--action {action}", next_step=f"one of {', '.join(FOLDERS)}"
                )

    @property
    def actions(self) -> dict[str, str]:
        """Words of the logs -> actions, "" for a word that means none."""
        pairs = [one.rsplit("=", 1) for one in self.action.split(",") if "=" in one]
        return {word.strip(): action.strip() for word, action in pairs}

    @property
    def whole_action(self) -> str:
        """The action of all trials; "" where words alone are mapped."""
        return "".join([one for one in self.action.split(",") if "=" not in one][:1])

    @property
    def situations(self) -> dict[str, str]:
        """Words of the logs -> situations."""
        actions = {word: action_of(one) or "" for word, one in self.actions.items()}
        return {word: SITUATION_OF_ACTION.get(one, "") for word, one in actions.items()}

    def meaning(self, word: str) -> str | None:
        """The action that a word means, as given or by itself; None where it says nothing."""
        given = self.actions.get(word)
        return action_of_sentence(word) if given is None else given or None


@dataclass
class Proposal:
    """Maps, each with its logs, in words, and what is left to be asked.

    questions: the option of `holdfast import` that answers it, and what nothing in the logs says.
    kept: name -> a log that need not be read again, because it is the only one.
    """

    plans: list[tuple[ImportMap, Files]] = field(default_factory=list)
    lines: list[str] = field(default_factory=list)
    questions: list[tuple[str, str]] = field(default_factory=list)
    kept: dict[str, ForeignLog] = field(default_factory=dict)

    def add(self, name: str, text: object) -> None:
        """A line of the table: what was understood, and by what right."""
        line = f"{name:<11}{text}"
        if line not in self.lines:
            self.lines.append(line)

    def ask(self, option: str, text: str) -> None:
        """A question."""
        if (option, text) not in self.questions:
            self.questions.append((option, text))


@dataclass(frozen=True)
class Sample:
    """A log with readings: its columns on one clock, its time and sensors.

    The readings themselves are not kept. log: its streams without readings. columns: the others of
    a row. marks: those that may hold labels. effects: what `touch` gives of all rows. unit: what
    says it, and what is not clear. span_s: the first and the last stamp on the log's clock, or the
    rows.
    """

    files: list[LogPlace]
    log: ForeignLog
    columns: Columns
    time: Evidence[TimeColumn] | None
    sensors: Evidence[list[SensorColumns]]
    marks: list[str]
    effects: FloatArray
    span_s: tuple[float, float]
    unit: Evidence[str]

    @property
    def names(self) -> tuple[str, ...]:
        """[C] the columns of the axes."""
        return tuple(name for sensor in self.sensors.value for name in sensor.axes)
