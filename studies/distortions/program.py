"""`make distortions`: one set of trials, changed in one nuisance at a time.

Writes distortions.json, of which docs/hard-cases.md shows a part. A row that was measured before is
taken from DIR/rows, unless --again says otherwise.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from holdfast.cli.command import path_argument
from holdfast.cli.options import (
    add_job_options,
    chosen_model,
    chosen_workers,
)
from holdfast.core.contract import Json
from holdfast.core.errors import UsageError
from holdfast.core.writing import require_writable, write_whole
from holdfast.edge_runtime.engine import ModelChoice
from holdfast.evaluation.jobs import Workers
from holdfast.simulation.closed_loop import model_of
from holdfast.simulation.scene_file import read_scene_file
from holdfast.training.progress import Stages
from studies.distortions.closed_loop import (
    CONTROLLER,
    NOT_RUN,
    closed_figures,
    closed_outcomes,
    loop_run,
)
from studies.distortions.open_loop import OpenJob, OpenOutcomes, open_figures
from studies.distortions.quiet_hand import QuietJob, quiet_rows
from studies.distortions.table import DISTORTIONS, TRIALS, UNCHANGED, Distortion
from studies.shared_control.closed_loop import LoopRuns
from tools.harness import add_engine_options, write_figures

MODEL = Path("models/holdfast-150hz.onnx")
LOCKED_SEED = 7001
"""Of the published figures: nothing is chosen on it (core/locked.toml)."""
TOGETHER = 4
"""Rows of the closed loop between two writings."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this study alone."""
    option = parser.add_argument
    option(
        "--model",
        type=path_argument,
        default=MODEL,
        metavar="FILE",
        help=f"default {MODEL}",
    )
    add_engine_options(parser)
    option(
        "--trials",
        type=int,
        metavar="N",
        help="trials of the set (default: all of its card)",
    )
    add_job_options(parser, 2)
    option("--only", nargs="+", metavar="NAME", help="rows by their names")
    option("--again", action="store_true", help="measure every row again")
    kept = "measure nothing: write the rows that are there, without a closed loop if it is missing"
    option("--kept", action="store_true", help=kept)
    # A published figure comes from a locked seed; 100 and the like are for development.
    parser.set_defaults(seed=LOCKED_SEED)


def run(args: argparse.Namespace) -> int:
    """Run the study, write its figures."""
    require_writable(args.out)
    started = time.monotonic()
    wanted = _chosen(args.only)
    model = chosen_model(args)
    study = Study(model, chosen_workers(args), args.out, args.trials, args.seed)
    if args.again:
        shutil.rmtree(study.rows_folder, ignore_errors=True)

    if args.kept:
        wanted = [one for one in wanted if study.has_open_loop(one)]
    rows = study.rows(wanted, measures=not args.kept)
    figures = {
        "kind": "simulated",
        "command": "make distortions",
        "model": study.model_id,
        "engine": args.engine,
        "seed": args.seed,
        "trials": args.trials,
        "card_sha256": study.card_sha256,
        "date": datetime.now(UTC).date().isoformat(),
        "commit": _commit(),
        "controller": CONTROLLER,
        # Rows that were kept took their time in other runs.
        "minutes": None if args.kept else (time.monotonic() - started) / 60.0,
        "rows": rows,
        "quiet": study.quiet(),
    }
    path = write_figures(args.out / "distortions.json", figures)
    sys.stdout.write(f"{path}\n")
    return 0


def _chosen(only: Sequence[str] | None) -> list[Distortion]:
    """The rows that --only leaves, and always the unchanged set."""
    if not only:
        return list(DISTORTIONS)
    names = [one.name for one in DISTORTIONS]
    for name in only:
        if name not in names:
            raise UsageError(
                f"no distortion {name!r:.40}",
                next_step=f"choose from {', '.join(names)}",
            )
    return [one for one in DISTORTIONS if one.name in (UNCHANGED, *only)]


