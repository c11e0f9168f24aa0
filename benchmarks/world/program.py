"""`python -m benchmarks world`: the shipped model in a second physics. `make world` sets it up.

Test only: nothing is trained, chosen or tuned on it. Writes world.json, and a file with
a line for each trial, with which a run that was stopped goes on.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.mujoco_version import require_mujoco
from benchmarks.world.draws import INTENTS, KINDS, draw_trial, with_intent
from benchmarks.world.trials_file import ROOT, TrialsFile, code_sha256, file_sha256
from holdfast.cli.command import path_argument, seed, show
from holdfast.cli.options import CORES, add_job_options, chosen_workers
from holdfast.core.contract import Json
from holdfast.core.locked import locked_sets
from holdfast.core.schema import model_path
from holdfast.core.writing import require_writable, write_whole
from holdfast.simulation.loop.drive import OPENINGS

if TYPE_CHECKING:
    from benchmarks.world.record import AnsweredHand

SEED = 8103
"""Of the report; locked (holdfast/core/locked.toml)."""
TRIALS = 60
FULL_TRIALS = 200
CONTROLLER = "holdfast"
QUICK_SETS = (("point", "chain"),)
FULL_SETS = (
    ("point", "chain"),
    ("point", "ideal"),
    ("grid", "chain"),
    ("grid", "ideal"),
)
"""Pads and sensors. The slow pads come last, so that a run that is stopped has the others whole."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this program."""
    option = parser.add_argument
    default = Path("build/world")
    option(
        "--out",
        type=path_argument,
        default=default,
        metavar="DIR",
        help=f"default {default}",
    )
    model = model_path("holdfast-150hz")
    option(
        "--model",
        type=path_argument,
        default=model,
        metavar="FILE",
        help="the model file",
    )
    option(
        "--controller",
        nargs="+",
        default=[CONTROLLER],
        metavar="NAME",
        help=f"the tables are of the first, others stand beside it (default {CONTROLLER})",
    )
    option(
        "--intent",
        nargs="+",
        choices=tuple(INTENTS),
        default=["drawn"],
        metavar="NAME",
        help="which wearers' signals to open reach the run: drawn (half, the default), wired "
        "(nine in ten), always, none; the tables are of the first, others stand beside it",
    )
    option(
        "--opening",
        nargs="+",
        choices=tuple(OPENINGS),
        default=["wearer"],
        metavar="NAME",
        help="who decides when the wearer opens the hand: the wearer (default), or the larger of "
        "both, in a hand that cannot tell; the tables are of the first, the other stands beside it",
    )
    seeds = f"default {SEED}, which is locked; choose nothing on it (100 to 199: development)"
    option("--seed", type=seed, default=SEED, metavar="S", help=seeds)
    trials = f"of each kind (default {TRIALS}, with --full {FULL_TRIALS})"
    option("--trials", type=int, default=None, metavar="N", help=trials)
    full = "both kinds of pads, both of sensors (hours; resumes where it stopped)"
    option("--full", action="store_true", help=full)
    option(
        "--kinds",
        nargs="+",
        choices=tuple(KINDS),
        default=tuple(KINDS),
        metavar="KIND",
        help="only these kinds",
    )
    add_job_options(parser, CORES)


def run(args: argparse.Namespace) -> int:
    """Run what is not done yet, score all, write the JSON."""
    version = require_mujoco("world")
    require_writable(args.out)
    show(seed_line(args.seed))
    from benchmarks.world.scores import tables

    about = _about(args, version)
    records, seconds = _records(args, about)
    figures = {
        "command": _command(args),
        "date": time.strftime("%Y-%m-%d"),
        "commit": _commit(),
        "seed_is": seed_line(args.seed),
        **about,
        "trials_a_kind": args.trials or (FULL_TRIALS if args.full else TRIALS),
        "wall_s": round(seconds),
        "jobs": args.jobs,
        "cpu_s": round(sum(one.get("cpu_s", 0.0) for one in records)),
        "tables": tables(records),
    }
    figures |= _others(args, version, records)
    write_whole(args.out / "world.json", json.dumps(figures, indent=1) + "\n")
    for line in summary(figures):
        show(line)
    return 0


