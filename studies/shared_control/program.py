"""`make loop`: what holding on costs; writes loop.json and the front figure, fills the page.

With scenes (`python -m studies loop SCENE..`) it compares controllers on these instead.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from holdfast.cli.command import path_argument, whole
from holdfast.cli.options import add_job_options, chosen_model, chosen_workers
from holdfast.core.contract import Json
from holdfast.core.errors import UsageError
from holdfast.core.locked import locked_sets
from holdfast.core.trial_layout import read_json
from holdfast.core.writing import require_writable, write_whole
from holdfast.simulation.closed_loop import model_of
from holdfast.simulation.drive import OPENINGS
from holdfast.training.progress import Stages
from studies.shared_control import comparison
from studies.shared_control.closed_loop import LoopRuns
from studies.shared_control.picture import picture
from studies.shared_control.plan import PARTS, SEED, Row, rows
from tools.doc_tables import fill, tables_of
from tools.harness import add_engine_options, for_any_page, measured_now, write_figures

TRIALS = 55
MODEL = Path("models/holdfast-150hz.onnx")
PAGE = "docs/shared-control.md"
ROW_KEYS = (
    "part",
    "set",
    "controller",
    "setting",
    "lag_ms",
    "opening",
    "delay_samples",
    "tremor_m_s2",
)
"""What a row measures: two runs have it once."""
FIGURE = Path("docs/shared-control.svg")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this study alone."""
    option = parser.add_argument
    # None: that of the study, or 0 with scenes.
    parser.set_defaults(seed=None)
    comparison.add_arguments(parser)
    option(
        "--model",
        type=path_argument,
        default=MODEL,
        metavar="FILE",
        help=f"default {MODEL}",
    )
    add_engine_options(parser)
    meanings = "; ".join(f"{name}: {text}" for name, text in OPENINGS.items())
    option(
        "--opening",
        choices=tuple(OPENINGS),
        default="wearer",
        help=f"{meanings} (default wearer)",
    )
    option(
        "--trials",
        type=whole(1),
        metavar="N",
        help=f"trials of a set (default {TRIALS}; of a scene: all)",
    )
    add_job_options(parser, 2)
    option(
        "--parts",
        nargs="+",
        metavar="PART",
        help=f"of {', '.join(PARTS)}",
    )
    option("--sets", nargs="+", metavar="SET", help="by their names in the tables")
    option(
        "--controllers", nargs="+", metavar="NAME", help="of the tables' first column"
    )
    option(
        "--keep",
        action="store_true",
        help="keep the rows of the earlier run in --out that this one does not measure",
    )
    option(
        "--page",
        action="store_true",
        help=f"fill the tables of {PAGE} and draw {FIGURE}",
    )


def run(args: argparse.Namespace) -> int:
    """Run the study, or the comparison on scenes; write the figures."""
    if args.scenes:
        return comparison.run(args)
    comparison.require_scenes(args)
    require_writable(args.out)
    seed = SEED if args.seed is None else args.seed
    trials = args.trials or TRIALS
    wanted = _chosen(rows(trials, seed), args)
    if args.opening != "wearer":
        wanted = [row.with_opening(args.opening) for row in wanted]
    progress = Stages()
    progress(f"{len(wanted)} rows in a closed loop (simulated)")
    runs = LoopRuns(chosen_model(args), chosen_workers(args), progress.part)
    runs.run([(row.one, row.request) for row in wanted])
    figures = {
        "kind": "simulated",
        "model": model_of(chosen_model(args)).card.model_id,
        "engine": args.engine,
        "seed": seed,
        "locked_on": _locked_on(seed),
        **measured_now(),
        "trials": trials,
        "rows": [_row(row, runs) for row in wanted],
    }
    if args.keep and (args.out / "loop.json").is_file():
        figures = merged(read_json(args.out / "loop.json"), figures)
    path = write_figures(args.out / "loop.json", figures)
    if args.page:
        fill(PAGE, tables_of(PAGE, {"loop": figures}))
    # not without --page: a run with other --parts, trials or seed must change no page
    if args.page and any(row.part == "front" for row in wanted):
        write_whole(FIGURE, for_any_page(picture(figures)) + "\n")
    sys.stdout.write(f"{path}\n")
    return 0


def merged(earlier: Json, figures: Json) -> Json:
    """The figures, with the rows of an earlier run that they do not have.

    Raises UsageError where both are not of one model and one seed.
    """
    for key in ("model", "seed"):
        if earlier[key] != figures[key]:
            raise UsageError(
                f"the earlier rows have {key} {earlier[key]}, these have {figures[key]}",
                next_step="give another --out, or leave --keep out",
            )

    def key_of(row: Json) -> tuple[object, ...]:
        return tuple(row[name] for name in ROW_KEYS)

    new = {key_of(row) for row in figures["rows"]}
    kept = [row for row in earlier["rows"] if key_of(row) not in new]
    both: Json = {"rows": [*kept, *figures["rows"]]}
    for key in ("command", "commit"):
        said = dict.fromkeys([earlier.get(key), figures.get(key)])
        both[key] = "; ".join(one for one in said if one)
    return {**figures, **both}


def _locked_on(seed: int) -> str | None:
    """The day since which the seed is locked, None for one that choices may see."""
    sets = locked_sets()
    for locked in sets.seeds:
        if locked.first <= seed <= locked.last:
            return str(sets.locked_on)
    return None


def _chosen(wanted: list[Row], args: argparse.Namespace) -> list[Row]:
    """The rows that the options leave. Raises UsageError where none is left."""
    left = [
        row
        for row in wanted
        if (not args.parts or row.part in args.parts)
        and (not args.sets or row.set_name in args.sets)
        and (not args.controllers or row.label in args.controllers)
    ]
    if not left:
        raise UsageError(
            "no row of the study is left by --parts, --sets and --controllers",
            next_step="leave one of them out",
        )
    return left


def _row(row: Row, runs: LoopRuns) -> Json:
    request = row.request
    return {
        "part": row.part,
        "set": row.set_name,
        "controller": row.label,
        "setting": request.setting,
        "lag_ms": request.lag_ms,
        "opening": request.opening,
        "delay_samples": request.delay_samples,
        "tremor_m_s2": row.one.tremor_m_s2,
        **runs.figures(row.one, request).to_json(),
    }
