"""From the options of `holdfast record` to a session: source, bias, camera, and what is there."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

from holdfast.cli.command import show_found
from holdfast.core.errors import LabelError, UsageError
from holdfast.core.reading import Json
from holdfast.core.source import Source
from holdfast.drivers.camera.sources import OAK
from holdfast.live.bias import MeasuredBias, measure_bias, require_good
from holdfast.live.hand_sources import is_hand, open_live
from holdfast.live.intent import intent_monitor
from holdfast.live.real_time import first_in_line
from holdfast.live.sources import force_of
from holdfast.sessions.camera import CameraOptions
from holdfast.sessions.recorder.about import about
from holdfast.sessions.recorder.camera import Beside
from holdfast.sessions.recorder.folder import RECORDING, opened, require_ours, trials_of
from holdfast.sessions.recorder.keys import Keys
from holdfast.sessions.recorder.labels import scene_truth_of
from holdfast.sessions.recorder.plan import Plan, planned
from holdfast.sessions.recorder.protocol import NOTHING, word
from holdfast.sessions.recorder.session import (
    Announce,
    HostClock,
    Session,
    SessionOptions,
    Show,
    announce_nothing,
    show_nothing,
)

CHECK_S = 1.0
KINDS = {
    "usb": "recorded",
    "i2c": "recorded",
    "virtual": "simulated",
    "sim": "simulated",
}
CameraOf = Callable[[Json], Beside]


def record(
    args: argparse.Namespace,
    clock: Any,
    keys: Keys,
    say: Callable[[str], None],
    stopped: Any,
    show: Show = show_nothing,
    *,
    announce: Announce = announce_nothing,
    host_ns: HostClock = time.monotonic_ns,
    camera: CameraOf = Beside,
) -> int:
    """The verb on any clock and keys. Raises a HoldfastError.

    announce: gets each trial before it begins. host_ns: clock of a camera's time stamps, to which
    the samples' are converted. camera: what films, from its options.
    """
    person = word(args.person, "pseudonym")
    require_ours(args.out)
    plan = planned(args, person)
    require_camera(args)
    require_keys(args, plan, keys)
    _report_before(args.out, person, plan, say)
    kept = record_plan(
        args,
        plan,
        clock,
        keys,
        say,
        stopped,
        show,
        announce=announce,
        host_ns=host_ns,
        camera=camera,
    )
    next_step = f"next: holdfast evaluate MODEL --data {args.out}"
    words = f"{kept} trials kept in {args.out / person}; {next_step}"
    show_found(args, words, {"out": args.out, "person": person, "kept": kept})
    return 0


def record_plan(
    args: argparse.Namespace,
    plan: Plan,
    clock: Any,
    keys: Keys,
    say: Callable[[str], None],
    stopped: Any,
    show: Show = show_nothing,
    *,
    announce: Announce = announce_nothing,
    host_ns: HostClock = time.monotonic_ns,
    camera: CameraOf = Beside,
) -> int:
    """Open the source and record the trials of a plan; returns how many were kept.

    args: the checked options of the verb. Raises a HoldfastError.
    """
    say(f"opening {args.source}")
    source = open_live(
        args.source, clock=clock, say=say, to_force=force_of(args.calibration)
    )
    folder = opened(args.out, source.unit, kind_of(args.source))
    own = intent_monitor(args.intent, clock, say)
    with closing(source), folder, own as intent, first_in_line(say) as real_time:
        measured = _checked_bias(source, clock, say, anyway=args.anyway)
        rate_hz = source.rate_hz or args.rate
        session = Session(
            _options(args, plan, rate_hz),
            source,
            clock,
            keys,
            say,
            bias=measured.bias.values,
            about=about(args, source, measured, plan, rate_hz, real_time=real_time),
            camera=camera_of(args, source, host_ns() - clock.now_ns(), camera),
            intent=intent,
            host_ns=host_ns,
            truth=scene_truth_of(args.source, source),
            show=show,
            announce=announce,
        )
        return session.run(plan.tasks, stopped)


def _checked_bias(
    source: Source, clock: Any, say: Callable[[str], None], *, anyway: bool
) -> MeasuredBias:
    """The bias of the hand now. Raises DataError if it is not good, unless anyway."""
    measured = measure_bias(source, clock, say, CHECK_S)
    if not anyway:
        require_good(measured, "nothing is recorded")
    return measured


def kind_of(url: str) -> str:
    """What trials from a source are: recorded, simulated or replayed."""
    scheme, mark, _ = url.partition("://")
    return KINDS.get(scheme if mark else "", "replayed")


def _options(args: argparse.Namespace, plan: Plan, rate_hz: float) -> SessionOptions:
    masses = plan.protocol.mass_g if plan.protocol else {}
    chosen = (args.out, args.person, rate_hz, args.seconds, args.at_once, masses)
    return SessionOptions(*chosen, endless=is_hand(args.source))


def require_keys(args: argparse.Namespace, plan: Plan, keys: Keys) -> None:
    """Raise UsageError where a trial of the plan needs a key and none can be pressed."""
    begins = {} if args.at_once else {"begins": "--at-once"}
    ends = (
        {"ends": "--seconds 8"} if args.seconds is None and is_hand(args.source) else {}
    )
    missing = begins | ends
    if plan.tasks and missing and keys.ended():
        raise UsageError(
            f"only a key {' and '.join(missing)} a trial, and no key can be pressed",
            cause="standard input is at its end (</dev/null), or the program is in the background",
            next_step=f"run it in a terminal, or add {' '.join(missing.values())}",
        )


def require_camera(args: argparse.Namespace) -> None:
    """Raise UsageError for an impossible camera, before anything else happens."""
    _camera_options(args).require_complete()
    if args.camera == "scene":
        from holdfast.sessions.recorder.filming import require_camera_in

        require_camera_in(args.source)
    elif args.camera not in (None, OAK) and not Path(args.camera).exists():
        raise UsageError(
            f"--camera {args.camera!r}: no such file",
            next_step="oak, scene, or a .frames.npz",
        )


def _camera_options(args: argparse.Namespace) -> CameraOptions:
    return CameraOptions(args.camera, args.tag_mm, args.fps, args.exposure_ms)


def camera_of(
    args: argparse.Namespace, source: Source, after_ns: int, camera: CameraOf
) -> Beside | None:
    """The camera of a run, if any; after_ns: its clock minus the source's."""
    if args.camera is None:
        return None
    options = {
        "camera": args.camera,
        "source": args.source,
        **_camera_options(args).shooting(),
    }
    began_ns = getattr(source, "began_ns", None)
    return camera(
        {**options, "began_ns": None if began_ns is None else began_ns + after_ns}
    )


def _report_before(
    root: Path, person: str, plan: Plan, say: Callable[[str], None]
) -> None:
    """Report earlier trials, trials that a kill left, and objects without a mass."""
    if plan.done:
        say(f"{plan.done} of these trials are recorded already; this run continues")
    for folder, meta in trials_of(root, person):
        if meta.get("state") == RECORDING:
            say(
                f"{folder} was interrupted and does not count; next: holdfast repair {folder}"
            )
    for thing in dict.fromkeys(
        task.thing for task in plan.tasks if task.action != NOTHING
    ):
        if plan.protocol is None or thing not in plan.protocol.mass_g:
            _report_mass(root / person / thing, say)
    if not plan.tasks:
        say("every trial of the card is recorded")


def _report_mass(folder: Path, say: Callable[[str], None]) -> None:
    """Warn of a missing mass, which training needs, while the object is still there."""
    from holdfast.core.objects import mass_g

    try:
        mass_g(folder)
    except LabelError as error:
        say(f"warning: {error}")
