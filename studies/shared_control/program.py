"""`make loop`: what holding on costs; writes loop.json and the front figure, fills the page.

With scenes (`python -m studies loop SCENE..`) it compares controllers on these instead.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from benchmarks.paired import paired_change
from holdfast.cli.command import path_argument, show, whole
from holdfast.cli.options import add_job_options, chosen_model, chosen_workers
from holdfast.core.contract import Json
from holdfast.core.errors import UsageError
from holdfast.core.locked import locked_sets
from holdfast.core.progress import Stages
from holdfast.core.trial_layout import read_json
from holdfast.core.writing import require_writable, write_whole
from holdfast.simulation.loop.closed_loop import model_of
from holdfast.simulation.loop.drive import OPENINGS
from studies.shared_control import comparison
from studies.shared_control.closed_loop import ORACLE, LoopRequest, LoopRuns, Run
from studies.shared_control.closing import closing_figures
from studies.shared_control.picture import knowing, picture
from studies.shared_control.plan import LATE_S, OURS, PARTS, SEED, UNSEEN, Row, rows
from tools.doc_tables import fill, tables_of
from tools.harness import add_engine_options, for_any_page, measured_now, write_figures

TRIALS = 55
OPEN_SEED = 100
"""The first of those to choose by."""
MODEL = Path("models/holdfast-150hz.onnx")
PAGE = "docs/shared-control-figures.md"
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
KNOWING = "knowing.svg"
"""Of the part `knowing`, beside the JSON."""


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
        "--before",
        type=path_argument,
        metavar="JSON",
        help="loop.json of the code before, on the same trials: for aims that bound a change",
    )
    option(
        "--closing",
        type=whole(1),
        metavar="N",
        help="only this, into closing.json: N draws of hands that only close",
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
    if args.closing:
        return _closing(args)
    seed = SEED if args.seed is None else args.seed
    trials = args.trials or TRIALS
    before = _before(args.before, seed, trials) if args.before else {}
    wanted = _chosen(_open_rows(trials, seed, args), args)
    if args.opening != "wearer":
        wanted = [row.with_opening(args.opening) for row in wanted]
    progress = Stages()
    progress(f"{len(wanted)} rows in a closed loop (simulated)")
    runs = LoopRuns(chosen_model(args), chosen_workers(args), progress.part)
    runs.run([run for row in wanted for run in (row.run, *_late(row))])
    figures = {
        "kind": "simulated",
        "model": model_of(chosen_model(args)).card.model_id,
        "engine": args.engine,
        "seed": seed,
        "locked_on": _locked_on(seed),
        **measured_now(),
        "trials": trials,
        "rows": [_row(row, runs) for row in wanted],
        **before,
    }
    if args.keep and (args.out / "loop.json").is_file():
        figures = merged(read_json(args.out / "loop.json"), figures)
    path = write_figures(args.out / "loop.json", figures)
    draw(args, {row.part for row in wanted}, figures)
    sys.stdout.write(f"{path}\n")
    return 0


def draw(args: argparse.Namespace, parts: set[str], figures: Json) -> None:
    """Fill the page, and draw the pictures of the parts that were run."""
    if args.page:
        fill(PAGE, tables_of(PAGE, {"loop": figures}))
    # not without --page: a run with other --parts, trials or seed must change no page
    if args.page and "front" in parts:
        write_whole(FIGURE, for_any_page(picture(figures)) + "\n")
    if "knowing" in parts:
        write_whole(args.out / KNOWING, for_any_page(knowing(figures)) + "\n")


def _closing(args: argparse.Namespace) -> int:
    """Hands that only close, at development seeds unless another one is given."""
    model = model_of(chosen_model(args))
    seed = OPEN_SEED if args.seed is None else args.seed
    figures = closing_figures(seed, args.closing, model)
    figures = {"model": model.card.model_id, **measured_now(), **figures}
    path = write_figures(args.out / "closing.json", figures)
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
    locked = locked_sets().lock_of_seed(seed)
    return str(locked.locked_on) if locked is not None else None


def _before(path: Path, seed: int, trials: int) -> Json:
    """Our rows of an earlier version. Raises UsageError where its trials are other ones."""
    earlier = read_json(path)
    if (earlier["seed"], earlier["trials"]) != (seed, trials):
        raise UsageError(
            f"{path.name} has seed {earlier['seed']} and {earlier['trials']} trials a set, "
            f"this run {seed} and {trials}",
            next_step="run the code before on the same trials",
        )
    rows = [row for row in earlier["rows"] if row["controller"] == OURS]
    return {"before": [row for row in rows if row["part"] == "table"]}


def _open_rows(trials: int, seed: int, args: argparse.Namespace) -> list[Row]:
    """The rows of the study; without the styles that no choice may see, unless the seed is locked.

    Raises UsageError where --sets names one of them.
    """
    wanted = rows(trials, seed)
    if locked_sets().lock_of_seed(seed) is not None:
        return wanted
    named = [name for name in args.sets or () if name in UNSEEN]
    if named:
        raise UsageError(
            f"{named[0]} is a style that no choice may see, and seed {seed} is not locked",
            next_step="choose on other sets; such a style runs in reports, at a locked seed",
        )
    show(f"{', '.join(UNSEEN)} are left out: no choice may see them (seed {seed})")
    return [row for row in wanted if row.set_name not in UNSEEN]


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
        "knows_after_ms": _knows_after_ms(request),
        "tremor_m_s2": row.one.tremor_m_s2,
        **runs.figures(row.one, request).to_json(),
        **_beside_late(row, runs),
    }


def _knows_after_ms(request: LoopRequest) -> float | None:
    """How long after load onset an oracle knows; None for a hand that has to feel it."""
    return 1e3 * request.knows_after_s if request.name == ORACLE else None


def _beside_late(row: Row, runs: LoopRuns) -> Json:
    """Saved of the preventable drops, less what an oracle saves that knows LATE_S after load onset.

    Paired, drop by drop, with a 95 % interval; only in the part that has this oracle.
    """
    if not _late(row):
        return {}
    saved: list[dict[str, bool]] = []
    fresh: dict[str, bool] = {}
    for run in (row.run, *_late(row)):
        drops = [one for one in runs.runs(*run) if one.preventable]
        kept = {str(one.bare.trial.number): not one.held.dropped for one in drops}
        saved.append(kept)
        if run == row.run:
            # what an earlier tightening saved is no merit of the answer
            numbers = [
                str(d.bare.trial.number) for d in drops if not d.tightened_before
            ]
            fresh = {number: kept[number] for number in numbers}
    change, interval = paired_change(*saved)
    change_fresh, interval_fresh = paired_change(fresh, saved[1])
    return {
        "saved_beside_late": change,
        "saved_beside_late_ci": interval,
        "fresh_beside_late": change_fresh,
        "fresh_beside_late_ci": interval_fresh,
    }


def _late(row: Row) -> list[Run]:
    """What a row of the table is measured against: an oracle that knows LATE_S after load onset."""
    if row.part != "table":
        return []
    late = LoopRequest(ORACLE, lag_ms=row.request.lag_ms, knows_after_s=LATE_S)
    return [(row.one, late)]
