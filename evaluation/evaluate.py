"""The whole evaluation of one file: thresholds chosen, rivals matched, every set asked, everything
put side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from edge_runtime.contract import BoolArray
from edge_runtime.decision import DecisionRules
from edge_runtime.errors import UsageError
from edge_runtime.monitor import Model
from evaluation import MOST_FALSE_PER_MIN
from evaluation.alarms import act_requests
from evaluation.baselines import LAWS, Baseline, Matched, false_per_min, matched, raw_forest, rivals
from evaluation.camera import onsets_by, seen_beside
from evaluation.closing_hand import LAGS_S, Drop, Droppable, Hand, drop_of, model_error_ms
from evaluation.event_scores import choose_confidence
from evaluation.figures import (
    LabelledTrial,
    MethodResult,
    line,
    line_figures,
    mcnemar,
    state_figures,
    state_line,
    together,
    without_samples,
)
from evaluation.model_outputs import OUTPUTS, ModelOutputs, everywhere, rules_of, said
from evaluation.outcomes import Outcome, outcome_table, outcomes
from evaluation.truths import grasp_of, grasps_beside
from evaluation.window_scores import at_windows, heads_asked, require_model_fits, window_figures
from export.spec import StepSpec
from training.datasets import find, load
from training.fitting import with_situations
from training.objects import read_json
from training.recording import DataSet, Recording
from training.say import Say

DEPLOYED, CHOSEN = "ours, as deployed", "ours, confidence chosen"
SHOWN = (
    ("pass", "full-bottle", False),
    ("pull", "", False),
    ("fall", "", False),
    ("put-down", "", False),
    ("pass", "full-bottle", True),
)
"""Action, object and whether it must be that object (else must not be): one picture each."""
ROWS_SHOWN = 8


@dataclass(frozen=True)
class EvaluationRequest:
    """What an evaluation is asked for.

    choose, train: folders, maybe none. groups: so many people (or blocks) only. people: these only,
    where any are told.
    """

    data: Sequence[str]
    choose: Sequence[str] = ()
    train: str | None = None
    groups: int | None = None
    people: frozenset[str] = frozenset()
    most_false_per_min: float = MOST_FALSE_PER_MIN
    seed: int = 0


@dataclass(frozen=True)
class Shown:
    """A trial to be drawn: its truth, what was said and what was asked [T]."""

    told: LabelledTrial
    situation: Any
    asked: BoolArray


@dataclass(frozen=True)
class Evidence:
    """Everything the report shows."""

    figures: dict[str, Any]
    shown: dict[str, list[Shown]] = field(default_factory=dict)
    timed: dict[str, dict[str, list[float]]] = field(default_factory=dict)


@dataclass(frozen=True)
class Thresholds:
    """The lines of ours (name -> confidence), the first the headline; rivals at their settings; how
    they came about."""

    ours: dict[str, int]
    matched: list[Matched]
    told: dict[str, Any]

    @property
    def headline(self) -> str:
        """The line that everything else is compared with."""
        return next(iter(self.ours))


@dataclass(frozen=True)
class _SetResult:
    figures: dict[str, Any]
    told: list[LabelledTrial]
    lines: dict[str, MethodResult]
    drops: list[Drop | None]
    outcomes: list[Outcome]
    shown: dict[str, list[Shown]]
    to_state_ms: list[float]


def evaluate_events(
    model: Model, asked: EvaluationRequest, say: Say = lambda line: None
) -> Evidence:
    """Evaluate a file on sets. Raises what reading them raises, and ChannelError, UnitError or
    RateError."""
    _require_apart(asked)
    others = _rivals(model, asked, say)
    thresholds = _chosen(model, asked, others, say) if asked.choose else None
    results: dict[str, _SetResult] = {}
    for name in asked.data:
        say(f"reading {name}")
        data = _load(model, name, asked)
        say(f"{data.name}: {len(data.recordings)} recordings answered, sample by sample")
        computed = everywhere(
            model.session,
            [*data.recordings],
            [*OUTPUTS, *heads_asked(model, with_situations(data))],
        )
        answered = said(model, data.recordings, computed)
        if thresholds is None:
            say(f"{data.name}: rivals matched")
            thresholds_here = _thresholds(
                model, asked, others, data.recordings, answered, None, [_named(name, data)]
            )
        else:
            thresholds_here = thresholds
        windows = _window_figures(model, data, computed, asked.seed)
        del computed
        key = data.name if data.name not in results else f"{data.name} ({len(results) + 1})"
        say(f"{data.name}: scored beside {len(thresholds_here.matched)} others")
        results[key] = _score(
            model, find(name), data, answered, thresholds_here, windows, asked.seed
        )
    return _gathered(model, asked, results, thresholds)


def _require_apart(asked: EvaluationRequest) -> None:
    """Raise DataNotFound for a folder that is not there, UsageError for one both to choose on and
    to score."""
    scored = {find(name).resolve(): name for name in asked.data}
    if asked.train:
        find(asked.train)
    for name in asked.choose:
        if find(name).resolve() in scored:
            raise UsageError(
                f"{name} is to choose the confidence on and to be scored",
                cause="a threshold chosen on the streams it is scored on flatters",
                next_step="simulate another set with another --seed, or leave --choose out",
            )


def _named(name: str, data: DataSet) -> str:
    """A set's name with the seed it was made from, where it was: two of one card are two sets."""
    made_from = read_json(find(name) / "meta.json").get("seed")
    return data.name if made_from is None else f"{data.name}, seed {made_from}"


