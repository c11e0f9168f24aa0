"""`monitor.replay` and `open_hand` in a program of one's own: arrays in, arrays out."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import holdfast
from holdfast.core.contract import CLASSES, SITUATIONS, FloatArray
from holdfast.core.trial_file import read_trial
from holdfast.drivers.calibration import Bias, write_bias
from holdfast.drivers.replay import open_replay
from holdfast.edge_runtime.monitor import GripMonitor, Model

if TYPE_CHECKING:
    from conftest import Built

TRIAL = "empty-bottle/pull/trial_1.csv"


@pytest.fixture(scope="module")
def monitor(eight_classes: Built) -> GripMonitor:
    return holdfast.load(eight_classes.model)


@pytest.fixture(scope="module")
def trial(eight_classes: Built) -> tuple[FloatArray, FloatArray]:
    """(values [T, C], t_s [T]) as recorded."""
    read = read_trial(eight_classes.fixture / TRIAL)
    return read.raw, read.t_s


def answered(monitor: GripMonitor, values: Any, t_s: Any = None, **options: Any) -> Any:
    """The arrays that must be equal where the answers are."""
    answers = monitor.replay(values, t_s, **options)
    return [
        answers.state.tolist(),
        answers.why.tolist(),
        answers.p_situation.tolist(),
        answers.act.tolist(),
    ]


def test_a_whole_recording_is_answered_as_sample_after_sample(
    eight_classes: Built, monitor: GripMonitor, trial: tuple[FloatArray, FloatArray]
) -> None:
    one_by_one = GripMonitor(Model(eight_classes.model), None)
    source = open_replay(eight_classes.fixture / TRIAL)
    samples = source.prepared(monitor.card.preparation)
    fed = [one_by_one.feed(sample) for sample in samples]

    answers = monitor.replay(*trial)

    assert answers.state.tolist() == [one.state for one in fed]
    assert answers.why.tolist() == [one.why for one in fed]
    assert answers.p_risky.tolist() == [one.p_risky for one in fed]
    assert answers.weight.tolist() == [one.weight or "" for one in fed]
    assert answers.arm.tolist() == [one.arm for one in fed]
    assert answers.act.tolist() == [one.act for one in fed]
    assert answers.settled.tolist() == [one.settled for one in fed]
    assert answers.model_id == fed[0].model_id
    for column, name in enumerate(SITUATIONS):
        expected = [one.p_situation[name] for one in fed]
        assert answers.p_situation[:, column].tolist() == expected
    for column, name in enumerate(CLASSES):
        known = [one.p_class[name] if one.p_class else np.nan for one in fed]
        np.testing.assert_array_equal(answers.p_class[:, column], known)
    assert set(answers.detectors) == set(fed[0].detectors)


def test_a_live_monitor_calls_no_answer_of_a_recording_late(
    monitor: GripMonitor, trial: tuple[FloatArray, FloatArray]
) -> None:
    answers = monitor.replay(*trial)
    assert set(answers.why) <= {"", "settling"}
    assert (answers.state == "risky_slip").any()


def test_samples_of_a_recording_that_are_fed_to_a_live_monitor_bring_a_hint(
    eight_classes: Built,
) -> None:
    """They carry times from zero, and the monitor's clock counts from the start of the machine."""
    live = GripMonitor(Model(eight_classes.model), lambda: 3_600_000_000_000)
    sample = next(iter(open_replay(eight_classes.fixture / TRIAL)))
    with pytest.warns(UserWarning, match=r"monitor\.replay\(values, t_s\)"):
        answer = live.feed(sample)
    assert (answer.state, answer.late) == ("unknown", True)


def test_a_replay_does_not_disturb_the_stream_that_is_fed(
    eight_classes: Built, trial: tuple[FloatArray, FloatArray]
) -> None:
    def fed(between: bool) -> list[float]:
        one = holdfast.load(eight_classes.model, live=False)
        out = []
        for index, sample in enumerate(open_replay(eight_classes.fixture / TRIAL)):
            if between and index == 40:
                one.replay(*trial)
            out.append(one.feed(sample).p_risky)
        return out

    assert fed(between=True) == fed(between=False)


