"""`holdfast evaluate MODEL --data SET ..`: runs a model file on labelled sets and scores it."""

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
    option = parser.add_argument
    option("model", metavar="MODEL", help="a sealed holdfast.onnx")
    sets = "labelled sets, by name or path"
    option("--data", required=True, nargs="+", metavar="SET|FOLDER", help=sets)
    choose = "other sets, to choose the threshold of p(risky) on (default: the deployed one)"
    option("--choose", nargs="+", default=(), metavar="SET|FOLDER", help=choose)
    most = f"false alarms a minute allowed on --choose (default {MOST_FALSE_PER_MIN})"
    option("--false-per-min", type=positive, default=MOST_FALSE_PER_MIN, metavar="N", help=most)
    train = "training set for the thesis' forest, which is then a baseline"
    option("--train", metavar="FOLDER", help=train)
    real = "results of `make real`, for the report"
    option("--real", type=path_argument, metavar="DIR", help=real)
    option("--groups", type=int, metavar="K", help="use only K people (or blocks)")
    seeds = "seed of the intervals and of the choice of groups (default 0)"
    option("--seed", type=seed, default=0, metavar="S", help=seeds)
    option("--json", type=path_argument, metavar="OUT", help="write the figures to this file")
    report = "write a report with pictures to this file (HTML)"
    option("--report", type=path_argument, metavar="OUT", help=report)


def run(args: argparse.Namespace) -> int:
    """Evaluate, print the figures, write them as JSON and as a report."""
    from edge_runtime.monitor import Model
    from evaluation.evaluate import EvaluationRequest, evaluate_events
    from evaluation.real_sets import real_figures
    from training.progress import stages

    for out in (args.json, args.report):
        if out is not None:
            require_writable(out.parent)
    model = Model(args.model)
    request = EvaluationRequest(
        tuple(args.data),
        tuple(args.choose),
        args.train,
        args.groups,
        most_false_per_min=args.false_per_min,
        seed=args.seed,
    )
    long = args.report is not None or sys.stderr.isatty()
    with stages(3 * len(request.data) + 4) if long else nullcontext(lambda line: None) as say:
        evidence = evaluate_events(model, request, say)
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
    """The figures as lines for people, with their caveats."""
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
        false_alarms = f"{row['false_alarms']} false alarms"
        return f"{name}: no risky event; {false_alarms} in {row['minutes']:.1f} min"
    delay = ""
    if row["delay_ms"] is not None:
        delay = f", act {row['delay_ms']['p50']:.0f} ms after load onset (median)"
    return (
        f"{name}: recall {row['found']} of {row['events']} risky events{delay}; "
        f"{row['false_per_min']:.2f} false alarms a minute in {row['minutes']:.1f} min"
    )


def _camera_in_words(name: str, seen: dict[str, Any] | None) -> list[str]:
    """The alarm against the slip that a camera saw, and against the scene's truth, if there."""
    if seen is None:
        return []
    if not seen["found"]:
        return [f"{name}, by the camera: {seen['onsets']} onsets, recall 0"]
    delay, lead = (f"{seen[key]['p50']:+.0f} ms" for key in ("delay_ms", "lead_ms"))
    lines = [
        f"{name}, by the camera: recall {seen['found']} of {seen['events']} events; "
        f"act {delay} from its onset (sd {seen['start_sd_ms']['p50']:.1f} ms), "
        f"{lead} left to its gross slip (medians)"
    ]
    truth = seen["truth"]
    if truth is None:
        return [*lines, f"{name}: the truth of these events is not known"]
    delay, lead, start, gross = (
        "not known" if truth[key] is None else f"{truth[key]['p50']:+.0f} ms"
        for key in ("delay_ms", "lead_ms", "start_off_ms", "gross_off_ms")
    )
    return [
        *lines,
        f"{name}, by the scene's truth: act {delay} from the first sliding, "
        f"{lead} left to gross slip; the camera's times are {start} and {gross} from these",
    ]


def _set_in_words(figures: dict[str, Any]) -> list[str]:
    situations = figures["situations"]
    lines = [
        f"{figures['data']} ({figures['kind']}): "
        f"{figures['n_trials']} trials, {figures['n_groups']} groups",
        "macro F1 over four situations  "
        + _with_interval(situations["macro_f1"], situations["macro_f1_ci"]),
    ]
    lines += [
        f"  F1 {name:<12} {_with_interval(value, situations['f1_ci'][name])}"
        for name, value in situations["f1"].items()
    ]
    if "predict_250ms" in figures:
        head = figures["predict_250ms"]
        precision = _with_interval(head["average_precision"], head["average_precision_ci"])
        lines += [
            f"0.25 s prediction: AUC          {_with_interval(head['auc'], head['auc_ci'])}",
            f"  average precision {precision}",
        ]
    if figures["unknown_windows"]:
        lines.append(
            f"WARNING: the state is unknown at {figures['unknown_windows']} windows "
            "(lost or unsettled sensors); they count as misses."
        )
    if figures["trained_on_recordings"]:
        lines.append(
            f"WARNING: the model was trained on {figures['trained_on_recordings']} "
            f"of these {figures['n_trials']} recordings; these figures flatter it. "
            "Held-out figures are in its card and in make real."
        )
    return [*lines, figures["caveat"]]


def _with_interval(value: float | None, interval: list[float] | None) -> str:
    if value is None:
        return "not defined (the class is absent)"
    low_high = f"{interval[0]:.3f} to {interval[1]:.3f}" if interval else ""
    return f"{value:.3f}" + (f"  (95 % interval over groups {low_high})" if interval else "")
