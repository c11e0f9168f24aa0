"""`holdfast evaluate MODEL --data SET ..`: the file itself answers labelled sets, sample by sample,
and is scored."""

from __future__ import annotations

import argparse
import json
import sys
from contextlib import nullcontext
from typing import Any

from edge_runtime.command import path_argument, positive, seed, show
from edge_runtime.writing import require_writable, write_whole
from evaluation import MOST_FALSE_PER_MIN


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    parser.add_argument("model", metavar="MODEL", help="a sealed holdfast.onnx")
    parser.add_argument(
        "--data",
        required=True,
        nargs="+",
        metavar="SET|FOLDER",
        help="labelled sets by name or path",
    )
    parser.add_argument(
        "--choose",
        nargs="+",
        default=(),
        metavar="SET|FOLDER",
        help="other streams, to choose the confidence on (default: as deployed)",
    )
    parser.add_argument(
        "--false-per-min",
        type=positive,
        default=MOST_FALSE_PER_MIN,
        metavar="N",
        help=f"false alarms a minute allowed there (default {MOST_FALSE_PER_MIN})",
    )
    parser.add_argument(
        "--train", metavar="FOLDER", help="what the thesis' forest is trained on, to stand beside"
    )
    parser.add_argument(
        "--real", type=path_argument, metavar="DIR", help="what `make real` left, for the report"
    )
    parser.add_argument("--groups", type=int, metavar="K", help="use K people (or blocks) only")
    parser.add_argument(
        "--seed",
        type=seed,
        default=0,
        metavar="S",
        help="of the intervals and the choice of groups",
    )
    parser.add_argument("--json", type=path_argument, metavar="OUT", help="write the figures here")
    parser.add_argument(
        "--report", type=path_argument, metavar="OUT", help="write a report for people here (HTML)"
    )


def run(args: argparse.Namespace) -> int:
    """Evaluate, print the figures in words, write them as JSON and as a report."""
    from edge_runtime.monitor import Model
    from evaluation.evaluate import EvaluationRequest, evaluate_events
    from evaluation.real_sets import real_figures
    from training.progress import stages

    for out in (args.json, args.report):
        if out is not None:
            require_writable(out.parent)
    model = Model(args.model)
    asked = EvaluationRequest(
        tuple(args.data),
        tuple(args.choose),
        args.train,
        args.groups,
        most_false_per_min=args.false_per_min,
        seed=args.seed,
    )
    long = args.report is not None or sys.stderr.isatty()
    with stages(3 * len(asked.data) + 4) if long else nullcontext(lambda line: None) as say:
        evidence = evaluate_events(model, asked, say)
        if args.real is not None:
            say("real recordings")
            evidence.figures["real"] = real_figures(args.real, args.seed)
    figures = evidence.figures
    if args.json is not None:
        write_whole(args.json, json.dumps(figures, indent=1, allow_nan=False) + "\n")
    if args.report is not None:
        from evaluation.report import write_event_report

        write_event_report(args.report, evidence)
    show("\n".join(in_words(figures)))
    return 0


def in_words(figures: dict[str, Any]) -> list[str]:
    """The figures as lines for people, with what must stand beside them."""
    from evaluation.camera import onsets_in_words

    lines = [line for one in figures["sets"].values() for line in _set_in_words(one["windows"])]
    headline = figures["thresholds"]["headline"]
    rows = {name: one["rows"][headline] for name, one in figures["sets"].items()}
    if len(rows) > 1:
        rows["all"] = figures["all"]["rows"][headline]
    for name, row in rows.items():
        lines += [
            _events_in_words(f"{name}, {headline}", row),
            *_camera_in_words(name, row["camera"]),
        ]
    lines += [
        f"{name}: {words}"
        for name, one in figures["sets"].items()
        if (words := onsets_in_words(one["data"]))
    ]
    return [*lines, f"threshold: {figures['thresholds']['how']}"]


def _events_in_words(name: str, row: dict[str, Any]) -> str:
    if not row["events"]:
        return f"{name}: no risky event; {row['false_alarms']} false alarms in {row['minutes']:.1f} min"
    delay = (
        ""
        if row["delay_ms"] is None
        else f", act {row['delay_ms']['p50']:.0f} ms after load onset (median)"
    )
    return (
        f"{name}: {row['found']} of {row['events']} risky events found{delay}; "
        f"{row['false_per_min']:.2f} false alarms a minute in {row['minutes']:.1f} min"
    )


def _camera_in_words(name: str, seen: dict[str, Any] | None) -> list[str]:
    """The alarm against the slip as a camera saw it, and beside it by the scene's truth; nothing
    without a camera."""
    if seen is None:
        return []
    if not seen["found"]:
        return [f"{name}, by the camera: {seen['onsets']} onsets, no event of them found"]
    delay, lead = (f"{seen[key]['p50']:+.0f} ms" for key in ("delay_ms", "lead_ms"))
    lines = [
        f"{name}, by the camera: {seen['found']} of {seen['events']} events found; act {delay} from its onset "
        f"(sd {seen['start_sd_ms']['p50']:.1f} ms), {lead} left to its gross slip (medians)"
    ]
    truth = seen["truth"]
    if truth is None:
        return [*lines, f"{name}: no scene knows the truth of these"]
    delay, lead, start, gross = (
        "not known" if truth[key] is None else f"{truth[key]['p50']:+.0f} ms"
        for key in ("delay_ms", "lead_ms", "start_off_ms", "gross_off_ms")
    )
    return [
        *lines,
        f"{name}, by the scene's truth: act {delay} from the first sliding, {lead} left to gross slip; "
        f"the camera's times are {start} and {gross} from these",
    ]


def _set_in_words(figures: dict[str, Any]) -> list[str]:
    situations = figures["situations"]
    lines = [
        f"{figures['data']} ({figures['kind']}): {figures['n_trials']} trials, {figures['n_groups']} groups",
        f"macro F1 over four situations  {_with_interval(situations['macro_f1'], situations['macro_f1_ci'])}",
    ]
    lines += [
        f"  F1 {name:<12} {_with_interval(value, situations['f1_ci'][name])}"
        for name, value in situations["f1"].items()
    ]
    if "predict_250ms" in figures:
        head = figures["predict_250ms"]
        lines.append(
            f"0.25 s prediction: AUC          {_with_interval(head['auc'], head['auc_ci'])}"
        )
        lines.append(
            f"  average precision {_with_interval(head['average_precision'], head['average_precision_ci'])}"
        )
    if figures["unknown_windows"]:
        lines.append(
            f"WARNING: the state is unknown at {figures['unknown_windows']} windows (lost or unsettled sensors); "
            "they count as misses."
        )
    if figures["trained_on_recordings"]:
        lines.append(
            f"WARNING: the model was trained on {figures['trained_on_recordings']} of these {figures['n_trials']} "
            "recordings; these figures flatter it. Held-out figures are in its card and in make real."
        )
    return [*lines, figures["caveat"]]


def _with_interval(value: float | None, interval: list[float] | None) -> str:
    if value is None:
        return "not defined (the class is absent)"
    return f"{value:.3f}" + (
        f"  (95 % interval over groups {interval[0]:.3f} to {interval[1]:.3f})" if interval else ""
    )
