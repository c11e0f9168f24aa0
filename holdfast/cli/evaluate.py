"""`holdfast evaluate MODEL --data SET ..`: runs a model file on labelled sets and scores it."""

from __future__ import annotations

import argparse

from holdfast.cli.command import (
    add_json_option,
    add_report_option,
    add_seed_option,
    positive,
    show_found,
)
from holdfast.cli.options import (
    add_engine_option,
    add_job_options,
    chosen_model,
    chosen_workers,
)
from holdfast.evaluation import MOST_FALSE_PER_MIN


def add_evaluate_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    option("model", metavar="MODEL", help="a sealed holdfast.onnx")
    add_engine_option(parser)
    option(
        "--data",
        required=True,
        nargs="+",
        metavar="SET|FOLDER",
        help="labelled sets, by name or path",
    )
    option(
        "--choose",
        nargs="+",
        default=(),
        metavar="SET|FOLDER",
        help="other sets, to choose the threshold of p(risky) on (default: the deployed one)",
    )
    option(
        "--false-per-min",
        type=positive,
        default=MOST_FALSE_PER_MIN,
        metavar="N",
        help=f"false alarms a minute allowed on --choose (default {MOST_FALSE_PER_MIN})",
    )
    option(
        "--train",
        metavar="FOLDER",
        help="training set for the thesis' forest, which is then a baseline",
    )
    add_job_options(parser, 1)
    add_seed_option(parser, "the intervals")
    add_json_option(parser)
    add_report_option(parser, "the answer, with pictures")


def run_evaluate(args: argparse.Namespace) -> int:
    """Evaluate, print the figures in words, write them as JSON and as a report."""
    from holdfast.core.progress import Stages
    from holdfast.evaluation.evaluate import EvaluationRequest, evaluate_events
    from holdfast.evaluation.report import evaluation_lines, write_event_report

    request = EvaluationRequest(
        tuple(args.data),
        tuple(args.choose),
        args.train,
        most_false_per_min=args.false_per_min,
        seed=args.seed,
    )
    begin = Stages()
    begin("loading the libraries and the model")
    model, workers = chosen_model(args), chosen_workers(args)
    evaluation = evaluate_events(model, request, begin, begin.part, workers)
    if args.report is not None:
        begin("drawing the report")
        write_event_report(args.report, evaluation)

    show_found(args, "\n".join(evaluation_lines(evaluation)), evaluation.to_json())
    return 0