def _load(model: Model, name: str, asked: EvaluationRequest) -> DataSet:
    data = load(
        name,
        channels=model.card.n_channels,
        groups=asked.groups,
        seed=asked.seed,
        windows="natural",
    )
    require_model_fits(model, data)
    return data.of_groups(asked.people) if asked.people else data


def _window_figures(
    model: Model, data: DataSet, computed: Sequence[Any], seed: int
) -> dict[str, Any]:
    whole = with_situations(data)
    names = ["situation", "unknown", *heads_asked(model, whole)]
    rows = [np.arange(len(one.samples)) for one in whole.recordings]
    answers = at_windows(whole, [{name: out[name] for name in names} for out in computed], rows)
    return window_figures(model, whole, answers, seed=seed)


def _chosen(
    model: Model, asked: EvaluationRequest, others: Sequence[Baseline], say: Say
) -> Thresholds:
    """Thresholds from streams that are not the ones scored."""
    say(f"reading {', '.join(asked.choose)}, to choose on")
    sets = [_load(model, name, asked) for name in asked.choose]
    recordings = [one for data in sets for one in data.recordings]
    answered = said(model, recordings, everywhere(model.session, recordings, OUTPUTS))
    permille = choose_confidence(
        [one.answers for one in answered], rules_of(model.card), asked.most_false_per_min
    )
    say(f"confidence {permille} of 1000 chosen; rivals matched")
    return _thresholds(
        model,
        asked,
        others,
        recordings,
        answered,
        permille,
        [_named(name, data) for name, data in zip(asked.choose, sets, strict=True)],
    )


def _thresholds(
    model: Model,
    asked: EvaluationRequest,
    others: Sequence[Baseline],
    recordings: Sequence[Recording],
    answered: Sequence[ModelOutputs],
    permille: int | None,
    on: list[str],
) -> Thresholds:
    """Ours as deployed and, first, as chosen; rivals at the headline's own rate of false alarms on
    these streams."""
    rules = rules_of(model.card)
    deployed = {DEPLOYED: rules.min_risky_permille}
    ours = deployed if permille is None else {CHOSEN: permille} | deployed
    headline = next(iter(ours))
    rate = false_per_min(recordings, _asked(answered, rules, ours[headline]))
    found = [matched(one, recordings, rate) for one in others]
    same = permille is None
    return Thresholds(
        ours,
        found,
        {
            "headline": headline,
            "lines": {name: {"min_risky_permille": value} for name, value in ours.items()},
            "rules": rules.to_json(),
            "chosen_on": None if same else on,
            "most_false_per_min": None if same else asked.most_false_per_min,
            "false_per_min_there": rate,
            "matched_on": on,
            "how": (
                "the card's own rules; rivals matched on the very streams that are scored, which flatters them"
                if same
                else f"the lowest confidence with at most {asked.most_false_per_min:g} false alarms a minute on other streams "
                f"({', '.join(on)}); rivals at our rate there, {rate:.3g} a minute"
            ),
            "rivals": {
                m.rival.name: {
                    "law": LAWS[m.rival.name],
                    "setting": m.setting,
                    "false_per_min_there": m.false_per_min,
                    "fits": m.fits,
                }
                for m in found
            },
        },
    )


