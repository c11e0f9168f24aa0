"""What is recorded with people: `holdfast record`, `study` and `watch`.

record: trials, safe against crashes; a second run continues with the next trial.

    holdfast record --source usb://ft232h --calibration c.json --out trials --person p01 \\
        --protocol protocol.toml
    holdfast record --source "virtual://ft232h?scene=pull-soft-ball" --out trials --person p00 \\
        --object soft-ball --action pull --trials 1 --at-once --seconds 8

study: a study with one person; the same command goes on after a pause, a quit or a crash.

    holdfast study thesis --source usb://ft232h --calibration hand.json --out study --person p01

watch: video and tag tracks until Ctrl-C, or with --onset the onset of slip that a camera saw.

    holdfast watch --camera oak --tag-mm 9.96 --seconds 15 --out trials/7
    holdfast watch --onset trials/7 --action pull          a label in trials/7/events.jsonl

The action decides what a slip means: pull, fall and hold make it risky, pass and put-down safe.
docs/recording-and-study.md has the keys and the files.
"""

from __future__ import annotations

import argparse
import sys
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from holdfast.cli.command import (
    add_json_option,
    add_out_option,
    add_seed_option,
    path_argument,
    positive,
    show,
    show_found,
)
from holdfast.cli.options import (
    add_camera_options,
    add_hand_options,
    add_recording_options,
    add_seconds_option,
)
from holdfast.core.errors import TagError, UsageError, command, count_of
from holdfast.core.trial_layout import SITUATION_OF_ACTION
from holdfast.sessions.onset import ACTIONS, GROSS_MM, doubt, read_motion, write_label
from holdfast.sessions.study import shipped_protocols

if TYPE_CHECKING:
    from holdfast.drivers.camera.graph import FrameSource


def _add_person_option(parser: argparse.ArgumentParser, *, required: bool) -> None:
    parser.add_argument(
        "--person",
        required=required,
        metavar="PSEUDONYM",
        help="letters, digits, dashes; never a real name",
    )


# -- record


def add_record_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    add_hand_options(parser)
    add_out_option(parser, "folder of recordings, new or of an earlier run")
    _add_person_option(parser, required=True)
    option(
        "--protocol",
        type=path_argument,
        metavar="PROTOCOL",
        help="recording protocol (TOML): which trials, in which number",
    )
    option(
        "--object",
        metavar="NAME",
        help="without a protocol: the object, such as soft-ball",
    )
    option(
        "--action",
        choices=tuple(SITUATION_OF_ACTION),
        help="without a protocol: the action",
    )
    add_seed_option(parser, "the order of the protocol's trials")
    option("--trials", type=int, metavar="N", help="stop after N trials")
    option(
        "--at-once",
        action="store_true",
        help="begin every trial without waiting for a key",
    )
    add_recording_options(parser)
    add_json_option(parser)


def run_record(args: argparse.Namespace) -> int:
    """Record until the plan is done, the operator stops it, or an error ends it."""
    from holdfast.live.running import stop_signals
    from holdfast.live.sources import is_standard_input
    from holdfast.sessions.recorder.plan import RecordOptions
    from holdfast.sessions.recorder.recording import record
    from holdfast.sessions.recorder.terminal import Keys, context_of, listening

    options = RecordOptions.of(args)
    with ExitStack() as stack:
        stopped = stack.enter_context(stop_signals())
        keys = Keys(None)
        # Samples are no keys.
        if not any(map(is_standard_input, (args.source, args.wearer or ""))):
            keys = stack.enter_context(listening(sys.stdin.fileno()))
        kept = record(options, context_of(keys, stopped, args.seconds))

    next_step = f"next: {command('evaluate', 'MODEL', '--data', args.out)}"
    words = f"{count_of(kept, 'trial')} kept in {args.out / args.person}; {next_step}"
    show_found(args, words, {"out": args.out, "person": args.person, "kept": kept})
    return stopped.exit_code


# -- study


def add_study_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    shipped = ", ".join(shipped_protocols())
    option(
        "protocol",
        metavar="PROTOCOL",
        help=f"study protocol: a TOML file, or one of {shipped}",
    )
    option(
        "--list",
        action="store_true",
        help="print the steps with their minutes, and stop",
    )
    add_hand_options(parser, required=False)
    option(
        "--out",
        type=path_argument,
        metavar="DIR",
        help="folder of all people of the study",
    )
    _add_person_option(parser, required=False)
    add_recording_options(parser)
    option(
        "--report",
        action="store_true",
        help="write the report of this person, and stop",
    )
    option(
        "--withdraw",
        action="store_true",
        help="delete everything of this person, after a confirmation, and stop",
    )