def _others(args: argparse.Namespace, version: str, records: list[Json]) -> Json:
    """The rows of further controllers, signals and openings, beside the first, of these records.

    The list of a choice of one is left out.
    """
    from benchmarks.world.scores import beside

    of = {args.controller[0]: records}
    for name in args.controller[1:]:
        about = _about(args, version, controller=name)
        of[name] = _with_another_hand(args, about, records)
    wired = {args.intent[0]: records}
    for name in args.intent[1:]:
        about = _about(args, version, intent=name)
        wired[name] = _with_other_signals(args, about, list(wired.values()))
    opened = {args.opening[0]: records}
    for name in args.opening[1:]:
        about = _about(args, version, opening=name)
        opened[name] = _with_another_hand(args, about, records)

    rows = {}
    if len(of) > 1:
        rows["controllers"] = [beside(name, made) for name, made in of.items()]
    if len(wired) > 1:
        first = args.controller[0]
        rows["intents"] = [
            {"intent": name, **beside(first, made)} for name, made in wired.items()
        ]
    if len(opened) > 1:
        first = args.controller[0]
        rows["openings"] = [
            {"opening": name, **beside(first, made)} for name, made in opened.items()
        ]
    return rows


def seed_line(number: int) -> str:
    """What the seed is for."""
    sets = locked_sets()
    locked = sets.lock_of_seed(number)
    if locked is not None:
        since = f"locked since {locked.locked_on}"
        return f"seed {number}: {since}, for reports; choose nothing on it"
    if sets.development.first <= number <= sets.development.last:
        return f"seed {number}: for development, not for reports"
    return f"seed {number}: neither locked nor for development; its figures are for no report"


def _about(
    args: argparse.Namespace,
    version: str,
    *,
    controller: str | None = None,
    intent: str | None = None,
    opening: str | None = None,
) -> Json:
    """What decides the outcome of a trial: a file of trials with another one is not continued."""
    from holdfast.edge_runtime.model import Model

    return {
        "simulated": True,
        "seed": args.seed,
        "controller": controller or args.controller[0],
        "intent": intent or args.intent[0],
        "opening": opening or args.opening[0],
        "model": {
            "file": args.model.name,
            "id": Model(args.model).card.model_id,
            "sha256": file_sha256(args.model),
        },
        "mujoco": version,
        "code_sha256": code_sha256(),
    }


def _records(args: argparse.Namespace, about: Json) -> tuple[list[Json], float]:
    """(records of one controller on all trials, seconds for those that were not done yet)."""
    from benchmarks.world.record import TrialKey, record

    count = args.trials or (FULL_TRIALS if args.full else TRIALS)
    keys = [
        TrialKey(kind, k, pads, sensors)
        for pads, sensors in (FULL_SETS if args.full else QUICK_SETS)
        for k in range(count)
        for kind in args.kinds
    ]
    hand = _hand_of(args, about)
    jobs = {key.name: partial(record, key, args.seed, hand) for key in keys}
    return _run_trials(args, about, jobs)


def _with_other_signals(
    args: argparse.Namespace, about: Json, ran: Sequence[list[Json]]
) -> list[Json]:
    """The records with another choice of signals; only what no record of `ran` has is run."""
    from benchmarks.world.record import answered_again

    found: dict[str, Json] = {}
    jobs = {}
    for same in zip(*ran, strict=True):
        one = same[0]
        drawn = draw_trial(one["kind"], one["repetition"], args.seed, one["attempt"])
        signal = with_intent(drawn, about["intent"]).has_signal
        known = [other for other in same if other["trial"]["signal"] == signal]
        if known:
            found[one["name"]] = known[0]
        else:
            hand = _hand_of(args, about)
            jobs[one["name"]] = partial(answered_again, one, args.seed, hand)
    made, _ = _run_trials(args, about, jobs)
    found |= {one["name"]: one for one in made}
    return [found[one["name"]] for one in ran[0]]


