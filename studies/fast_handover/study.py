"""The study: every idea trained on some sets, its threshold chosen on a second kind, asked about a
third.

Trained on: `thesis`, `broad` and, for some, `daily` and `perturbed-hold`. The threshold: `daily`,
as low as leaves half a false alarm a minute. Asked: trials of the author's style never met
(`author`), two styles never met (`p1`, `p2`), and disturbed holds. All simulated; a trial is on one
side only, because the sets are simulated from different seeds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from sklearn.metrics import f1_score

from edge_runtime.contract import SITUATIONS, BoolArray
from edge_runtime.decision import UNKNOWN
from edge_runtime.timing import time_in_turns
from evaluation.alarms import Answers, act_requests
from evaluation.event_scores import choose_confidence, event_scores, match_alarms
from evaluation.figures import LabelledTrial, line, line_figures, together
from evaluation.truths import Grasp
from export.spec import HISTORY_S
from studies.fast_handover.ideas import IDEAS, Features, Idea
from studies.fast_handover.learners import Answer, Learner
from studies.fast_handover.sets import Labelled, Streams, joined, labelled, streams, without
from studies.fast_handover.timing import session_of
from training.featurise import FloatRows
from training.plan import HIGH_CONFIDENCE
from training.say import Say
from training.windows import Choice

CHOOSE, ASKED = "choose", ("author", "p1", "p2", "asked-holds")
MOST_FALSE_PER_MIN = 0.5
CALIBRATION_PASSES = 8
BOX_GAP_M = 0.01
"""From the object to the box before it is put down, as the scenes have it."""
PAST_S = 0.020
"""Windows nearer to a change of phase are left out of a second F1: the truth there is sharper than
any sensor."""
TURNS, CALLS = 20, 50


def study(folder: Path, seed: int, say: Say, ideas: Sequence[Idea] = IDEAS) -> dict[str, Any]:
    """Rows of all ideas. folder: holds the sets by their names, and keeps features. Raises what
    reading them raises."""

    @cache
    def to_train(name: str, windows: Choice, features: Features) -> Labelled:
        return labelled(folder / name, windows, features)

    @cache
    def to_ask(name: str, features: Features) -> Streams:
        return streams(
            folder / name, "balanced" if name in ("author", "p1", "p2") else "natural", features
        )

    rows, timed = [], {}
    for idea in ideas:
        say(idea.name)
        part = joined([to_train(name, idea.windows, idea.features) for name in idea.trained_on])
        learner = idea.learner()
        learner.fit(part.features, part.label, seed)
        ask = {name: to_ask(name, idea.features) for name in (CHOOSE, *ASKED)}
        told = {name: learner.answer(np.asarray(one.features)) for name, one in ask.items()}
        rows.append({"idea": idea.name} | _figures(idea, ask, told, seed))
        if idea.objects_left_out:
            author = ask["author"]
            rows[-1]["worst_object"] = min(_objects_left_out(idea, part, author, seed).values())
        timed[idea.name] = _calls(learner, part.features[:200])
    us = {
        name: float(np.median(times)) for name, times in time_in_turns(timed, TURNS, CALLS).items()
    }
    for row in rows:
        row["learner_us"] = us[row["idea"]]
    return {"rows": rows, "bounds": bounds(to_ask("author", "default"))}


def _figures(
    idea: Idea, ask: dict[str, Streams], told: dict[str, Answer], seed: int
) -> dict[str, Any]:
    """One row: windows, then streams at the threshold that the other streams gave."""
    answers = {
        name: _answers(one, told[name], idea.decision == "veto") for name, one in ask.items()
    }
    permille = choose_confidence(answers[CHOOSE], HIGH_CONFIDENCE, MOST_FALSE_PER_MIN)
    least = {
        name: _personal(ask[name], answers[name], permille)
        if idea.decision == "personal"
        else permille
        for name in ASKED
    }
    asked = {
        name: [on[:, 0] for on in act_requests(answers[name], HIGH_CONFIDENCE, [least[name]])]
        for name in ASKED
    }
    lines = {name: line(ask[name].trials, asked[name]) for name in ASKED}
    figures: dict[str, Any] = {"permille": least | {CHOOSE: permille}}
    for name in ("author", "p1", "p2"):
        figures[f"f1_{name}"] = macro_f1(ask[name], told[name][0])
        figures[f"f1_{name}_past"] = macro_f1(ask[name], told[name][0], past_s=PAST_S)
    for name in ASKED:
        of = line_figures(lines[name], ask[name].trials, None, seed)
        kept = (
            "events",
            "recall",
            "recall_ci",
            "false_per_min",
            "false_per_min_ci",
            "in_time",
            "delay_ms",
            "safe_acts_called",
            "specificity",
        )
        figures[name] = {key: of[key] for key in kept}
    unseen = event_scores(together([lines["p1"], lines["p2"]]).matches, seed=seed)
    figures["unseen_style"] = {
        key: unseen[key] for key in ("events", "recall", "recall_ci", "false_per_min")
    }
    states = [_state(one, least["author"]) for one in answers["author"]]
    figures["state_delay_ms"] = event_scores(
        [
            match_alarms(one.recording, on)
            for one, on in zip(answers["author"], states, strict=True)
        ],
        seed=seed,
    )["delay_ms"]
    return figures


def _state(one: Answers, permille: int) -> BoolArray:
    on: BoolArray = (one.situation == len(SITUATIONS) - 1) & (one.risky_permille >= permille)
    return on


def macro_f1(asked: Streams, situation: npt.NDArray[np.int64], past_s: float = 0.0) -> float:
    """Over four situations, of the balanced windows, those nearer than past_s to a change of phase
    left out."""
    kept = np.concatenate(
        [_since_change_s(one, n) for one, n in zip(asked.trials, asked.lengths, strict=True)]
    )
    there = kept[asked.row] >= past_s
    return float(f1_score(asked.label[there], situation[asked.row[there]], average="macro"))


def _since_change_s(told: LabelledTrial, n: int) -> npt.NDArray[np.float64]:
    """[T] s since the last change of phase."""
    since = np.full(n, np.inf)
    for phase in told.recording.phases:
        since[phase.first : phase.stop] = (
            np.arange(phase.stop - phase.first) / told.recording.rate_hz
        )
    return since


def bounds(asked: Streams) -> list[dict[str, Any]]:
    """What an observer who knows the truth, but so many samples late, would reach on the same
    windows."""
    starts = np.repeat(np.cumsum([0, *asked.lengths[:-1]]), asked.lengths)
    rows = []
    for late in range(5):
        seen = asked.truth[np.maximum(np.arange(len(starts)) - late, starts)]
        rows.append(
            {
                "samples_late": late,
                "ms_late": 1e3 * late / asked.trials[0].recording.rate_hz,
                "f1_author": macro_f1(asked, seen),
            }
        )
    return rows


def _answers(asked: Streams, told: Answer, veto: bool) -> list[Answers]:
    ends = np.cumsum(asked.lengths)[:-1]
    answers = []
    for one, situation, risky in zip(
        asked.trials, np.split(told[0], ends), np.split(told[1], ends), strict=True
    ):
        rate_hz = one.recording.rate_hz
        situation[: int(np.floor(HISTORY_S * rate_hz + 1e-9))] = UNKNOWN
        if veto:
            risky = np.where(_opening(one, len(risky)), -1, risky)
        answers.append(Answers(one.recording, situation, risky))
    return answers


def _opening(told: LabelledTrial, n: int) -> BoolArray:
    """[T] after the hand's own opening command, which a scene draws and no signal tells."""
    opens_s = [opens for grasp in told.grasps if (opens := opens_at_s(grasp)) is not None]
    times = np.arange(n) / told.recording.rate_hz
    return times >= opens_s[0] if len(opens_s) == 1 else np.zeros(n, dtype=np.bool_)


