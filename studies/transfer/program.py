"""`python -m studies transfer`: what the simulation is worth outside itself; transfer.json.

Seven parts: people (real-only and timing), scenes (models of scenes on people), spread (the same
with spread taxels, on half of the people), tugs (eflesh_slip), domain, statistics and traces. What
is measured is kept in DIR/parts, scene by scene, until card, trials, seed or plan change; a change
of the code does not show there (--fresh).
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from holdfast.cli.command import path_argument
from holdfast.cli.options import add_job_options, chosen_workers
from holdfast.core.errors import UsageError
from holdfast.core.reading import Json, model_path
from holdfast.core.writing import require_writable, write_whole
from holdfast.evaluation.formats import number
from holdfast.simulation.scene_file import read_scene_file
from holdfast.training.datasets import load
from holdfast.training.featurise import digest_of
from holdfast.training.progress import Say, stages
from holdfast.training.recording import DataSet
from studies.real.methods import OURS, PLACED
from studies.real.methods import OWN_LEVEL as OWN_LOAD
from studies.row_names import SPREAD_18
from studies.transfer import domain, people, statistics, traces, tugs
from studies.transfer.levels import at_level, levels
from studies.transfer.scene_sets import (
    COMPARED,
    DRAWN,
    IN_FIELD,
    IN_NEWTONS,
    ON_SPREAD,
    SEED,
    SHIPPED,
    TOLD_APART,
    TRAINED,
    SceneSet,
    card_text,
    read,
    simulated,
    there,
)
from studies.transfer.tables import EFLESH, PEOPLE, TAXELS
from tools.harness import write_figures

TRIALS = 300
"""A card."""
MODEL = Path("holdfast-150hz")
CAVEAT = (
    "Trained on simulation alone and scored on people: one set, one object, one pinch. 'Safe slip' "
    "is a voluntary release in scenes and an involuntary rotation of 5 to 15 degrees on people, so "
    "the macro F1 over four situations can never be that of a model trained on people."
)
FIXED = (
    "Fixed before this study and the same in every row of a table: learner, features and tasks "
    "(those of `make real`), own level, prediction horizon, seeds. Learner and features of "
    "`make real` were once chosen on these people; nothing was chosen on them here."
)


class _Run:
    """One run of the study: where it writes, what it keeps, and the sets that parts read."""

    def __init__(self, args: argparse.Namespace, say: Say) -> None:
        self.out: Path = args.out
        self.trials: int = args.trials
        self.model: Path = args.model
        self.seed: int = args.seed
        self.workers = chosen_workers(args)
        self.say = say
        self.seconds = 0.0

    def kept(self, name: str, make: Callable[[], Json], of: SceneSet | None) -> Json:
        """The figures of a piece of work: those that an equal run kept, else new, kept at once.

        of: the scenes that it depends on; None for real recordings alone.
        """
        path = self.out / "parts" / f"{name}.json"
        given = self.settings(of)
        kept: Json = {}
        if path.is_file():
            kept = json.loads(path.read_text("utf-8"))
        if kept.get("settings") != given:
            self.say(name)
            started = time.perf_counter()
            figures = make()
            seconds = round(time.perf_counter() - started, 1)
            kept = {"settings": given, "seconds": seconds, "figures": figures}
            write_whole(path, json.dumps(kept, indent=1, allow_nan=False) + "\n")
        self.seconds += kept["seconds"]
        figures = kept["figures"]
        return figures

    def of_scenes(
        self,
        part: str,
        sets: Sequence[SceneSet],
        make: Callable[[SceneSet, DataSet], list[Json]],
    ) -> list[Json]:
        """Rows of each of the scenes that are shipped, kept scene by scene."""
        rows = []
        for one in there(sets):

            def figures(one: SceneSet = one) -> Json:
                return {"rows": make(one, self.scenes(one))}

            name = f"{part}-{one.name.replace(', ', '-').replace(' ', '-')}"
            rows += self.kept(name, figures, one)["rows"]
        return rows

    def settings(self, of: SceneSet | None) -> Json:
        """What a kept piece depends on."""
        given: Json = {"seed": self.seed, "plan": people.PLAN.to_json()}
        if of is not None:
            given |= {"trials": self.trials, "scenes_seed": SEED}
            given["cards"] = digests(of)
        normal: Json = json.loads(json.dumps(given))
        return normal

    def scenes(self, of: SceneSet) -> DataSet:
        """A set of scenes, simulated if it is not there."""
        return read(simulated([of], self.trials, self.out)[0])

    def sides(self, of: SceneSet) -> list[list[int]]:
        """Sensors of either side of the hand of a set's cards, from 0."""
        folder = simulated([of], self.trials, self.out)[0][0]
        hand = read_scene_file(str(folder / "card.toml")).hand
        by_side: dict[str, list[int]] = {}
        for place, side in enumerate(hand.sensor_sides):
            by_side.setdefault(side, []).append(place)
        return list(by_side.values())


