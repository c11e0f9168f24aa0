"""From the words of `holdfast record` to a session: the plan, the bias, the camera, and what every
meta.json says."""

from __future__ import annotations

import argparse
import hashlib
import json
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from drivers.calibration import Bias, bias_of, read_calibration
from drivers.live_hand import LiveHand
from edge_runtime.errors import DataError, LabelError, UsageError
from edge_runtime.live import Source
from edge_runtime.visible import visible
from holdfast.bias import unloaded
from holdfast.live_options import force_of
from holdfast.live_sources import open_live, scene_of
from holdfast.real_time import first_in_line
from holdfast.recorder.beside import Beside
from holdfast.recorder.card import NOTHING, Protocol, Task, left, read_protocol, word
from holdfast.recorder.folder import RECORDING, done, opened, require_ours, trials_of
from holdfast.recorder.labels import MARKS
from holdfast.recorder.session import HostClock, Session, SessionOptions, Show, show_nothing

CHECK_S = 1.0
KINDS = {"usb": "recorded", "i2c": "recorded", "virtual": "simulated", "sim": "simulated"}
ENDLESS = 100_000
CameraOf = Callable[[dict[str, Any]], Beside]
Checked = tuple[Bias, tuple[str, ...], bool]
"""A bias, what is odd about it, and whether it is good."""


@dataclass(frozen=True)
class Plan:
    """What is to be recorded: a card, or one object and action over and over; done: trials of it
    kept before."""

    protocol: Protocol | None
    tasks: list[Task]
    done: int


def record(
    args: argparse.Namespace,
    clock: Any,
    keys: Any,
    say: Callable[[str], None],
    stopped: Any,
    show: Show = show_nothing,
    *,
    host_ns: HostClock = time.monotonic_ns,
    camera: CameraOf = Beside,
) -> int:
    """The verb on any clock and keys. Raises what can go wrong, as a HoldfastError.

    host_ns: the clock of a camera's stamps, to which the samples' are carried over. camera: films
    as it is told.
    """
    person = word(args.person, "pseudonym")
    require_ours(args.out)
    plan = planned(args, person)
    require_camera(args)
    source = open_live(args.source, clock=clock, say=say, to_force=force_of(args.calibration))
    try:
        kind = KINDS.get(
            args.source.partition("://")[0] if "://" in args.source else "", "replayed"
        )
        with opened(args.out, source.unit, kind), first_in_line(say) as real_time:
            _tell_before(args.out, person, plan, say)
            bias, warnings, good = checked(source, clock, say, anyway=args.anyway)
            rate_hz = source.rate_hz or args.rate
            masses = plan.protocol.mass_g if plan.protocol else {}
            session = Session(
                SessionOptions(args.out, person, rate_hz, args.seconds, args.at_once, masses),
                source,
                clock,
                keys,
                say,
                bias=bias.values,
                about=about(
                    args, source, (bias, warnings, good), plan, rate_hz, real_time=real_time
                ),
                camera=camera_of(args, source, host_ns() - clock.now_ns(), camera),
                host_ns=host_ns,
                truth=truth_of(args.source, source),
                show=show,
            )
            kept = session.run(plan.tasks, stopped)
    finally:
        source.close()
    print(
        visible(
            f"{kept} trials kept in {args.out / person}; next: holdfast evaluate MODEL --data {args.out}"
        )
    )
    return 0


def planned(args: argparse.Namespace, person: str) -> Plan:
    """The tasks that are left. Raises UsageError, CardError."""
    if (args.protocol is None) == (args.object is None and args.action is None):
        raise UsageError(
            "what is to be recorded?", next_step="--protocol CARD, or --object NAME --action ACTION"
        )
    if args.trials is not None and args.trials < 1:
        raise UsageError(f"--trials {args.trials}", next_step="a whole number from 1")
    if args.protocol is not None:
        protocol = read_protocol(args.protocol)
        tasks = left(protocol.ordered(args.seed, person), done(args.out, person))
        return Plan(protocol, tasks[: args.trials], len(protocol.tasks) - len(tasks))
    if args.action is None or (args.object is None) != (args.action == NOTHING):
        raise UsageError(
            "--object and --action go together", next_step="--object soft-ball --action pull"
        )
    if args.at_once and args.trials is None:
        raise UsageError("--at-once without an end", next_step="--trials N, or a --protocol")
    task = Task(word(args.object, "object") if args.object else NOTHING, args.action)
    return Plan(None, [task] * (args.trials or ENDLESS), done(args.out, person).count(task))


def checked(source: Source, clock: Any, say: Callable[[str], None], *, anyway: bool) -> Checked:
    """The bias of the hand as it is now, untouched; where it is not good, DataError is raised,
    unless anyway."""
    say(f"leave the hand alone for {CHECK_S:g} s: its bias is taken")
    bias, warnings = bias_of(unloaded(source, clock, CHECK_S), source.unit)
    for warning in warnings:
        say(f"warning: {warning}")
    # a reversed magnet is turned by the model's preparation
    odd = len(warnings) - bool(bias.reversed.any())
    if odd and not anyway:
        raise DataError(
            "not a good bias, nothing is recorded",
            cause="; ".join(warnings),
            next_step="mend that, or add --anyway",
        )
    return bias, warnings, not odd