def _rivals(model: Model, asked: EvaluationRequest, say: Say) -> list[Baseline]:
    spec, rules = StepSpec.from_json(model.card.raw["spec"]), rules_of(model.card)
    forest = None
    if asked.train:
        say(f"the thesis' forest trained on {asked.train}")
        data = load(asked.train, channels=model.card.n_channels, seed=asked.seed)
        require_model_fits(model, data)
        forest = raw_forest(data, spec, rules, asked.seed)
    return rivals(spec, rules, forest)


def _asked(
    answered: Sequence[ModelOutputs], rules: DecisionRules, permille: int
) -> list[BoolArray]:
    return [on[:, 0] for on in act_requests([one.answers for one in answered], rules, [permille])]


def _score(
    model: Model,
    root: Path,
    data: DataSet,
    answered: list[ModelOutputs],
    thresholds: Thresholds,
    windows: dict[str, Any],
    seed: int,
) -> _SetResult:
    beside = zip(
        data.recordings,
        grasps_beside(root, data.recordings),
        seen_beside(root, data.recordings),
        strict=True,
    )
    told = [LabelledTrial(without_samples(one), grasps, seen) for one, grasps, seen in beside]
    rules = rules_of(model.card)
    asked = {name: _asked(answered, rules, permille) for name, permille in thresholds.ours.items()}
    asked |= {m.rival.name: m.rival.on(data.recordings)(m.setting) for m in thresholds.matched}
    lines = {name: line(told, on) for name, on in asked.items()}
    drops = [
        drop_of(event, grasp_of(event, one.grasps))
        for one in told
        for event in one.recording.events
    ]
    bound = Droppable.of(drops) if any(drop is not None for drop in drops) else None
    ours = lines[thresholds.headline]
    permille = thresholds.ours[thresholds.headline]
    heavy = _weights(data)
    states = state_line(answered, permille)
    figures = {
        "data": _described(root, data, windows),
        "windows": windows,
        "rows": {name: line_figures(one, told, bound, seed) for name, one in lines.items()},
        "states": state_figures(answered, permille, heavy, seed),
        "mcnemar": _compared(ours, lines, thresholds),
        "closing": _closing(drops, ours),
    }
    if thresholds.told["chosen_on"] is None:
        figures["thresholds"] = thresholds.told
    on = asked[thresholds.headline]
    return _SetResult(
        figures,
        told,
        lines,
        drops,
        outcomes(told, answered, on),
        _to_show(told, answered, on),
        [1e3 * o.delay_s for one in states for o in one.outcomes if o.delay_s is not None],
    )


def _compared(
    ours: MethodResult, lines: dict[str, MethodResult], thresholds: Thresholds
) -> dict[str, Any]:
    """McNemar's test of our headline against every rival, event by event."""
    return {
        m.rival.name: mcnemar(ours.found(), lines[m.rival.name].found()) for m in thresholds.matched
    }


def _closing(drops: Sequence[Drop | None], ours: MethodResult) -> dict[str, Any] | None:
    """How good the model of closing is, and what other lags would make of it."""
    if not any(drop is not None for drop in drops):
        return None
    by_lag = {
        f"{1e3 * lag_s:g}": Droppable.of(drops, Hand(lag_s=lag_s)).figures(ours.asked_s())
        for lag_s in LAGS_S
    }
    return {"model_error_ms": model_error_ms(drops), "by_lag_ms": by_lag}


def _weights(data: DataSet) -> list[bool | None]:
    """Whether each recording's object is heavy, as its windows say; None without an object or a
    window."""
    heavy: list[bool | None] = [None] * len(data.recordings)
    if "classes" in data.tasks:
        task = data.tasks["classes"]
        for trial, label in zip(task.trial.tolist(), task.label.tolist(), strict=True):
            if data.recordings[trial].object_name is not None:
                heavy[trial] = bool(label % 2)
    return heavy


