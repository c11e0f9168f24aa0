"""From the options of a run to a session: source, bias, camera, what is there, and meta.json."""

from __future__ import annotations

import hashlib
import platform
import re
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from holdfast.core.contract import Json
from holdfast.core.errors import LabelError, UsageError
from holdfast.core.hand_card import HandCard, read_hand_card
from holdfast.core.schema import json_of, text_of
from holdfast.core.source import Source
from holdfast.core.trial_layout import checked_name, mass_g
from holdfast.drivers.calibration import fields_of, read_calibration
from holdfast.drivers.hand import Hand
from holdfast.drivers.replay import hand_of
from holdfast.edge_runtime.wearer import IntentMonitor
from holdfast.live.hand_files import force_of
from holdfast.live.running import real_time_priority
from holdfast.live.sources import is_hand, open_live
from holdfast.live.wearer import wearer_monitor
from holdfast.sessions.calibrate import MeasuredBias, measure_bias, require_good
from holdfast.sessions.recorder.folder import (
    RECORDING,
    done,
    keep_hand,
    recording_folder,
    require_ours,
    trials_of,
)
from holdfast.sessions.recorder.labels import scene_truth_of
from holdfast.sessions.recorder.plan import (
    NOTHING,
    Protocol,
    RecordOptions,
    Task,
    read_protocol,
    tasks_left,
)
from holdfast.sessions.recorder.session import Session
from holdfast.sessions.recorder.terminal import Display, Keys, RunContext
from holdfast.sessions.set_source import read_set_trial

CHECK_S = 1.0
"""Time over which the bias is measured."""
ENDLESS = 100_000
"""Trials where --trials sets no number: more than anyone records."""


def record(options: RecordOptions, context: RunContext) -> int:
    """Check the options and record what is left; returns how many trials were kept.

    Raises a HoldfastError.
    """
    checked_name(options.person, "pseudonym")
    require_ours(options.out)
    # In this order, so that every mistake of the options is reported before anything opens.
    plan = planned(options)
    options.require_camera()
    require_keys(options, plan, context.keys)
    _report_before(options, plan, context.display)
    return record_plan(options, plan, context)