def require_camera(args: argparse.Namespace) -> None:
    """Raise UsageError for a camera that cannot be, before anything else is done."""
    if args.camera == "oak" and args.tag_mm is None:
        raise UsageError(
            "--tag-mm is missing", next_step="measure a tag's black square and give --tag-mm 9.96"
        )
    if args.camera == "scene":
        from holdfast.recorder.filming import camera_of

        camera_of(args.source)
    elif args.camera not in (None, "oak") and not Path(args.camera).exists():
        raise UsageError(
            f"--camera {args.camera!r}: no such file", next_step="oak, scene, or a .frames.npz"
        )


def camera_of(
    args: argparse.Namespace, source: Source, after_ns: int, camera: CameraOf
) -> Beside | None:
    """What films beside, if anything. after_ns: what the camera's clock is ahead of the
    source's."""
    if args.camera is None:
        return None
    told = {
        name: getattr(args, name) for name in ("camera", "source", "tag_mm", "fps", "exposure_ms")
    }
    began_ns = getattr(source, "began_ns", None)
    return camera({**told, "began_ns": None if began_ns is None else began_ns + after_ns})


def truth_of(url: str, source: Source) -> Callable[[int, int], list[dict[str, Any]]] | None:
    """What a scene knows of a trial, given the times of its first and last sample, as events; None
    without one."""
    found = scene_of(url) if "://" in url else None
    if found is None:
        return None
    began_ns = getattr(source, "began_ns", None)

    def events(first_ns: int, last_ns: int) -> list[dict[str, Any]]:
        end_s = 1e-9 * (last_ns - first_ns)
        truth = (
            found[1]
            .truth.shifted(0.0 if began_ns is None else 1e-9 * (began_ns - first_ns))
            .to_json()
        )
        by = {"provenance": "scene", "by": "holdfast record"}
        phases = [
            {
                "t0_s": max(0.0, one["t0_s"]),
                "t1_s": min(end_s, one["t1_s"]),
                "label": one["label"],
                **by,
            }
            for one in truth["phases"]
            if one["t1_s"] > 0.0 and one["t0_s"] < end_s
        ]
        marks = [
            {"t_s": truth[f"{name}_s"], "mark": name, **by}
            for name in MARKS
            if truth[f"{name}_s"] is not None and 0.0 <= truth[f"{name}_s"] <= end_s
        ]
        return [*phases, *marks]

    return events


def about(
    args: argparse.Namespace,
    source: Source,
    checked: Checked,
    plan: Plan,
    rate_hz: float,
    *,
    real_time: bool,
) -> dict[str, Any]:
    """What every trial's meta.json says; paths by their last part only, which name nobody."""
    bias, warnings, good = checked
    said = {
        name: _plain(value)
        for name, value in vars(args).items()
        if name not in ("person", "object", "action")
    }
    packages = {name: version(name) for name in ("holdfast", "numpy")}
    return {
        "unit": source.unit,
        "rate_hz": rate_hz,
        "hand": source.about() if isinstance(source, LiveHand) else None,
        "calibration": _calibration(args.calibration),
        "bias": {
            "values": bias.values.tolist(),
            "spread": bias.spread.tolist(),
            "n": bias.n,
            "unit": bias.unit,
            "reversed": bias.reversed.tolist(),
            "warnings": list(warnings),
            "good": good,
        },
        "protocol": None
        if plan.protocol is None
        else {
            "card": plan.protocol.name,
            "sha256": plan.protocol.sha256,
            "seed": args.seed,
            "done_before": plan.done,
        },
        "versions": {
            **packages,
            "python": platform.python_version(),
            "machine": platform.machine(),
        },
        "real_time_priority": real_time,
        "configuration": said,
    }


def _calibration(path: Path | None) -> dict[str, Any] | None:
    if path is None:
        return None
    meta = read_calibration(path).meta
    return {
        "file": path.name,
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "source": meta.source,
        "date": meta.date,
        "n": meta.n,
        "content": json.loads(path.read_text("utf-8")),
    }


def _plain(value: Any) -> Any:
    """A path or a URL of one without its folders."""
    if isinstance(value, Path):
        return value.name
    if isinstance(value, str) and "/" in value:
        scheme, mark, name = value.rpartition("://")
        return f"{scheme}{mark}{'&'.join(_last(part) for part in name.split('&'))}"
    return value


def _last(part: str) -> str:
    key, mark, path = part.rpartition("=")
    head, question, key = key.rpartition("?")
    return f"{head.rpartition('/')[2]}{question}{key}{mark}{path.rpartition('/')[2]}"


def _tell_before(root: Path, person: str, plan: Plan, say: Callable[[str], None]) -> None:
    """What is there already, and what a kill has left."""
    if plan.done:
        say(f"{plan.done} of these trials are there already; it goes on with the next")
    for folder, meta in trials_of(root, person):
        if meta.get("state") == RECORDING:
            say(f"{folder} was cut off and does not count; holdfast repair {folder} mends it")
    for thing in dict.fromkeys(task.thing for task in plan.tasks if task.action != NOTHING):
        if plan.protocol is None or thing not in plan.protocol.mass_g:
            _tell_weight(root / person / thing, say)
    if not plan.tasks:
        say("every trial of the card is recorded")


def _tell_weight(folder: Path, say: Callable[[str], None]) -> None:
    """What training will miss, while the object is still at hand."""
    from training.objects import mass_g

    try:
        mass_g(folder)
    except LabelError as error:
        say(f"warning: {error}")
