"""`holdfast evaluate MODEL --data SET ..`: runs a model file on labelled sets and scores it."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from holdfast.cli.command import (
    add_json_option,
    path_argument,
    positive,
    require_json_writable,
    seed,
    show_found,
)
from holdfast.cli.options import (
    add_engine_options,
    add_job_options,
    chosen_model,
    chosen_workers,
)
from holdfast.core.reading import Json
from holdfast.core.writing import require_writable
from holdfast.evaluation import MOST_FALSE_PER_MIN

if TYPE_CHECKING:
    from holdfast.evaluation.camera import CameraFigures
    from holdfast.evaluation.evaluate import EvaluationRequest
    from holdfast.evaluation.figures import Evaluation
    from holdfast.evaluation.methods import MethodFigures
    from holdfast.evaluation.window_scores import WindowFigures
    from holdfast.training.figures import HeadFigures
    from holdfast.training.progress import Stages


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    option("model", metavar="MODEL", help="a sealed holdfast.onnx")
    add_engine_options(parser)
    sets = "labelled sets, by name or path"
    option("--data", required=True, nargs="+", metavar="SET|FOLDER", help=sets)
    choose = (
        "other sets, to choose the threshold of p(risky) on (default: the deployed one)"
    )
    option("--choose", nargs="+", default=(), metavar="SET|FOLDER", help=choose)
    most = f"false alarms a minute allowed on --choose (default {MOST_FALSE_PER_MIN})"
    option(
        "--false-per-min",
        type=positive,
        default=MOST_FALSE_PER_MIN,
        metavar="N",
        help=most,
    )
    train = "training set for the thesis' forest, which is then a baseline"
    option("--train", metavar="FOLDER", help=train)
    real = "results of `make real`, for the report"
    option("--real", type=path_argument, metavar="DIR", help=real)
    add_job_options(parser, 1)
    option("--groups", type=int, metavar="K", help="use only K people (or blocks)")
    seeds = "seed of the intervals and of the choice of groups (default 0)"
    option("--seed", type=seed, default=0, metavar="S", help=seeds)
    add_json_option(parser)
    report = "write a report with pictures to this file (HTML)"
    option("--report", type=path_argument, metavar="OUT", help=report)


def run(args: argparse.Namespace) -> int:
    """Evaluate, print the figures in words, write them as JSON and as a report."""
    from holdfast.training.progress import stages

    require_json_writable(args)
    if args.report is not None:
        require_writable(args.report.parent)
    request = _request(args)
    extra = 1 + (args.real is not None) + (args.report is not None)
    with stages(request.n_stages() + extra) as say:
        say("loading the libraries and the model")
        evaluation, figures = _evaluated(args, request, say)
    show_found(args, "\n".join(in_words(evaluation)), figures)
    return 0


def _request(args: argparse.Namespace) -> EvaluationRequest:
    from holdfast.evaluation.evaluate import EvaluationRequest

    return EvaluationRequest(
        tuple(args.data),
        tuple(args.choose),
        args.train,
        args.groups,
        most_false_per_min=args.false_per_min,
        seed=args.seed,
    )


def _evaluated(
    args: argparse.Namespace, request: EvaluationRequest, say: Stages
) -> tuple[Evaluation, Json]:
    """The evaluation and its figures, once the report is written."""
    from holdfast.evaluation.evaluate import evaluate_events
    from holdfast.evaluation.real_sets import real_figures

    model, workers = chosen_model(args), chosen_workers(args)
    evaluation = evaluate_events(model, request, say, say.part, workers)
    figures, real = evaluation.to_json(), None
    if args.real is not None:
        say("real recordings")
        real = real_figures(args.real, args.seed)
        figures["real"] = real.to_json()
    if args.report is not None:
        from holdfast.evaluation.report import write_event_report

        say("drawing the report")
        write_event_report(args.report, evaluation, real)
    return evaluation, figures


def in_words(of: Evaluation) -> list[str]:
    """The figures as lines for people, with the caveats that belong to them."""
    from holdfast.evaluation.camera import onsets_in_words
    from holdfast.evaluation.formats import display_name

    lines = [
        line for one in of.sets.values() for line in _windows_in_words(one.windows)
    ]
    headline = of.thresholds.headline
    rows = {name: one.rows[headline] for name, one in of.sets.items()}
    if len(rows) > 1:
        rows["all sets"] = of.rows[headline]
    for name, row in rows.items():
        lines += [
            _events_in_words(f"{name}, {display_name(headline)}", row),
            *_camera_in_words(name, row.camera),
        ]
    lines += [
        f"{name}: {words}"
        for name, one in of.sets.items()
        if (words := onsets_in_words(one.card.onsets_by))
    ]
    return [*lines, f"threshold: {of.thresholds.how()}"]


def _events_in_words(name: str, row: MethodFigures) -> str:
    if not row.events:
        return f"{name}: no risky event; {row.false_alarms} false alarms in {row.minutes:.1f} min"
    delay = row.delay_ms
    when = f", act {delay.p50:.0f} ms after load onset (median)" if delay else ""
    return (
        f"{name}: recall {row.found} of {row.events} risky events{when}; "
        f"{row.false_per_min:.2f} false alarms a minute in {row.minutes:.1f} min"
    )


def _camera_in_words(name: str, of: CameraFigures | None) -> list[str]:
    """Alarms against a camera's slips and against the scene's truth; nothing without a camera."""
    if of is None:
        return []
    if of.delay_ms is None or of.lead_ms is None or of.start_sd_ms is None:
        return [f"{name}, by the camera: {of.onsets} onsets, recall 0"]
    lines = [
        f"{name}, by the camera: recall {of.found} of {of.events} events; act "
        f"{of.delay_ms.p50:+.0f} ms from its onset (sd {of.start_sd_ms.p50:.1f} ms), "
        f"{of.lead_ms.p50:+.0f} ms left to its gross slip (medians)"
    ]
    truth = of.truth
    if truth is None:
        return [*lines, f"{name}: the truth of these events is not known"]
    times = (truth.delay_ms, truth.lead_ms, truth.start_off_ms, truth.gross_off_ms)
    delay, lead, start, gross = (
        "not known" if one is None else f"{one.p50:+.0f} ms" for one in times
    )
    return [
        *lines,
        f"{name}, by the scene's truth: act {delay} from the first sliding, "
        f"{lead} left to gross slip; the camera's times are {start} and {gross} from these",
    ]


def _windows_in_words(figures: WindowFigures) -> list[str]:
    from holdfast.training.figures import situation_lines, with_interval

    heads, head = figures.heads, figures.heads.predict_250ms
    lines = [
        f"{figures.data} ({figures.kind}): {_trials_in_words(heads)}",
        *situation_lines(heads.situations, heads.group_kind),
    ]
    if head is not None:
        kind, precision = (
            heads.group_kind,
            (head.average_precision, head.average_precision_ci),
        )
        lines += [
            f"0.25 s prediction: AUC          {with_interval(head.auc, head.auc_ci, kind)}",
            f"  average precision {with_interval(*precision, kind)}",
        ]
    return [*lines, *_warnings(figures), figures.caveat]


def _warnings(figures: WindowFigures) -> list[str]:
    """What makes the figures of a set better or worse than they look."""
    warnings = []
    if figures.unknown_windows:
        warnings.append(
            f"WARNING: the state is unknown at {figures.unknown_windows} windows (lost or "
            "unsettled sensors); they count as misses."
        )
    if figures.trained_on_recordings:
        warnings.append(
            f"WARNING: the model was trained on {figures.trained_on_recordings} of these "
            f"{figures.heads.n_trials} recordings; these figures flatter it. Held-out figures are "
            "in its card and in make real."
        )
    return warnings


def _trials_in_words(of: HeadFigures) -> str:
    from holdfast.training.figures import in_words

    trials = in_words(of.n_trials, "trial")
    return (
        trials
        if of.group_kind == "trial"
        else f"{trials}, {in_words(of.n_groups, of.group_kind)}"
    )