def digests(of: SceneSet) -> dict[str, str]:
    """Card -> digest of its text as the study uses it."""
    return {card: digest_of(card_text(card, of)) for card in of.cards}


def _people(run: _Run) -> Json:
    return run.kept(
        "people",
        lambda: {"rows": people.real_rows(run.seed, run.workers, run.say)},
        None,
    )


def _scenes(run: _Run) -> Json:
    def rows(one: SceneSet, data: DataSet) -> list[Json]:
        human = OURS.data()
        if data.n_sensors != human.n_sensors:
            return []
        model = people.train(data, human.rate_hz, people.PLAN, run.seed)
        found = people.scene_rows(one.name, model, human, run.seed)
        if one == SHIPPED:
            main = ("situations",)
            plan = people.SHIPPED_PLAN
            shipped = people.train(data, human.rate_hz, plan, run.seed, main)
            name = f"{one.name}, shipped learner"
            found += people.scene_rows(name, shipped, human, run.seed)
        return found

    return {
        "rows": run.of_scenes("scenes", TRAINED, rows),
        "people_level_n": levels(OURS.data(), by_group=True),
    }


def _spread(run: _Run) -> Json:
    def rows(one: SceneSet, data: DataSet) -> list[Json]:
        human = people.reported_on(PLACED[SPREAD_18].data())
        found = []
        for name, groups in (
            (one.name, people.PLAN.groups),
            (f"{one.name}, changes by own load", OWN_LOAD.groups),
        ):
            plan = replace(people.PLAN, groups=groups)
            model = people.train(data, human.rate_hz, plan, run.seed)
            found += people.scene_rows(name, model, human, run.seed)
        return found

    return {"rows": run.of_scenes("spread", ON_SPREAD, rows)}


def _tugs(run: _Run) -> Json:
    real = load("eflesh_slip")

    def rows(one: SceneSet, data: DataSet) -> list[Json]:
        same = real
        if data.n_sensors != real.n_sensors:
            same = load("eflesh_slip", channels=3 * data.n_sensors)
        return tugs.scene_rows(one.name, data, same, run.seed)

    own = run.kept("tugs", lambda: {"rows": tugs.real_rows(real, run.seed)}, None)
    path = model_path(run.model)
    of_file = f"tugs-file-{digest_of(path.read_bytes().hex())}"

    def file_rows() -> Json:
        scenes = run.scenes(IN_NEWTONS)
        return {"rows": tugs.file_rows(path, scenes, real, run.seed)}

    found = own["rows"] + run.of_scenes("tugs", IN_FIELD, rows)
    found += run.kept(of_file, file_rows, IN_NEWTONS)["rows"]
    return {"rows": found, "caveat": real.caveat}


def _domain(run: _Run) -> Json:
    def halves() -> Json:
        first, second = domain.halves(OURS.data(), run.seed)
        return {"rows": domain.domain_rows(domain.HALVES, first, second, run.seed)}

    def rows(one: SceneSet, data: DataSet) -> list[Json]:
        human = OURS.data()
        if data.n_sensors != human.n_sensors:
            return []
        human = at_level(human, levels(data, by_group=False)[""])
        return domain.domain_rows(one.name, people.like_people(data), human, run.seed)

    floor = run.kept("domain", halves, None)["rows"]
    return {"rows": floor + run.of_scenes("domain", TOLD_APART, rows)}