def _commit() -> str:
    """The commit that the code is of, "" outside of a checkout; + where files were changed."""
    words = ["git", "describe", "--always", "--dirty=+", "--exclude=*"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    return done.stdout.strip()


class Study:
    """Rows of the study, each measured once and kept in a file.

    rows_folder: of the files of the rows. trials: None for all of the card.
    """

    def __init__(
        self,
        model: ModelChoice,
        workers: Workers,
        out: Path,
        trials: int | None,
        seed: int,
    ) -> None:
        self.model = model
        self.workers = workers
        self.trials = trials
        self.seed = seed
        self.model_id = model_of(model).card.model_id
        self.rows_folder = out / "rows"
        self.cards_folder = out / "cards"
        self.rows_folder.mkdir(parents=True, exist_ok=True)
        self.cards_folder.mkdir(parents=True, exist_ok=True)
        self.card_sha256 = read_scene_file(str(TRIALS)).sha256
        # A row of another model, set or seed is no row of this study.
        self._key = {
            "card": self.card_sha256,
            "model": self.model_id,
            "engine": model.engine,
            "trials": trials,
            "seed": seed,
        }

    def has_open_loop(self, one: Distortion) -> bool:
        """Whether the open-loop part of a row is there."""
        return self._read(one, "open") is not None

    def rows(
        self, wanted: Sequence[Distortion], *, measures: bool = True
    ) -> list[Json]:
        """The rows in their order. measures: run what is missing; else it has no figures."""
        open_loop = self._open_loop(wanted)
        closed = self._closed_loop(wanted if measures else [])
        if not measures:
            for one in wanted:
                closed[one.name] = self._read(one, "closed") or NOT_RUN
        unchanged = open_loop[UNCHANGED]
        saved = closed[UNCHANGED]
        rows = []
        for one in wanted:
            figures = open_figures(open_loop[one.name], unchanged)
            of_loop = closed_figures(closed[one.name], saved)
            about = {"name": one.name, "words": one.words, "group": one.group}
            rows.append({**about, **figures, **of_loop})
        return rows

    def quiet(self) -> list[Json]:
        """The rows of the quiet hand."""
        kept = self._read_file(self.rows_folder / "quiet.json")
        figures: list[Json] = []
        if kept is not None:
            figures = kept["rows"]
            return figures
        jobs = [QuietJob(self.model, row, self.seed) for row in quiet_rows()]
        progress = Stages()
        progress("quiet hands, a minute each")
        for number, one in enumerate(self.workers.run(jobs), 1):
            figures.append(one)
            progress.part(number / len(jobs))
        self._write_file(self.rows_folder / "quiet.json", {"rows": figures})
        return figures

    def _open_loop(self, wanted: Sequence[Distortion]) -> dict[str, OpenOutcomes]:
        outcomes = {}
        jobs = []
        for one in wanted:
            kept = self._read(one, "open")
            if kept is not None:
                outcomes[one.name] = OpenOutcomes(**kept)
                continue
            card = one.card(self.cards_folder)
            jobs.append(OpenJob(self.model, one.name, card, self.trials, self.seed))

        progress = Stages()
        progress("trials distorted")
        results = self.workers.run(jobs)
        for number, (job, result) in enumerate(zip(jobs, results, strict=True), 1):
            outcomes[job.name] = result
            self._write(job.name, "open", vars(result))
            progress.part(number / len(jobs))
        return outcomes

    def _closed_loop(self, wanted: Sequence[Distortion]) -> dict[str, Json]:
        figures = {}
        missing = []
        for one in wanted:
            kept = self._read(one, "closed")
            if kept is not None:
                figures[one.name] = kept
            else:
                missing.append(one)

        progress = Stages()
        progress("closed loops (simulated)")
        runs = LoopRuns(self.model, self.workers, lambda share: None)
        for start in range(0, len(missing), TOGETHER):
            some = missing[start : start + TOGETHER]
            wanted_runs = []
            for one in some:
                card = one.card(self.cards_folder)
                wanted_runs.append(loop_run(one, card, self.trials, self.seed))
            runs.run(wanted_runs)
            for one, run_of in zip(some, wanted_runs, strict=True):
                figures[one.name] = closed_outcomes(runs, run_of)
                self._write(one.name, "closed", figures[one.name])
            progress.part((start + len(some)) / len(missing))
        return figures

    def _read(self, one: Distortion, part: str) -> Json | None:
        """What was kept of a row; None where it is of another study, or was never measured."""
        return self._read_file(self.rows_folder / f"{one.name}.{part}.json")

    def _write(self, name: str, part: str, figures: Json) -> None:
        self._write_file(self.rows_folder / f"{name}.{part}.json", figures)

    def _read_file(self, path: Path) -> Json | None:
        if not path.is_file():
            return None
        kept = json.loads(path.read_text("utf-8"))
        if kept["key"] != self._key:
            return None
        figures: Json = kept["figures"]
        return figures

    def _write_file(self, path: Path, figures: Json) -> None:
        content = {"key": self._key, "figures": figures}
        write_whole(path, json.dumps(content) + "\n")
