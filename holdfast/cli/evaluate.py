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
from holdfast.core.writing import require_writable
from holdfast.evaluation import MOST_FALSE_PER_MIN

if TYPE_CHECKING:
    from holdfast.core.contract import Json
    from holdfast.evaluation.evaluate import EvaluationRequest
    from holdfast.evaluation.figures import Evaluation
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
    from holdfast.evaluation.evaluation_lines import evaluation_lines
    from holdfast.training.progress import stages

    require_json_writable(args)
    # A report that cannot be written is refused before the evaluation.
    if args.report is not None:
        require_writable(args.report.parent)

    request = _request(args)
    # Loading the libraries, and what this verb adds to the stages of the evaluation.
    extra = 1 + (args.real is not None) + (args.report is not None)
    with stages(request.n_stages() + extra) as begin:
        begin("loading the libraries and the model")
        evaluation, figures = _evaluated(args, request, begin)

    show_found(args, "\n".join(evaluation_lines(evaluation)), figures)
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
    args: argparse.Namespace, request: EvaluationRequest, begin: Stages
) -> tuple[Evaluation, Json]:
    """The evaluation and its figures, once the report is written."""
    from holdfast.evaluation.evaluate import evaluate_events
    from holdfast.evaluation.real_sets import real_figures

    model = chosen_model(args)
    workers = chosen_workers(args)
    evaluation = evaluate_events(model, request, begin, begin.part, workers)
    figures = evaluation.to_json()

    real = None
    if args.real is not None:
        begin("real recordings")
        real = real_figures(args.real, args.seed)
        figures["real"] = real.to_json()

    if args.report is not None:
        from holdfast.evaluation.report import write_event_report

        begin("drawing the report")
        write_event_report(args.report, evaluation, real)

    return evaluation, figures
