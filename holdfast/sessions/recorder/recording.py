"""From the options of a run to a session: source, bias, camera, what is there, and meta.json."""

from __future__ import annotations

import hashlib
import platform
import re
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

from holdfast.core.contract import Json
from holdfast.core.errors import LabelError
from holdfast.core.hand_card import read_hand_card
from holdfast.core.schema import json_of, text_of
from holdfast.core.trial_layout import checked_name, mass_g
from holdfast.drivers.calibration import fields_of, read_calibration
from holdfast.drivers.hand import Hand
from holdfast.edge_runtime.wearer import IntentMonitor
from holdfast.live.hand_files import force_of
from holdfast.live.running import first_in_line
from holdfast.live.sources import LINES, STANDARD_INPUT, open_live
from holdfast.live.wearer import wearer_monitor
from holdfast.sessions.calibrate import MeasuredBias, measure_bias, require_good
from holdfast.sessions.recorder.folder import (
    RECORDING,
    keep_hand,
    opened,
    require_ours,
    trials_of,
)
from holdfast.sessions.recorder.labels import scene_truth_of
from holdfast.sessions.recorder.plan import Plan, RecordOptions, planned, require_keys
from holdfast.sessions.recorder.protocol import NOTHING
from holdfast.sessions.recorder.session import Display, RunContext, Session
from holdfast.sessions.set_source import read_set_trial

CHECK_S = 1.0
"""Time over which the bias is measured."""
KINDS = {
    "usb": "recorded",
    "i2c": "recorded",
    "virtual": "simulated",
    "sim": "simulated",
    **dict.fromkeys(LINES, "recorded"),
}


def record(options: RecordOptions, context: RunContext) -> int:
    """Check the options and record what is left; returns how many trials were kept.

    Raises a HoldfastError.
    """
    checked_name(options.person, "pseudonym")
    require_ours(options.out)
    # In this order, so that every mistake of the options is reported before anything opens.
    plan = planned(options)
    options.camera.require_usable()
    require_keys(options, plan, context.keys)
    _report_before(options, plan, context.display)
    return record_plan(options, plan, context)


def record_plan(options: RecordOptions, plan: Plan, context: RunContext) -> int:
    """Open the source and record the trials of a plan; returns how many were kept.

    options: checked. Raises a HoldfastError.
    """
    clock = context.clock
    report = context.display.report
    card = None if options.hand is None else read_hand_card(options.hand)
    report(f"opening {options.source}")
    source = open_live(
        options.source,
        clock=clock,
        report=report,
        to_force=force_of(options.calibration),
        read_set=read_set_trial,
    )
    # The folder is locked for the whole run: a second recorder would mix trial numbers.
    folder = opened(options.out, source.unit, kind_of(options.source))
    monitor: AbstractContextManager[IntentMonitor | None] = nullcontext()
    if options.intent is not None:
        monitor = wearer_monitor(options.intent, clock, report)

    with (
        closing(source),
        folder,
        monitor as intent,
        first_in_line(report) as has_priority,
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
            "versions": _versions(),
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
        )
        return session.run(plan.tasks)


def kind_of(url: str) -> str:
    """What trials from a source are: recorded, simulated or replayed."""
    if url == STANDARD_INPUT:
        return "recorded"
    scheme, mark, _ = url.partition("://")
    return KINDS.get(scheme if mark else "", "replayed")


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
    # Flat, as the user typed them.
    values |= values.pop("camera")
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


def _versions() -> dict[str, str]:
    return {
        "holdfast": version("holdfast"),
        "numpy": version("numpy"),
        "python": platform.python_version(),
        "machine": platform.machine(),
    }


def _without_folders(value: Any) -> Any:
    """A path, or a URL with paths, without the folders."""
    if isinstance(value, Path):
        return value.name
    if isinstance(value, str) and "/" in value:
        scheme, mark, rest = value.rpartition("://")
        return scheme + mark + re.sub(r"[^/?&=]*/", "", rest)
    return value
