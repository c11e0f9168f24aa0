"""`holdfast import`: logs of other programs, by a column map, as trials.

holdfast import logs --out trials                   proposes a map, and asks
holdfast import logs --out trials --map lab.toml
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from holdfast.cli.command import add_json_option, path_argument, show, show_found
from holdfast.core.errors import (
    CardError,
    DataError,
    OutputError,
    UsageError,
    count_of,
    one_line,
)

if TYPE_CHECKING:
    from holdfast.interop.import_map import ImportMap
    from holdfast.interop.import_trials import ImportFault

MAP_SUFFIX = "-map.toml"
"""Of a proposed map, beside the set that it is for."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    option(
        "source",
        type=path_argument,
        metavar="SOURCE",
        help="CSV, xlsx, MCAP, Parquet, XDF, a rosbag2 or LeRobot folder, or a folder of them",
    )
    option(
        "--out", type=path_argument, required=True, metavar="DIR", help="a new folder"
    )
    option(
        "--map",
        type=path_argument,
        metavar="MAP.toml",
        help="column map (docs/your-data.md); without it one is proposed",
    )
    option("--yes", action="store_true", help="take the proposed map without asking")
    add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Read all logs, then write all trials, or none and every fault."""
    if args.out.exists() and (not args.out.is_dir() or any(args.out.iterdir())):
        raise OutputError(
            "exists and is not empty", where=args.out, next_step="name a new folder"
        )
    plan = _plan(args)
    if plan is None:
        return UsageError.exit_code
    from holdfast.interop.import_trials import TrialImport
    from holdfast.training.progress import Stages

    reading = TrialImport(args.source, plan)
    begin = Stages()
    begin(f"reading {args.source}")
    reading.read(begin.part)
    if reading.faults:
        found = {"out": None, "faults": [vars(fault) for fault in reading.faults]}
        show_found(args, "\n".join(_fault_lines(reading.faults, plan)), found)
        return DataError.exit_code

    from holdfast.interop.import_writing import write_set

    written = write_set(args.out, reading.trials, plan)
    show_found(
        args,
        "\n".join([*reading.notes, *_written_lines(args.out, written, plan)]),
        {
            "out": str(args.out),
            "trials": written,
            "faults": [],
            "notes": reading.notes,
        },
    )
    return 0


def _plan(args: argparse.Namespace) -> ImportMap | None:
    """The map of --map, else the one that is proposed and taken; None where it is not taken."""
    from holdfast.interop.import_map import import_map_of_text, read_import_map

    if args.map is not None:
        try:
            return read_import_map(args.map)
        except FileNotFoundError:
            raise UsageError(
                "no such column map", where=args.map, next_step="check the path"
            ) from None

    from holdfast.interop.proposal import propose

    beside = args.out.with_name(args.out.name + MAP_SUFFIX)
    proposal = propose(args.source)
    # With --json alone on stdout, the map is in its file.
    if args.json is None:
        show(proposal.text)
    command = f"holdfast import {args.source} --out {args.out} --map {beside}"
    on_terminal = sys.stdin.isatty() and sys.stdout.isatty()
    if not proposal.gaps and (args.yes or (on_terminal and _agrees())):
        return import_map_of_text(proposal.text, beside)
    _write_map(beside, proposal.text)
    if proposal.gaps and (args.yes or on_terminal):
        raise CardError(
            f"the proposed map is written, but not whole: {'; '.join(proposal.gaps)}",
            where=beside,
            next_step=f"write what is missing, then {command}",
        )
    lines = [f"{beside}: the map above, written; no trial yet"]
    lines += [f"missing: {gap}" for gap in proposal.gaps]
    lines.append(f"next: correct it, then {command}")
    found = {"out": None, "map": str(beside), "next": command}
    show_found(args, "\n".join(lines), {**found, "missing": list(proposal.gaps)})
    return None


def _agrees() -> bool:
    """Whether the user takes the map that was shown."""
    answer = input("take this map? [y/N] ")
    return answer.strip().lower() in ("y", "yes")


def _write_map(path: Path, text: str) -> None:
    """Write a proposed map. Raises OutputError for one that is there and differs."""
    from holdfast.core.writing import write_whole

    if path.exists() and path.read_bytes() != text.encode():
        raise OutputError(
            "exists, and may hold your corrections",
            where=path,
            next_step=f"give it: --map {path}; or remove it",
        )
    write_whole(path, text)


def _fault_lines(faults: list[ImportFault], plan: ImportMap) -> list[str]:
    """All faults, those that differ in place and numbers alone in one."""
    from holdfast.training.check_lines import alike

    lines = []
    for first, more in alike(faults, lambda fault: f"{fault.what} {fault.map_line}"):
        lines += [f"ERROR {one_line(first.where)}: {one_line(first.what)}"]
        if first.map_line:
            lines.append(f"  {plan.columns.path}, {one_line(first.map_line)}")
        if first.next_step:
            lines.append(f"  -> {one_line(first.next_step)}")
        if more:
            lines.append(f"  {more} more like it")
        lines.append("")
    return [*lines, "nothing was written: correct each ERROR, then import again"]


def _written_lines(out: Path, written: dict[str, str], plan: ImportMap) -> list[str]:
    """What was written, and what to look at."""
    from holdfast.core.trial_layout import HAND_FILE

    n_sensors = len(plan.columns.sensors)
    unit = plan.columns.unit_of_values
    lines = [
        f"{out}: {count_of(len(written), 'trial')}, {count_of(n_sensors, 'sensor')}, in {unit}"
    ]
    if not plan.columns.hand and (out / HAND_FILE).is_file():
        lines.append(
            f"{out / HAND_FILE}: proposed for {count_of(n_sensors, 'sensor')}; correct their "
            "sides and places"
        )
    return [*lines, f"next: holdfast check {out}"]
