"""`holdfast study PROTOCOL --source URL --out DIR --person p01`: runs a study with one person.

    holdfast study thesis --list
    holdfast study thesis --source usb://ft232h --calibration hand.json --out study --person p01
    holdfast study thesis --source sim://p1 --out try --person p01 --rehearse

The same command goes on after a pause, a quit or a crash. docs/study.md has the keys and the files.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from holdfast.cli.command import path_argument, show
from holdfast.cli.options import add_calibration_option, add_recording_options
from holdfast.sessions.study.shipped import CARDS, names_in

if TYPE_CHECKING:
    from holdfast.sessions.study.steps import StudyCard

MODEL = Path("holdfast-150hz")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    cards = f"protocol card: a TOML file, or one of {', '.join(names_in(CARDS))}"
    option("protocol", metavar="PROTOCOL", help=cards)
    steps = "print the steps with their minutes, and stop"
    option("--list", action="store_true", help=steps)
    urls = "a hand as in holdfast record, or a virtual participant such as sim://p1"
    option("--source", metavar="URL", help=urls)
    add_calibration_option(parser)
    out = "folder of all people of the study"
    option("--out", type=path_argument, metavar="DIR", help=out)
    person = "letters, digits, dashes; never a real name"
    option("--person", metavar="PSEUDONYM", help=person)
    add_recording_options(parser, "oak|FILE")
    model = "model file for the report (default: the shipped one)"
    option("--model", type=path_argument, default=MODEL, metavar="MODEL", help=model)
    rehearse = "virtual participant, no operator: every step passes at once"
    option("--rehearse", action="store_true", help=rehearse)
    option(
        "--report",
        action="store_true",
        help="write the report of this person, and stop",
    )
    gone = "delete everything of this person, after a confirmation, and stop"
    option("--withdraw", action="store_true", help=gone)


def run(args: argparse.Namespace) -> int:
    """List the card, run the study, write its report, or delete a person."""
    from holdfast.sessions.study.starting import checked, run_study
    from holdfast.sessions.study.steps import read_study

    card = read_study(args.protocol)
    if args.list:
        show("\n".join(listed(card)))
        return 0
    return run_study(checked(args, card), card, sys.stdin)


def listed(card: StudyCard) -> list[str]:
    """The card as lines: step, minutes, title; and the sum."""
    lines = [card.title]
    lines += [f"before: {one}" for one in card.before]
    for part in card.parts:
        number = "" if part.step is None else str(part.step)
        minutes = f"{part.minutes:g}" if part.minutes else "-"
        times = f" x {part.repetitions}" if part.repetitions else ""
        lines.append(f"{number:>4} {minutes:>5} min  {part.title}{times}")
    return [
        *lines,
        f"steps {card.first_step} to {card.last_step}, {card.minutes:g} minutes",
    ]