def _statistics(run: _Run) -> Json:
    def real() -> Json:
        rows = []
        for channels, name in ((18, PEOPLE), (48, TAXELS)):
            human = load("human_slip_uskin", channels=channels)
            one_pad = [list(range(human.n_sensors))]
            found = statistics.statistics(human, one_pad)
            rows += statistics.spread_rows(name, True, found)
        found = statistics.field_statistics(load("eflesh_slip"))
        return {"rows": rows + statistics.spread_rows(EFLESH, True, found)}

    def of_scene(one: SceneSet, data: DataSet) -> list[Json]:
        found = statistics.statistics(data, run.sides(one))
        return statistics.spread_rows(one.name, False, found)

    def in_field(one: SceneSet, data: DataSet) -> list[Json]:
        found = statistics.field_statistics(tugs.clips(data, run.seed))
        return statistics.spread_rows(one.name, False, found)

    rows = run.kept("statistics", real, None)["rows"]
    rows = rows + run.of_scenes("statistics", COMPARED, of_scene)
    rows = rows + run.of_scenes("field", IN_FIELD, in_field)
    return {"rows": rows, "within": statistics.within(rows)}


def _traces(run: _Run) -> Json:
    real = load("proactive_slip_uskin")
    pads = [[0, 1, 2], [3, 4, 5]]

    def rows(one: SceneSet, data: DataSet) -> list[Json]:
        return traces.scene_traces([(one.name, data, run.sides(one))], 2)

    return {
        "real": traces.real_traces(real, pads),
        "simulated": run.of_scenes("traces", DRAWN, rows)[:3],
        "caveat": real.caveat,
    }


PARTS: dict[str, Callable[[_Run], Json]] = {
    "people": _people,
    "scenes": _scenes,
    "spread": _spread,
    "tugs": _tugs,
    "domain": _domain,
    "statistics": _statistics,
    "traces": _traces,
}
STAGES = 30
"""Lines the progress bar expects; a wrong number only makes the bar end early or late."""


def commit() -> str | None:
    """The checkout's commit; None outside of one."""
    words = ["git", "rev-parse", "--short=12", "HEAD"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    return done.stdout.strip() or None


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this study alone."""
    add_job_options(parser, 2)
    parser.add_argument(
        "--parts",
        nargs="+",
        metavar="PART",
        default=list(PARTS),
        help=f"only these parts: {', '.join(PARTS)}",
    )
    parser.add_argument(
        "--trials",
        type=int,
        default=TRIALS,
        metavar="N",
        help=f"trials of every card (default {TRIALS})",
    )
    parser.add_argument(
        "--model",
        type=path_argument,
        default=MODEL,
        metavar="FILE",
        help=f"exported for the gripper of eflesh_slip (default {MODEL})",
    )
    parser.add_argument(
        "--fresh",
        action="store_true",
        help="keep nothing of an earlier run: simulate and measure again",
    )


def run(args: argparse.Namespace) -> int:
    """Do the parts, write transfer.json, print the headline."""
    unknown = [name for name in args.parts if name not in PARTS]
    if unknown:
        raise UsageError(
            f"--parts {' '.join(unknown)}: no such part",
            next_step=f"choose from {', '.join(PARTS)}",
        )
    require_writable(args.out)
    if args.fresh:
        for folder in ("parts", "sets"):
            shutil.rmtree(args.out / folder, ignore_errors=True)
    figures: Json = {
        "command": "python -m studies transfer",
        "date": datetime.now(UTC).date().isoformat(),
        "commit": commit(),
        "caveat": CAVEAT,
        "fixed": FIXED,
        "trials_a_card": args.trials,
        "seed": args.seed,
        "scenes_seed": SEED,
    }
    with stages(STAGES) as say:
        study = _Run(args, say)
        for name in args.parts:
            figures[name] = PARTS[name](study)
    figures["seconds"] = round(study.seconds, 1)
    path = write_figures(args.out / "transfer.json", figures)
    print("\n".join([*headline(figures), str(path)]))
    return 0


def headline(figures: Json) -> Sequence[str]:
    """A line for each row on people."""
    lines = []
    for part in ("people", "scenes", "spread"):
        for row in figures.get(part, {}).get("rows", ()):
            f1 = number(row["situations"]["macro_f1"], 3)
            auc = number((row.get("predict_250ms") or {}).get("auc"), 3)
            recall = row["recall"]
            lines.append(
                f"{row['row']}, {row['scaling']}: macro F1 {f1}, AUC {auc}, "
                f"nothing found {number(recall['nothing']['share'], 2)}, "
                f"grasp {number(recall['grasp']['share'], 2)}"
            )
    return lines
