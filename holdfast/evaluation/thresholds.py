"""Confidences of the model, and settings of its baselines, found before a stream is scored."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from holdfast.core.contract import BoolArray, Json
from holdfast.edge_runtime.decision import DecisionRules
from holdfast.edge_runtime.model_file import ModelCard
from holdfast.evaluation.alarms import requests_at
from holdfast.evaluation.baselines import (
    Baseline,
    MatchedBaseline,
    false_per_min,
    matched,
)
from holdfast.evaluation.formats import CHOSEN, DEPLOYED, LAWS
from holdfast.evaluation.model_outputs import ModelOutputs
from holdfast.training.progress import Part, ignored
from holdfast.training.recording import Recording


@dataclass(frozen=True)
class Chosen:
    """A confidence that was chosen on other streams: thousandths, and the allowed false alarms."""

    permille: int
    most_false_per_min: float


@dataclass(frozen=True)
class Thresholds:
    """Confidences of this model by stored name, the headline first, and its matched baselines.

    matched_on: names of the sets. chosen: None as deployed. false_per_min_there: the headline's
    rate on these sets, which the baselines may not exceed.
    """

    confidences: dict[str, int]
    baselines: list[MatchedBaseline]
    rules: DecisionRules
    matched_on: list[str]
    chosen: Chosen | None
    false_per_min_there: float

    @property
    def headline(self) -> str:
        """The method that everything else is compared with."""
        return next(iter(self.confidences))

    def how(self) -> str:
        """How the confidence and the settings came about, in a sentence."""
        if self.chosen is None:
            # This sentence stands in the report, next to the figures that it limits.
            return (
                "the model card's own rules; baselines matched on the very streams that are "
                "scored, which flatters them"
            )

        return (
            f"the lowest confidence with at most {self.chosen.most_false_per_min:g} false alarms "
            f"a minute on other streams ({', '.join(self.matched_on)}); baselines matched to this "
            f"model's rate there, {self.false_per_min_there:.3g} a minute"
        )

    def to_json(self) -> Json:
        """As it stands in figures.json."""
        chosen = self.chosen
        lines = {}
        for name, permille in self.confidences.items():
            lines[name] = {"min_risky_permille": permille}

        # "lines" and "rivals" are keys of the file format, older than today's words.
        rivals = {}
        for one in self.baselines:
            rivals[one.name] = {
                "law": LAWS[one.name],
                "setting": one.setting,
                "false_per_min_there": one.false_per_min,
                "fits": one.fits,
            }

        return {
            "headline": self.headline,
            "lines": lines,
            "rules": self.rules.to_json(),
            "chosen_on": self.matched_on if chosen else None,
            "most_false_per_min": chosen.most_false_per_min if chosen else None,
            "false_per_min_there": self.false_per_min_there,
            "matched_on": self.matched_on,
            "how": self.how(),
            "rivals": rivals,
        }


@dataclass(frozen=True)
class MatchingStreams:
    """Streams that settings are found on, as the model answered them; names of their sets."""

    recordings: Sequence[Recording]
    outputs: Sequence[ModelOutputs]
    names: list[str]


def find_thresholds(
    card: ModelCard,
    streams: MatchingStreams,
    baselines: Sequence[Baseline],
    chosen: Chosen | None = None,
    part: Part = ignored,
) -> Thresholds:
    """This model as deployed and, first, as chosen; baselines at the headline's own rate."""
    rules = card.decision
    # The first is the headline, which every baseline is compared with.
    confidences = {CHOSEN: chosen.permille} if chosen else {}
    # Also as deployed: that is what a hand runs, whatever was chosen here.
    confidences[DEPLOYED] = rules.min_risky_permille

    # A baseline may have as many false alarms as this model: their recalls then compare.
    permille = next(iter(confidences.values()))
    headline = requests_of(streams.outputs, rules, permille)
    # Measured on the same streams that the baselines are matched on.
    rate = false_per_min(streams.recordings, headline)

    found = []
    for number, one in enumerate(baselines, 1):
        found.append(matched(one, streams.recordings, rate))
        # Each baseline takes seconds to minutes, since every setting is a pass over the streams.
        part(number / len(baselines))

    return Thresholds(confidences, found, rules, streams.names, chosen, rate)


def requests_of(
    outputs: Sequence[ModelOutputs], rules: DecisionRules, permille: int
) -> list[BoolArray]:
    """[T] a stream: whether an act is requested, from a confidence on."""
    return requests_at([one.answers for one in outputs], rules, permille)
