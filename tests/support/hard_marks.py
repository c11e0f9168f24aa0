"""The hard cases of filter, forest and metrics by name, each with what happens elsewhere and what
happens here.

@SILENCE.mark
def test_silence_ends_in_exact_zeros(): ...

@SILENCE.unguarded
def test_a_plain_filter_is_still_busy_ten_minutes_later(): ...
"""

from __future__ import annotations

from dataclasses import dataclass

import pytest


@dataclass(frozen=True)
class HardCase:
    """A line of the catalogue (tests/support/hard_cases.py)."""

    area: str
    case: str
    elsewhere: str
    here: str

    @property
    def mark(self) -> pytest.MarkDecorator:
        """For a test of the guard."""
        return self._marked(unguarded=False)

    @property
    def unguarded(self) -> pytest.MarkDecorator:
        """For a test that takes the guard away."""
        return self._marked(unguarded=True)

    def _marked(self, *, unguarded: bool) -> pytest.MarkDecorator:
        return pytest.mark.hard_case(
            self.area,
            self.case,
            elsewhere=self.elsewhere,
            here=self.here,
            unguarded=unguarded,
        )


FILTER, FOREST, METRICS = (
    "Filter and features",
    "Forest and ONNX",
    "Calibration and metrics",
)

POLE = HardCase(
    FILTER,
    "the differentiator's pole at -1",
    "the bilinear differentiator rings for ever at half the rate",
    "differentiator and low-pass are one stable section",
)
LONG = HardCase(
    FILTER,
    "a hundred million samples",
    "in a cascade every rounding error of the differentiator is summed up for good",
    "no pole on the circle; error against 64-bit mantissas does not grow",
)
OFFSET = HardCase(
    FILTER,
    "a large offset",
    "a filter that starts at zero rings with its own offset, and a second later "
    "still louder than the slip",
    "only differences enter the bank, and it starts at rest",
)
SILENCE = HardCase(
    FILTER,
    "ten minutes of silence",
    "a filter's memory ends in subnormal numbers, which never leave and cost more than zeros do",
    "memory below 1e-30 is zero",
)
SUBNORMAL = HardCase(
    FILTER,
    "subnormal inputs",
    "they circulate in the filter as they came",
    "they are zero to the bank at once",
)
BAD_SAMPLE = HardCase(
    FILTER,
    "one bad sample",
    "one NaN or inf stays in a recursive filter for ever, and 1e30 for thousands of samples",
    "that finger alone is held, says so, and goes on one sample later",
)
GAPS = HardCase(
    FILTER,
    "jitter and gaps",
    "what moved during a gap is a jump, and a jump is a slip to a filter",
    "samples that never came are lost samples; a jitter of half a period changes no bit",
)
RATES = HardCase(
    FILTER,
    "rates from 40 Hz to 10 kHz",
    "prewarped next to half the rate, a band rings for half a minute",
    "bands from 0.46 of the rate on are left out",
)
FLOATS = HardCase(
    FILTER,
    "float32 and float64",
    "float32 is enough at 150 Hz and wrong at 10 kHz",
    "state and filter are float64 at every rate",
)
NORMAL = HardCase(
    FILTER,
    "no normal force, or a negative one",
    "the ratio of shear to normal explodes, or changes its sign",
    "no ratio is taken over less than a floor",
)
DEAD = HardCase(
    FILTER,
    "a dead hand, and one dead finger",
    "exact zeros look like the calmest of grasps to a forest that has only seen noise",
    "a hand that repeats itself to the last bit for half a second is unknown",
)
DEGENERATE = HardCase(
    FILTER,
    "all fingers equal, all components degenerate",
    "standardised principal components divide by zero and have an arbitrary sign",
    "no component and no scale is taken from the trial",
)
SIGN = HardCase(
    FILTER,
    "sign flips",
    "a magnet is turned round because noise was negative",
    "only a resting normal beyond the noise turns one",
)
MILLION = HardCase(
    FOREST,
    "a million adversarial rows",
    "a converted forest differs where a row stands on a threshold, or where two "
    "classes have equal votes",
    "votes and labels are the reference's on every row, alone or in a batch",
)
TIES = HardCase(
    FOREST,
    "exact ties",
    "probabilities are sums of float32 hundredths, each thread's on its own, and "
    "rounding decides a tie",
    "votes are integers, and the riskier class wins a tie",
)
EXACT = HardCase(
    FOREST,
    "votes that sum exactly",
    "a hundred float32 hundredths are not one, and their sum depends on the order of the trees",
    "every leaf's votes are integers that sum to a power of two, all trees together "
    "to less than 2^24",
)
MISSING = HardCase(
    FOREST,
    "a dead sensor before the forest",
    "NaN goes the wrong way in a converted tree, and inf is answered",
    "neither can pass the guard in front of the trees",
)
SMALL = HardCase(
    FOREST,
    "a forest of one tree, one class, one node",
    "the label of the only class comes out as another number",
    "it is exported like any other",
)
GOLDEN = HardCase(
    FOREST,
    "a runtime or a file that answers differently",
    "it opens without an error, and its answers are used",
    "golden sequences are replayed at load, and a difference is an error",
)
CERTAIN = HardCase(
    METRICS,
    "probabilities of 0 and 1",
    "a probability of 0 for what did happen has an infinite log loss; a naive softmax overflows",
    "calibrated probabilities of finite votes are finite, above 0, and sum to 1",
)
ABSENT = HardCase(
    METRICS,
    "absent classes",
    "a class that is not there scores 0 and pulls the mean down",
    "it has no figure and does not count",
)
EMPTY = HardCase(
    METRICS,
    "empty folds, and no window at all",
    "the mean of nothing, a crash, or a zero that looks like a figure",
    "a figure of nothing is None, and a fold may hold out nothing",
)
FOREIGN = HardCase(
    METRICS,
    "labels and scores that cannot be",
    "a prediction of -1 is counted as some other class' answer",
    "it is refused, with the number in the message",
)
EVENTS = HardCase(
    METRICS,
    "one event, and alarms that are on already",
    "an alarm that is always on catches everything",
    "an alarm counts when it begins: one that is on already catches nothing and is false",
)
COLLAR = HardCase(
    METRICS,
    "two events inside one collar",
    "one slip that crosses a threshold again and again is many events",
    "what follows within the collar is one",
)
SINGULAR = HardCase(
    METRICS,
    "calibrations that are singular",
    "a matrix without full rank reads some loads as a calm zero, for ever",
    "it is refused, and the sensor named",
)
VERSIONS = HardCase(
    FOREST,
    "versions known to be wrong",
    "onnxruntime 1.26.0 mislabels binary forests, and 1.21.0 crashes on a small board",
    "both are refused by name, and never installed",
)