def record_plan(options: RecordOptions, plan: Plan, context: RunContext) -> int:
    """Open the source and record the trials of a plan; returns how many were kept.

    options: checked. Raises a HoldfastError.
    """
    clock = context.clock
    report = context.display.report
    named = None if options.hand is None else read_hand_card(options.hand)
    report(f"opening {options.source}")
    source = open_source(options, context)
    card = named or _partial_hand(source)
    # The folder is locked for the whole run: a second recorder would mix trial numbers.
    folder = recording_folder(options.out, source.unit, kind_of(options.source))
    monitor: AbstractContextManager[IntentMonitor | None] = nullcontext()
    if options.intent is not None:
        monitor = wearer_monitor(options.intent, clock, report)

    with (
        closing(source),
        folder,
        monitor as intent,
        real_time_priority(report) as has_priority,
    ):
        if card is not None:
            keep_hand(options.out, card, source.n_channels // 3)
        measured = measure_bias(source, clock, report, CHECK_S)
        # A bias that was measured while something touched the hand shifts every sample.
        if not options.anyway:
            require_good(measured, "nothing is recorded")
        # A recording has a rate of its own; a hand is asked for one.
        rate_hz = source.rate_hz or options.rate
        about = {
            "unit": source.unit,
            "rate_hz": rate_hz,
            "hand": source.about() if isinstance(source, Hand) else None,
            "calibration": _calibration(options.calibration),
            "bias": _bias(measured),
            "protocol": _protocol(plan, options.seed),
            "versions": {
                "holdfast": version("holdfast"),
                "numpy": version("numpy"),
                "python": platform.python_version(),
                "machine": platform.machine(),
            },
            "real_time_priority": has_priority,
            "configuration": _configuration(options),
        }
        session = Session(
            options,
            context,
            source,
            rate_hz,
            measured.bias.values,
            about,
            mass_g=plan.mass_g,
            intent=intent,
            truth=scene_truth_of(options.source, source),
            hand=card,
        )
        return session.run(plan.tasks)


def _partial_hand(source: Source) -> HandCard | None:
    """The hand card of a source that does not measure all axes, which a set must have beside it."""
    hand = hand_of(source)
    return hand if hand is not None and hand.unmeasured_names else None


def open_source(options: RecordOptions, context: RunContext) -> Source:
    """The source of a run. Raises a HoldfastError."""
    return open_live(
        options.source,
        clock=context.clock,
        report=context.display.report,
        to_force=force_of(options.calibration),
        read_set=read_set_trial,
    )


def kind_of(url: str) -> str:
    """What trials from a source are: recorded, simulated or replayed."""
    if url.startswith(("virtual://", "sim://")):
        return "simulated"
    return "recorded" if is_hand(url) else "replayed"


@dataclass(frozen=True)
class Plan:
    """Trials of a protocol, or one object and action repeatedly.

    done: trials of it that were kept before.
    """

    protocol: Protocol | None
    tasks: list[Task]
    done: int

    @property
    def mass_g(self) -> dict[str, float]:
        """Masses that the protocol gives, by object."""
        return self.protocol.mass_g if self.protocol else {}


def planned(options: RecordOptions) -> Plan:
    """The tasks that are left. Raises UsageError, CardError."""
    trials = options.trials
    name = options.object
    action = options.action
    before = done(options.out, options.person)
    if options.protocol is not None and name is None and action is None:
        protocol = read_protocol(Path(options.protocol))
        ordered = protocol.ordered(options.seed, options.person)
        # The order is drawn for the whole protocol, so a second run continues the first one's.
        tasks = tasks_left(ordered, before)
        return Plan(protocol, tasks[:trials], len(ordered) - len(tasks))

    # The empty hand holds no object.
    goes_together = (name is None) == (action == NOTHING)
    if options.protocol is not None or action is None or not goes_together:
        raise UsageError(
            "no trials given: --protocol alone, or --object and --action",
            next_step="--protocol PROTOCOL, or --object soft-ball --action pull",
        )
    task = Task(checked_name(name, "object") if name else NOTHING, action)
    count = ENDLESS if trials is None else trials
    return Plan(None, [task] * count, before.count(task))


def require_keys(options: RecordOptions, plan: Plan, keys: Keys) -> None:
    """Raise UsageError where a trial of the plan needs a key and none can be pressed."""
    missing = {}
    if not options.at_once:
        missing["begins"] = "--at-once"
    if options.only_a_key_ends:
        missing["ends"] = "--seconds 8"
    if plan.tasks and missing and keys.ended():
        raise UsageError(
            f"only a key {' and '.join(missing)} a trial, and no key can be pressed",
            cause="standard input is at its end (</dev/null) or is the source, or the program is "
            "in the background",
            next_step=f"run it in a terminal, or add {' '.join(missing.values())}",
        )


# -- before the first trial


def _report_before(options: RecordOptions, plan: Plan, display: Display) -> None:
    """Report earlier trials, trials that a kill left, and objects without a mass."""
    if plan.done:
        display.report(
            f"{plan.done} of these trials are recorded already; this run continues"
        )
    for folder, meta in trials_of(options.out, options.person):
        # Only a recorder that was killed leaves a trial in this state.
        if meta.get("state") == RECORDING:
            display.report(
                f"{folder} was interrupted and does not count; "
                f"next: holdfast check --repair {folder}"
            )
    # Each object once, in the order of the plan.
    for name in dict.fromkeys(task.object for task in plan.tasks):
        if name != NOTHING and name not in plan.mass_g:
            try:
                mass_g(options.out / options.person / name)
            except LabelError as error:
                # While the object is there: without its mass no weight is learned.
                display.report(f"warning: {error}")
    if not plan.tasks:
        display.report("every trial of the protocol is recorded")


# -- what meta.json says of a run; of paths only the last part, because folders can name people


def _configuration(options: RecordOptions) -> Json:
    """The options, without those that meta.json has a key for."""
    values = asdict(options)
    for name in ("person", "object", "action"):
        del values[name]
    return {name: _without_folders(value) for name, value in values.items()}


def _bias(measured: MeasuredBias) -> Json:
    warnings = list(measured.warnings)
    return {**fields_of(measured.bias), "warnings": warnings, "good": measured.good}


def _protocol(plan: Plan, seed: int) -> Json | None:
    protocol = plan.protocol
    if protocol is None:
        return None
    return {
        "card": protocol.name,
        "sha256": protocol.sha256,
        "seed": seed,
        "done_before": plan.done,
    }


def _calibration(path: Path | None) -> Json | None:
    if path is None:
        return None
    text = text_of(path)
    known = read_calibration(path)
    return {
        "file": path.name,
        "sha256": hashlib.sha256(text.encode()).hexdigest(),
        "source": known.source,
        "date": known.date,
        "n": known.n,
        # The whole calibration: the file may be changed later, the recording may not.
        "content": json_of(text),
    }


def _without_folders(value: Any) -> Any:
    """A path, or a URL with paths, without the folders."""
    if isinstance(value, Path):
        return value.name
    if isinstance(value, str) and "/" in value:
        scheme, mark, rest = value.rpartition("://")
        return scheme + mark + re.sub(r"[^/?&=]*/", "", rest)
    return value