def opens_at_s(grasp: Grasp) -> float | None:
    """When the hand is told to open, from what was drawn; None where it never is."""
    drawn = grasp.told.get("drawn", {})
    if grasp.action not in ("pass", "put-down") or "open_after_s" not in drawn:
        return None
    acts_s = drawn["close_at_s"] + drawn["closing_s"] + drawn["hold_s"]
    waits_s = drawn["wait_s"] if grasp.action == "pass" else BOX_GAP_M / drawn["box_m_s"]
    return float(acts_s + waits_s + drawn["open_after_s"])


def _personal(asked: Streams, answers: Sequence[Answers], permille: int) -> int:
    """A style's own threshold: above whatever its first hand-overs reach, and not below the common
    one."""
    passes = [
        one
        for told, one in zip(asked.trials, answers, strict=True)
        if told.recording.action == "pass"
    ]
    reached = [
        int(one.risky_permille[one.situation == len(SITUATIONS) - 1].max(initial=0))
        for one in passes[:CALIBRATION_PASSES]
    ]
    return min(max([permille, *(most + 1 for most in reached)]), 1000)


def _objects_left_out(idea: Idea, part: Labelled, asked: Streams, seed: int) -> dict[str, float]:
    """Object -> macro F1 on its windows from a learner that never met it."""
    objects = np.repeat([one.recording.object_name or "" for one in asked.trials], asked.lengths)[
        asked.row
    ]
    found = {}
    for name in sorted(set(objects.tolist()) - {""}):
        learner, kept = idea.learner(), without(part, name)
        learner.fit(kept.features, kept.label, seed)
        here = objects == name
        answered = learner.answer(np.asarray(asked.features[asked.row[here]]))[0]
        found[name] = float(f1_score(asked.label[here], answered, average="macro"))
    return found


def _calls(learner: Learner, rows: FloatRows) -> Callable[[], object]:
    """All models of a learner, asked one row."""
    sessions = [session_of(model, rows) for model in learner.models]
    one, turn = [rows[k : k + 1] for k in range(len(rows))], cycle(range(len(rows)))

    def call() -> None:
        row = one[next(turn)]
        for session in sessions:
            session.run(None, {session.get_inputs()[0].name: row})

    return call
