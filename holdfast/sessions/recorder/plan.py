"""The trials that a run of the recorder is to record."""

from __future__ import annotations

import argparse
from dataclasses import dataclass

from holdfast.core.errors import UsageError
from holdfast.sessions.recorder.folder import done
from holdfast.sessions.recorder.protocol import (
    NOTHING,
    Protocol,
    Task,
    left,
    read_protocol,
    word,
)

ENDLESS = 100_000


@dataclass(frozen=True)
class Plan:
    """The trials of a card, or one object and action repeatedly; done: trials of it kept before."""

    protocol: Protocol | None
    tasks: list[Task]
    done: int


def planned(args: argparse.Namespace, person: str) -> Plan:
    """The tasks that are left. Raises UsageError, CardError."""
    if (args.protocol is None) == (args.object is None and args.action is None):
        raise UsageError(
            "no trials given",
            next_step="--protocol CARD, or --object NAME --action ACTION",
        )
    if args.trials is not None and args.trials < 1:
        raise UsageError(f"--trials {args.trials}", next_step="a whole number from 1")
    if args.protocol is not None:
        protocol = read_protocol(args.protocol)
        tasks = left(protocol.ordered(args.seed, person), done(args.out, person))
        return Plan(protocol, tasks[: args.trials], len(protocol.tasks) - len(tasks))
    if args.action is None or (args.object is None) != (args.action == NOTHING):
        raise UsageError(
            "--object and --action go together",
            next_step="--object soft-ball --action pull",
        )
    if args.at_once and args.trials is None:
        raise UsageError(
            "--at-once without an end", next_step="--trials N, or a --protocol"
        )
    task = Task(word(args.object, "object") if args.object else NOTHING, args.action)
    return Plan(
        None, [task] * (args.trials or ENDLESS), done(args.out, person).count(task)
    )
