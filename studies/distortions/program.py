"""`make distortions`: one set of trials, changed in one nuisance at a time.

Writes distortions.json, of which docs/hard-cases.md shows a part. Rows are kept in DIR/rows, so
that a run that was stopped goes on; without that folder all are measured again.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from holdfast.cli.command import path_argument
from holdfast.cli.options import add_job_options, chosen_model, chosen_workers
from holdfast.core.contract import Json
from holdfast.core.progress import Stages
from holdfast.core.writing import require_writable, write_whole
from holdfast.edge_runtime.engine import ModelChoice
from holdfast.evaluation.jobs import Workers
from holdfast.simulation.loop.closed_loop import model_of
from holdfast.simulation.scenes.scene_file import read_scene_file
from studies.distortions.closed_loop import (
    CONTROLLER,
    closed_figures,
    closed_outcomes,
    loop_run,
)
from studies.distortions.open_loop import OpenJob, OpenOutcomes, open_figures
from studies.distortions.quiet_hand import QuietJob, quiet_rows
from studies.distortions.table import DISTORTIONS, TRIALS, UNCHANGED, Distortion
from studies.shared_control.closed_loop import LoopRuns
from tools.harness import add_engine_options, measured_now, write_figures

MODEL = Path("models/holdfast-150hz.onnx")
LOCKED_SEED = 7001
"""Of the published figures: nothing is chosen on it (core/locked.toml)."""
TOGETHER = 4
"""Rows of the closed loop between two writings."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this study alone."""
    option = parser.add_argument
    model = f"default {MODEL}"
    option("--model", type=path_argument, default=MODEL, metavar="FILE", help=model)
    add_engine_options(parser)
    trials = "trials of the set (default: all of its card)"
    option("--trials", type=int, metavar="N", help=trials)
    add_job_options(parser, 2)
    names = [one.name for one in DISTORTIONS]
    only = "these rows alone, and always the unchanged set"
    option("--only", nargs="+", metavar="NAME", choices=names, help=only)
    # A published figure comes from a locked seed; 100 and the like are for development.
    parser.set_defaults(seed=LOCKED_SEED)


def run(args: argparse.Namespace) -> int:
    """Run the study, write its figures."""
    require_writable(args.out)
    model = chosen_model(args)
    study = Study(model, chosen_workers(args), args.out, args.trials, args.seed)
    chosen = list(DISTORTIONS)
    if args.only:
        chosen = [one for one in chosen if one.name in (UNCHANGED, *args.only)]
    figures = {
        "kind": "simulated",
        **measured_now(),
        **study.key,
        "controller": CONTROLLER,
        "rows": study.rows(chosen),
        "quiet": study.quiet(),
    }
    path = write_figures(args.out / "distortions.json", figures)
    sys.stdout.write(f"{path}\n")
    return 0


class Study:
    """Rows of the study, each measured once and kept in a file.

    trials: None for all of the card. key: what a kept row must be of.
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
        self._rows_folder = out / "rows"
        self._cards_folder = out / "cards"
        self._rows_folder.mkdir(parents=True, exist_ok=True)
        self._cards_folder.mkdir(parents=True, exist_ok=True)
        self.key = {
            "model": model_of(model).card.model_id,
            "engine": model.engine,
            "seed": seed,
            "trials": trials,
            "card_sha256": read_scene_file(str(TRIALS)).sha256,
        }

    def rows(self, chosen: Sequence[Distortion]) -> list[Json]:
        """The rows in their order."""
        self._measure_open_loops(chosen)
        self._measure_closed_loops(chosen)
        unchanged = OpenOutcomes(**self._kept(UNCHANGED, "open"))
        saved = self._kept(UNCHANGED, "closed")
        rows = []
        for one in chosen:
            outcomes = OpenOutcomes(**self._kept(one.name, "open"))
            figures = open_figures(outcomes, unchanged)
            of_loop = closed_figures(self._kept(one.name, "closed"), saved)
            about = {"name": one.name, "words": one.words, "group": one.group}
            rows.append({**about, **figures, **of_loop})
        return rows

    def quiet(self) -> list[Json]:
        """The rows of the quiet hand."""
        kept = self._kept("quiet", "hand")
        if kept is None:
            jobs = [QuietJob(self.model, row, self.seed) for row in quiet_rows()]
            rows: list[Json] = []
            progress = Stages()
            progress("quiet hands, a minute each")
            for number, one in enumerate(self.workers.run(jobs), 1):
                rows.append(one)
                progress.part(number / len(jobs))
            self._keep("quiet", "hand", rows)
            return rows
        return list(kept)

    def _measure_open_loops(self, chosen: Sequence[Distortion]) -> None:
        jobs = []
        for one in chosen:
            if self._kept(one.name, "open") is None:
                card = one.card(self._cards_folder)
                jobs.append(OpenJob(self.model, one.name, card, self.trials, self.seed))

        progress = Stages()
        progress("trials distorted")
        results = self.workers.run(jobs)
        for number, (job, result) in enumerate(zip(jobs, results, strict=True), 1):
            self._keep(job.name, "open", vars(result))
            progress.part(number / len(jobs))

    def _measure_closed_loops(self, chosen: Sequence[Distortion]) -> None:
        missing = [one for one in chosen if self._kept(one.name, "closed") is None]
        progress = Stages()
        progress("closed loops (simulated)")
        runs = LoopRuns(self.model, self.workers, lambda share: None)
        for start in range(0, len(missing), TOGETHER):
            some = {}
            for one in missing[start : start + TOGETHER]:
                card = one.card(self._cards_folder)
                some[one.name] = loop_run(one, card, self.trials, self.seed)
            runs.run(list(some.values()))
            for name, request in some.items():
                self._keep(name, "closed", closed_outcomes(runs, request))
            progress.part((start + len(some)) / len(missing))

    def _kept(self, name: str, part: str) -> Any:
        """What was kept of a row; None where it is of another study, or was never measured."""
        path = self._rows_folder / f"{name}.{part}.json"
        if not path.is_file():
            return None
        kept = json.loads(path.read_text("utf-8"))
        return kept["figures"] if kept["key"] == self.key else None

    def _keep(self, name: str, part: str, figures: Any) -> None:
        text = json.dumps({"key": self.key, "figures": figures}) + "\n"
        write_whole(self._rows_folder / f"{name}.{part}.json", text)
