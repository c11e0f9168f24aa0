"""What an import takes for true, and by what right: certain, checked, or asked.

Certain is what the log says (a heading, a unit, a file's name) and what the command line answers.
Checked is what the values agree with; the check is named in the table that import prints. All else
is asked. Steps that infer return evidence, and `best` ranks it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

Value = TypeVar("Value")


@dataclass(frozen=True)
class Evidence(Generic[Value]):
    """A value. why: what says it. check: what the values were compared with; "" where certain."""

    value: Value
    why: str
    check: str = ""

    def __str__(self) -> str:
        return f"checked: {self.why}, {self.check}" if self.check else self.why


def best(*found: Evidence[Value] | None) -> Evidence[Value] | None:
    """The first that is certain, else the first that is checked; None where it must be asked."""
    there = [one for one in found if one is not None]
    return min(there, key=lambda one: bool(one.check), default=None)