def run_study(args: argparse.Namespace) -> int:
    """List the protocol, run the study, write its report, or delete a person."""
    from holdfast.sessions.recorder.plan import RecordOptions
    from holdfast.sessions.study.protocol import read_study
    from holdfast.sessions.study.run import (
        Ending,
        run_study,
        withdraw_person,
        write_participant_report,
    )

    protocol = read_study(args.protocol)
    # The listing needs no hand, no person and no folder.
    if args.list:
        show("\n".join(protocol.listing()))
        return 0

    # An option that is missing, or that goes with no other.
    needed = ["out", "person"]
    # Reports and withdrawals work on files alone, without a hand.
    if not args.report and not args.withdraw:
        needed.append("source")
    for option in needed:
        if getattr(args, option) is None:
            step = "holdfast study --help shows all"
            raise UsageError(f"--{option} is missing", next_step=step)

    if args.withdraw:
        done = withdraw_person(args.out, args.person, sys.stdin)
        return 0 if done else 1

    if not args.report:
        ending, exit_code = run_study(RecordOptions.of(args), protocol, sys.stdin)
        # A study that goes on later has no report yet.
        if ending != Ending.FINISHED:
            return exit_code

    show("\n".join(write_participant_report(args.out, args.person, protocol)))
    return 0


# -- watch


def add_watch_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    option("--camera", metavar="oak|FILE", help="oak, or a .frames.npz")
    option("--out", type=path_argument, metavar="DIR", help="the trial's folder")
    add_camera_options(parser)
    add_seconds_option(parser, "oak: stop after S seconds")
    option(
        "--onset",
        type=path_argument,
        metavar="TRIAL",
        help="label a watched folder, with the following options; --tag-mm corrects the tags",
    )
    option(
        "--action",
        choices=ACTIONS,
        help="action of the trial (default: the name of its folder)",
    )
    option(
        "--gross-mm",
        type=positive,
        default=GROSS_MM,
        metavar="MM",
        help=f"distance of gross slip, above what the pads give (default {GROSS_MM:g})",
    )
    option(
        "--until",
        type=float,
        dest="until_s",
        metavar="S",
        help="search until S seconds, as before the hand opens",
    )
    add_json_option(parser)


def run_watch(args: argparse.Namespace) -> int:
    """Record, or label what was recorded."""
    if args.onset is not None:
        return _label(args)
    if args.camera is None or args.out is None:
        raise UsageError(
            "--camera and --out are needed", next_step="or --onset TRIAL for a label"
        )
    return _film(args)


def _film(args: argparse.Namespace) -> int:
    """Record until the frames end or the operator stops it; then check the tags.

    Raises TagError where the size of a tag is impossible; the recording is kept.
    """
    from holdfast.drivers.camera.graph import watch
    from holdfast.live.running import say, stop_signals

    source = _source(args)
    with stop_signals() as stopped:
        watched = watch(source, args.out, stopped=stopped)
    counts = f"{watched.frames} frames with tags read, {watched.in_video} in the video"
    words = f"{counts}, {watched.lost} lost between them\n"
    words += f"{args.out}; next: {command('watch', '--onset', args.out)}"
    found = {
        "out": args.out,
        "frames": watched.frames,
        "in_video": watched.in_video,
        "lost": watched.lost,
    }
    show_found(args, words, found)
    # After the recording is whole: a wrong size can be given again with --onset --tag-mm.
    wrong = doubt(args.out)
    if isinstance(wrong, TagError):
        raise wrong
    if wrong is not None:
        say(f"warning: {wrong}")
    return stopped.exit_code


def _source(args: argparse.Namespace) -> FrameSource:
    """The camera, or stored frames. Raises UsageError or a DataError."""
    from holdfast.drivers.camera.graph import OAK, Oak, StoredFrames
    from holdfast.drivers.camera.recording import Lens, read_frames
    from holdfast.sessions.camera import CameraOptions

    options = CameraOptions(
        camera=args.camera,
        tag_mm=args.tag_mm,
        fps=args.fps,
        exposure_ms=args.exposure_ms,
    )
    options.require_camera()
    if args.camera == OAK:
        lens = Lens(**options.shooting(), clock="monotonic")
        return Oak(lens, args.seconds)

    return StoredFrames(*read_frames(Path(args.camera)))


def _label(args: argparse.Namespace) -> int:
    """Find the onset, write it next to the trial, print it."""
    trial = read_motion(args.onset, args.tag_mm)
    if args.until_s is not None:
        trial = replace(trial, moved=trial.moved.until(args.until_s + trial.starts_s))
    words, found = write_label(trial, args.action, args.gross_mm)
    show_found(args, words, found)
    return 0
