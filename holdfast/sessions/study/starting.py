"""From the options of `holdfast study` to a run: checks, the folder, the desk, the report."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, TextIO

from holdfast.cli.command import show
from holdfast.core.errors import CardError, DataNotFound, UsageError
from holdfast.core.writing import require_writable, write_whole
from holdfast.drivers.virtual.clock import VirtualClock
from holdfast.live.hand_sources import is_hand
from holdfast.live.log_sink import stream_sink
from holdfast.live.real_time import RunClock
from holdfast.live.stopping import say, stop_signals
from holdfast.sessions.recorder.folder import require_ours
from holdfast.sessions.recorder.keys import Keys, listening
from holdfast.sessions.recorder.protocol import word
from holdfast.sessions.recorder.recording import kind_of, require_camera
from holdfast.sessions.recorder.session import Show, show_nothing
from holdfast.sessions.recorder.status import StatusLine, columns_of
from holdfast.sessions.study import journal as log
from holdfast.sessions.study.console import HELP, AnyDesk, Desk, Rehearsal
from holdfast.sessions.study.journal import (
    JOURNAL,
    Journal,
    held,
    opened_journal,
    read_journal,
)
from holdfast.sessions.study.questionnaires import write_answers
from holdfast.sessions.study.runner import FINISHED, WITHDRAWN, Runner
from holdfast.sessions.study.steps import StudyCard
from holdfast.sessions.study.trials import Trials
from holdfast.sessions.study.withdrawal import require_not_withdrawn, withdraw

PROTOCOL = "protocol.toml"


def checked(args: argparse.Namespace, card: StudyCard) -> argparse.Namespace:
    """The options, if they go together. Raises UsageError, OutputError."""
    needed = (
        ("out", "person")
        if args.report or args.withdraw
        else ("out", "person", "source")
    )
    for name in needed:
        if getattr(args, name) is None:
            raise UsageError(
                f"--{name} is missing", next_step="holdfast study --help shows all"
            )
    word(args.person, "pseudonym")
    require_ours(args.out)
    if args.rehearse and args.withdraw:
        raise UsageError("--withdraw asks first", next_step="leave out --rehearse")
    if args.report or args.withdraw:
        if not (args.out / args.person).is_dir():
            raise DataNotFound(
                "no such person in this folder",
                where=args.out / args.person,
                next_step="check --out and --person",
            )
        if args.report:
            _require_same_card(args.out / args.person / JOURNAL, card)
        return args
    require_not_withdrawn(args.out, args.person)
    require_camera(args)
    if args.rehearse:
        _require_rehearsal(args)
    _require_same_card(args.out / args.person / JOURNAL, card)
    return args


def _require_rehearsal(args: argparse.Namespace) -> None:
    """Raise UsageError where a rehearsal has no virtual participant."""
    if kind_of(args.source) != "simulated" or args.camera:
        raise UsageError(
            "--rehearse is for a virtual participant without a camera",
            cause="its clock jumps, which neither a hand nor a camera can follow",
            next_step="--source sim://p1, without --camera",
        )
    if is_hand(args.source) and args.seconds is None:
        raise UsageError(
            "a virtual hand has no end of its own, and no operator ends its trials",
            next_step="add --seconds 12, or take --source sim://CARD",
        )


def _require_same_card(journal: Path, card: StudyCard) -> None:
    """Raise CardError where the person began with another card."""
    before = [one for one in read_journal(journal) if one.get("event") == log.OPENED]
    if before and before[0].get("sha256") != card.sha256:
        raise CardError(
            "the card is not the one that this person began with",
            where=journal.parent,
            cause="it was edited in between, or it is another card",
            next_step=f"go on with {journal.with_name(PROTOCOL)}, or take a new pseudonym",
        )


def run_study(args: argparse.Namespace, card: StudyCard, keyboard: TextIO) -> int:
    """The verb, its keys from `keyboard`; returns the exit code. Raises a HoldfastError."""
    if args.report:
        return write_report_of(args, card)
    status = StatusLine(
        stream_sink(sys.stderr), lambda: columns_of(sys.stderr), args.seconds
    )
    clock = VirtualClock() if args.rehearse else RunClock()
    with ExitStack() as stack:
        stopped = stack.enter_context(stop_signals())
        desk: AnyDesk = Rehearsal(status.say, clock, stopped)
        if not args.rehearse:
            keys = stack.enter_context(listening(keyboard.fileno()))
            _require_operator(keys)
            desk = Desk(keys, status.say, status.draw, clock, stopped)
        if args.withdraw:
            return _withdrawn(args, desk)
        shows = status.show if columns_of(sys.stderr) else show_nothing
        ended = run_parts(args, card, desk, clock, stopped, shows)
    return write_report_of(args, card) if ended == FINISHED else 0


def _require_operator(keys: Keys) -> None:
    """Raise UsageError where no key can be pressed."""
    if keys.ended():
        raise UsageError(
            "a study needs an operator, and no key can be pressed",
            cause="standard input is at its end (</dev/null), or it is in the background",
            next_step="run it in a terminal; --rehearse runs a virtual participant alone",
        )


def run_parts(
    args: argparse.Namespace,
    card: StudyCard,
    desk: AnyDesk,
    clock: Any,
    stopped: Callable[[], bool],
    show: Show = show_nothing,
    utc: Callable[[], str] | None = None,
) -> str:
    """Run the study on any desk and clock; returns how it ended. Raises a HoldfastError."""
    home, utc = args.out / args.person, utc or utc_now
    trials = Trials(args, card, clock, desk.say, stopped, show)
    require_writable(args.out)
    trials.require_hand()
    with opened_journal(home, len(card.parts), clock.now_ns, utc) as journal:
        trials.mend()
        _open(args, card, desk, journal)
        ended = Runner(args.out, args.person, card, journal, desk, trials, utc).run()
        if ended != WITHDRAWN:
            write_answers(home, card, journal.progress)
    return ended


def _open(
    args: argparse.Namespace, card: StudyCard, desk: AnyDesk, journal: Journal
) -> None:
    """Begin a run: the first one keeps the card, a later one says where it goes on."""
    home, again = journal.path.parent, bool(journal.entries)
    if not again:
        write_whole(home / PROTOCOL, card.text)
    rehearsal = {"rehearsal": True} if desk.rehearsal else {}
    journal.append(log.OPENED, card=card.name, sha256=card.sha256, **rehearsal)
    desk.say(f"{card.title} ({args.person})")
    if journal.progress.part == len(card.parts):
        desk.say("every step of this person's study is done")
    elif again:
        desk.say("this person's study goes on where it ended")
    else:
        for line in card.before:
            desk.say(f"  before: {line}")
    if not desk.rehearsal:
        desk.say(HELP)


def write_report_of(args: argparse.Namespace, card: StudyCard) -> int:
    """Write the report of a person and print its figures. Raises LabelError, OutputError."""
    from holdfast.sessions.study.outcome import outcome_of
    from holdfast.sessions.study.report import in_words, write_report

    say("writing the report")
    outcome = outcome_of(args.out, args.person, card, args.model)
    show("\n".join(in_words(outcome, write_report(args.out / args.person, outcome))))
    return 0


def _withdrawn(args: argparse.Namespace, desk: AnyDesk) -> int:
    """Delete a person once the pseudonym is typed."""
    typed = desk.text(
        f"everything of {args.person} is deleted; type {args.person} to confirm"
    )
    if typed != args.person:
        desk.say("nothing is deleted")
        return 1
    with held(args.out / args.person / JOURNAL):
        withdraw(args.out, args.person, desk.say, utc_now)
    return 0


def utc_now() -> str:
    """The time now, UTC, ISO 8601 to the second."""
    return time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
