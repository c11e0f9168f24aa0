"""One trial of the table: its draw, the bare hand, the answered hand and the oracle, as numbers."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass

import numpy as np

from benchmarks.world.answers import Answers, answered_run
from benchmarks.world.draws import NEVER_S, RISKY, WorldTrial, draw_trial, with_intent
from benchmarks.world.outcomes import (
    KNOWS_AFTER_S,
    REFUSALS,
    BareRun,
    Outcome,
    oracle_saves,
    possible_run,
)
from holdfast.core.contract import Json
from holdfast.simulation.loop.drive import Opening


@dataclass(frozen=True)
class TrialKey:
    """Which trial, with which pads and sensors."""

    kind: str
    repetition: int
    pads: str
    sensors: str

    @property
    def name(self) -> str:
        """As it stands in the file of trials."""
        return f"{self.kind} {self.repetition} {self.pads} {self.sensors}"


@dataclass(frozen=True)
class AnsweredHand:
    """What answers. intent: of INTENTS. opening: who decides when the wearer opens the hand."""

    model: str
    controller: str
    intent: str = "drawn"
    opening: Opening = "wearer"

    def run(self, trial: WorldTrial, pads: str, sensors: str) -> Answers:
        """A trial in this hand."""
        return answered_run(
            trial, pads, sensors, self.model, self.controller, self.opening
        )


def record(key: TrialKey, seed: int, hand: AnsweredHand) -> Json:
    """Run one trial in all its hands; a JSON object."""
    started_s = time.process_time()
    first = 0
    unstable = 0
    while True:
        bare, refused = possible_run(key.kind, key.repetition, seed, key.pads, first)
        try:
            found = _hands(bare, key, hand)
        except FloatingPointError:
            first = bare.trial.attempt + 1
            unstable += 1
            continue
        refused[REFUSALS[3]] += unstable
        cpu_s = round(time.process_time() - started_s, 3)
        about = {"name": key.name, "cpu_s": cpu_s, "refused": refused}
        return {**asdict(key), **about, **found}


def answered_again(one: Json, seed: int, hand: AnsweredHand) -> Json:
    """The record with another answered hand: the bare hand and the oracle are the same."""
    first = one["attempt"]
    drawn = draw_trial(one["kind"], one["repetition"], seed, first)
    trial = with_intent(drawn, hand.intent)
    answers = hand.run(trial, one["pads"], one["sensors"])
    return {**one, "trial": _drawn(trial), "answered": _answered(answers, trial)}


def _hands(bare: BareRun, key: TrialKey, hand: AnsweredHand) -> Json:
    """The bare hand, the oracle where it drops the object, and the answered hand."""
    trial = with_intent(bare.trial, hand.intent)
    saves = late = None
    if key.kind in RISKY and np.isfinite(bare.outcome.lost_s):
        saves = oracle_saves(bare)
        # What nothing keeps from load onset on is not preventable, and is not tried later.
        late = oracle_saves(bare, KNOWS_AFTER_S) if saves else None
    answers = hand.run(trial, key.pads, key.sensors)
    return {
        "attempt": trial.attempt,
        "trial": _drawn(trial),
        "bare": _outcome(bare.outcome, trial),
        "oracle": saves,
        "oracle_late": late,
        "answered": _answered(answers, trial),
    }


def _answered(answers: Answers, trial: WorldTrial) -> Json:
    """What the answered hand did, and what became of the object."""
    counted = {
        "earlier": answers.earlier,
        "called": answers.called,
        "released_s": round(answers.released_s, 4),
        "tightenings": answers.tightenings,
        "quiet_s": round(answers.quiet_s, 4),
        "most_n": round(answers.most_n, 4),
    }
    return _outcome(answers.outcome, trial) | counted


def _drawn(trial: WorldTrial) -> Json:
    """What a table may be split by."""
    n = trial.numbers
    opens_s = trial.open_s - trial.act_s
    return {
        "shape": trial.shape,
        "mass_g": round(1e3 * n["mass_kg"], 2),
        "friction": round(n["friction"], 4),
        "friction_used": round(n["friction_used"], 4),
        "grip_n": round(trial.grip_n, 4),
        "need_n": round(trial.need_n, 4),
        "opens_s": None if trial.open_s >= NEVER_S else round(opens_s, 4),
        "tremor_m_s2": round(n["tremor_m_s2"], 4),
        "signal": trial.has_signal,
    }


def _outcome(outcome: Outcome, trial: WorldTrial) -> Json:
    """Times after the event began; None for never."""
    lost_s, onset_s = (
        round(t_s - trial.act_s, 4) if np.isfinite(t_s) else None
        for t_s in (outcome.lost_s, outcome.onset_s)
    )
    return {
        "lost_s": lost_s,
        "onset_s": onset_s,
        "slip_mm": round(outcome.slip_mm, 3),
        "peak_n": round(outcome.peak_n, 3),
        "peak_before_n": round(outcome.peak_before_n, 3),
        "held_on_s": round(outcome.held_on_s, 4),
        "grip_n": round(outcome.grip_n, 3),
    }