def _described(root: Path, data: DataSet, windows: dict[str, Any]) -> dict[str, Any]:
    """The set's data card."""
    meta = {
        k: v
        for k, v in read_json(root / "meta.json").items()
        if k in ("title", "card_sha256", "seed", "effects")
    }
    minutes = sum(len(one.samples) / one.rate_hz for one in data.recordings) / 60.0
    return {
        "name": data.name,
        "kind": data.kind,
        **meta,
        "rate_hz": data.rate_hz,
        "unit": data.unit,
        "recordings": len(data.recordings),
        "groups": len(data.groups()),
        "minutes": minutes,
        "events": sum(len(one.events) for one in data.recordings),
        "samples": data.notes.get("samples"),
        "onsets_by": onsets_by(root, data.recordings),
        "trained_on_recordings": windows["trained_on_recordings"],
        "caveat": data.caveat,
    }


def _to_show(
    told: Sequence[LabelledTrial], answered: Sequence[ModelOutputs], asked: Sequence[BoolArray]
) -> dict[str, list[Shown]]:
    """The first trials of every picture, an object in turn: chosen before any answer."""
    shown = {}
    for action, name, wanted in SHOWN:
        fits = [
            k
            for k, one in enumerate(told)
            if one.recording.action == action
            and (not name or (one.recording.object_name == name) == wanted)
        ]
        turn: dict[str | None, int] = {}
        dealt = []
        for k in fits:
            of = told[k].recording.object_name
            turn[of] = turn.get(of, 0) + 1
            dealt.append((turn[of], k))
        title = f"{action}, {name}" if wanted else action
        shown[title] = [
            Shown(told[k], answered[k].situation, asked[k]) for _, k in sorted(dealt)[:ROWS_SHOWN]
        ]
    return {title: rows for title, rows in shown.items() if rows}


def _gathered(
    model: Model,
    asked: EvaluationRequest,
    results: dict[str, _SetResult],
    thresholds: Thresholds | None,
) -> Evidence:
    """All sets under one head. Where rivals were matched on each set itself, their settings stand
    with the set."""
    first = next(iter(results.values()))
    figures: dict[str, Any] = (
        first.figures["windows"] if len(results) == 1 else {"model_id": model.card.model_id}
    )
    told_thresholds = thresholds.told if thresholds else first.figures["thresholds"]
    headline = told_thresholds["headline"]
    names = list(first.lines)
    lines = {name: together([one.lines[name] for one in results.values()]) for name in names}
    told = [one for result in results.values() for one in result.told]
    drops = [one for result in results.values() for one in result.drops]
    bound = Droppable.of(drops) if any(drop is not None for drop in drops) else None
    seed = asked.seed
    figures = figures | {
        "model": {
            "model_id": model.card.model_id,
            "rate_hz": model.card.rate_hz,
            "unit": model.card.unit,
            "votes_for": list(model.card.classes),
            "trained_on": model.card.raw["training"].get("data"),
        },
        "thresholds": told_thresholds,
        "seed": seed,
        "sets": {name: one.figures for name, one in results.items()},
        "all": {
            "rows": {name: line_figures(one, told, bound, seed) for name, one in lines.items()},
            "mcnemar": {
                name: mcnemar(lines[headline].found(), lines[name].found())
                for name in names
                if name not in (DEPLOYED, CHOSEN)
            },
        },
        "outcomes": outcome_table([one for result in results.values() for one in result.outcomes]),
    }
    shown = next((one.shown for one in results.values() if one.shown), {})
    timed = {
        name: _timed(one, headline)
        for name, one in results.items()
        if one.figures["data"]["events"]
    }
    return Evidence(figures, shown, timed)


def _timed(result: _SetResult, headline: str) -> dict[str, list[float]]:
    """ms of every event: to the state, to the alarm, the lead there was and the lead that was
    left."""
    found = [
        o for one in result.lines[headline].matches for o in one.outcomes if o.delay_s is not None
    ]
    return {
        "to the first risky_slip state": result.to_state_ms,
        "to act": [1e3 * o.delay_s for o in found if o.delay_s is not None],
        "lead available": [1e3 * o.available_s for o in found if o.available_s is not None],
        "lead left at act": [1e3 * o.lead_s for o in found if o.lead_s is not None],
    }