def _with_another_hand(
    args: argparse.Namespace, about: Json, records: Sequence[Json]
) -> list[Json]:
    """The records with another answered hand."""
    from benchmarks.world.record import answered_again

    hand = _hand_of(args, about)
    jobs = {}
    for one in records:
        jobs[one["name"]] = partial(answered_again, one, args.seed, hand)
    made, _ = _run_trials(args, about, jobs)
    return made


def _hand_of(args: argparse.Namespace, about: Json) -> AnsweredHand:
    """The answered hand of a file of records."""
    from benchmarks.world.record import AnsweredHand

    keys = ("controller", "intent", "opening")
    return AnsweredHand(str(args.model), **{key: about[key] for key in keys})


def _run_trials(
    args: argparse.Namespace, about: Json, jobs: Mapping[str, Callable[[], Json]]
) -> tuple[list[Json], float]:
    """(records of these trials, seconds for those that were not done yet). jobs: by name."""
    parts = (about["controller"], about["intent"], about["opening"], args.seed)
    name = f"trials-{'-'.join(map(str, (about['model']['id'], *parts)))}.jsonl"
    file = TrialsFile(args.out / name, about)
    if file.put_aside:
        show(f"{name} was of other code or another model: begun anew")
    left = [job for one, job in jobs.items() if one not in file.done]
    show(f"{len(jobs)} trials, {len(jobs) - len(left)} of them done before")
    started = time.monotonic()
    for k, one in enumerate(chosen_workers(args).run(left), 1):
        file.add(one)
        if k % 100 == 0:
            show(f"{k} of {len(left)} trials, {time.monotonic() - started:.0f} s")
    return file.of(list(jobs)), time.monotonic() - started


def _command(args: argparse.Namespace) -> str:
    """The command that repeats this."""
    words = ["make world", "FULL=1"] if args.full else ["make world"]
    options = [f"--seed {args.seed}", f"--model {args.model.name}"]
    if args.trials is not None:
        options.append(f"--trials {args.trials}")
    if args.kinds != tuple(KINDS):
        options.append(f"--kinds {' '.join(args.kinds)}")
    if args.controller != [CONTROLLER]:
        options.append(f"--controller {' '.join(args.controller)}")
    if args.intent != ["drawn"]:
        options.append(f"--intent {' '.join(args.intent)}")
    if args.opening != ["wearer"]:
        options.append(f"--opening {' '.join(args.opening)}")
    joined = " ".join(options)
    return " ".join([*words, f'ARGS="{joined}"'])


def _commit() -> str | None:
    """The checkout's commit, with a plus where files differ from it; None without git."""
    words = ["git", "-C", str(ROOT), "describe", "--always", "--dirty=+", "--exclude=*"]
    try:
        done = subprocess.run(words, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()


def _before(row: Json) -> str:
    """What a receiver feels before the opening."""
    if row["before_n"] is None or row["before_ms"] is None:
        return ""
    more = f"{row['before_n']['p95']:.1f} N and {row['before_ms']['p95']:.0f} ms more"
    return f", before it {more} (95 %)"


def summary(figures: Json) -> list[str]:
    """A few lines for people."""
    lines = []
    for table in figures["tables"]:
        lines.append(f"{table['pads']} pads, {table['sensors']} sensors")
        for row in (*table["kinds"], *table["groups"]):
            drops = (
                f"{row['saved']:3d} of {row['preventable']:3d} preventable drops saved"
            )
            fresh = f"{row['saved_fresh']} of {row['saved_fresh_of']} without earlier tightening"
            called = f"called {row['called']} of {row['called_of']}"
            lines.append(
                f"  {row['kind']:<16}{row['drops']:4d} drops, {drops}, {fresh}, "
                f"{row['late_saves']} by a hand that knows 20 ms after load onset; {called}"
            )
        for row in table["hand_overs"]:
            lines.append(
                f"  {row['opens']:<32}held after the opening {row['held_after']} of "
                f"{row['held_after_of']}{_before(row)}; blocked {row['blocked']} of "
                f"{row['blocked_of']}"
            )
        for row in table["quiet"]:
            lines.append(
                f"  {row['hold']:<32}{row['tightenings']} tightenings in {row['minutes']:.1f} min"
            )
    return lines