def test_a_bias_that_is_given_counts_in_place_of_the_first_rows(
    monitor: GripMonitor, trial: tuple[FloatArray, FloatArray]
) -> None:
    values, t_s = trial
    tared = monitor.replay(values, t_s)
    middle = int(np.argmax(tared.state == "grasp"))
    offset = np.linspace(0.1, 0.5, values.shape[1])

    shifted = monitor.replay(
        1e3 * (tared.values + offset)[middle:],
        t_s[middle:],
        unit="mN",
        bias=1e3 * offset,
    )
    removed = monitor.replay(tared.values[middle:], t_s[middle:], bias=0)

    np.testing.assert_allclose(shifted.values, tared.values[middle:], atol=1e-9)
    np.testing.assert_array_equal(removed.values, tared.values[middle:])


def test_without_times_the_rows_have_the_models_rate(
    monitor: GripMonitor, trial: tuple[FloatArray, FloatArray]
) -> None:
    values, _ = trial
    even_s = np.arange(len(values)) / monitor.card.rate_hz
    assert answered(monitor, values) == answered(monitor, values, even_s)
    # from any zero, such as that of Unix time
    np.testing.assert_array_equal(
        monitor.replay(values, even_s + 1.7e9).state, monitor.replay(values).state
    )


def test_a_sensor_without_a_number_is_not_valid(
    monitor: GripMonitor, trial: tuple[FloatArray, FloatArray]
) -> None:
    values, t_s = trial
    holes = values.copy()
    holes[60:90, 4] = np.nan
    flags = np.ones((len(values), values.shape[1] // 3), dtype=bool)
    flags[60:90, 1] = False
    assert not monitor.replay(holes, t_s).valid[60:90, 1].any()
    assert answered(monitor, holes, t_s) == answered(monitor, values, t_s, valid=flags)


@pytest.mark.parametrize(
    ("change", "error", "says"),
    [
        ({"t_s": lambda t: 1e3 * t}, "RateError", "look like milliseconds"),
        ({"t_s": lambda t: 2.0 * t}, "RateError", "the model needs"),
        ({"t_s": lambda t: t[::-1]}, "TimeError", "at row 1"),
        ({"t_s": lambda t: t // 0.1}, "TimeError", "have the time of the row before"),
        ({"t_s": lambda t: t[:-1]}, "TimeError", "one time a row"),
        ({"t_s": lambda t: np.append(t[:-1], np.nan)}, "TimeError", "at row"),
        ({"values": lambda v: v[:, 1:]}, "ChannelError", "needs [T, 18]"),
        ({"bias": [0.0] * 17 + [np.nan]}, "ChannelError", "18] finite numbers"),
        ({"values": lambda v: v.T}, "ChannelError", "rows and columns swapped"),
        ({"values": lambda v: v[:1]}, "ChannelError", "from 2 on"),
        ({"unit": "uT"}, "UnitError", "the model needs N"),
        ({"valid": [True]}, "ChannelError", "valid of shape (1,)"),
    ],
)
def test_arrays_that_do_not_fit_are_refused_with_the_next_step(
    monitor: GripMonitor,
    trial: tuple[FloatArray, FloatArray],
    change: dict[str, Any],
    error: str,
    says: str,
) -> None:
    arrays: dict[str, Any] = {"values": trial[0], "t_s": trial[1]}
    for name, value in change.items():
        arrays[name] = value(arrays[name]) if callable(value) else value
    with pytest.raises(getattr(holdfast.errors, error), match=re.escape(says)):
        monitor.replay(**arrays)


def test_a_stored_bias_lets_a_program_begin_with_an_object_in_the_hand(
    eight_classes: Built, tmp_path: Path
) -> None:
    recording = str(eight_classes.fixture / TRIAL)
    first = read_trial(recording).raw[0]
    stored = tmp_path / "bias.json"
    n_sensors = len(first) // 3
    write_bias(
        stored,
        Bias(first, np.full(len(first), 0.01), 300, "N", np.zeros(n_sensors, bool)),
    )
    monitor = holdfast.load(eight_classes.model, bias_known=True)
    with holdfast.open_hand(recording, bias=stored) as hand:
        samples = list(hand.samples(monitor, seconds=0.1))
    numbers = [sample.sequence for sample in samples]
    assert numbers[0] == 0
    # a busy machine skips some
    assert set(numbers) <= {0, 1, 2, 3, 4}
    # the first row already has its bias, and no sensor waits for one
    assert all(sample.valid.all() for sample in samples)
    np.testing.assert_allclose(samples[0].values, 0.0, atol=1e-12)
