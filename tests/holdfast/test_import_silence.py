"""`holdfast import` is never wrong in silence: what no log says and no value shows is asked."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_line import Run, imported
from foreign_logs import Made, axes, made, write_log, write_text

from holdfast.core.trial_file import read_trial
from holdfast.interop.beside import paired
from holdfast.interop.formats.layout import layout_of
from holdfast.interop.labels import (
    action_of_sentence,
    action_of_word,
    situation_of_word,
)

SLIP = ("--action", "slip")
TWO = [f"P{k}_F{a}" for k in (0, 1) for a in "XYZ"]


def raw(tmp_path: Path, place: str = "object/slip/trial_1") -> np.ndarray:
    return read_trial(tmp_path / f"set/{place}.csv").raw


def press(values: np.ndarray) -> float:
    """The usual normal reading of the first sensor in contact."""
    return float(np.median(values[150:250, 2]))


def two_sensors(seed: int = 1) -> Made:
    return made(seed, sensors=2)


# -- tables beside logs


PLACES = {
    "a word": ("trial_{k}_motion", "trial_{k}_events"),
    "a folder": ("trial_{k}/force", "trial_{k}/events"),
    "two folders": ("data/x{k}", "labels/x{k}"),
    "other words": ("cup_{k}_3N", "cup_{k}_marks"),
}


@pytest.mark.parametrize("place", PLACES)
def test_each_table_of_events_is_that_of_the_log_beside_it(
    run: Run, tmp_path: Path, place: str
) -> None:
    log, table = PLACES[place]
    for k, slip in ((1, "3.0,0.5,slip\n"), (2, ""), (3, "3.5,0.5,slip\n")):
        write_log(tmp_path / f"logs/{log.format(k=k)}.csv", made(k))
        path = tmp_path / f"logs/{table.format(k=k)}.csv"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"onset,duration,trial_type\n1.0,3.0,grasp\n{slip}")
    assert "3 trials: 2 slip, 1 hold" in imported(run, tmp_path)
    truths = sorted((tmp_path / "set/").rglob("slip/*.truth.json"))
    phases = [json.loads(truth.read_text())["phases"] for truth in truths]
    begins = [p["t0_s"] for of in phases for p in of if p["label"] == "risky_slip"]
    assert begins == [3.0, 3.5]


def test_a_table_that_pairs_with_no_log_is_named_and_a_log_without_one_is_refused(
    run: Run, tmp_path: Path
) -> None:
    for k in (1, 2):
        write_log(tmp_path / f"logs/trial_{k}_motion.csv", made(k))
        text = "start,end,label\n3.0,3.5,slip\n"
        (tmp_path / f"logs/trial_{k + 1}_events.csv").write_text(text)
    out = imported(run, tmp_path, code=3)
    assert "nothing says what happens in trial_1_motion" in out
    out = imported(run, tmp_path, *SLIP)
    assert "not used   trial_3_events.csv (columns start, end, label)" in out


def test_rows_of_another_clock_are_no_times(run: Run, tmp_path: Path) -> None:
    write_log(tmp_path / "logs/t1.csv", made(1))
    # of a camera, which has 30 a second
    (tmp_path / "logs/t1_events.csv").write_text("frame,event\n30,grasp\n90,slip\n")
    asked = imported(run, tmp_path, code=2)
    assert "events*.csv (columns frame, event)" in asked


def test_pairs_are_alike_but_for_one_word() -> None:
    assert paired(["a_1", "a_2"], ["a_1_events", "a_2_events"]) == {
        "a_1": "a_1_events",
        "a_2": "a_2_events",
    }
    assert paired(["cup_1", "mug_1"], ["events"]) == {}
    assert paired(["trial_1_motion"], ["trial_2_events"]) == {}


# -- clocks


@pytest.mark.parametrize(
    ("name", "codes", "lasts_s"),
    [
        ("trial", np.arange(600) // 200, 200 / 150),
        ("battery", np.arange(600) // 100, 4.0),
        ("packet", np.arange(600) % 256, 4.0),
        ("sample", np.arange(600) % 100, 4.0),
        ("temperature", 20.0 + 0.01 * np.arange(600), 4.0),
    ],
)
def test_the_rate_that_is_given_wins_over_any_column(
    run: Run, tmp_path: Path, name: str, codes: np.ndarray, lasts_s: float
) -> None:
    one = made(1, lasts_s=6.0)
    names = [*axes(5), name]
    write_text(tmp_path / "logs/a.csv", names, np.column_stack([one.values, codes]))
    assert "how many rows a second" in imported(run, tmp_path, *SLIP, code=2)
    imported(run, tmp_path, *SLIP, "--rate", 150)
    trial = read_trial(tmp_path / "set/object/slip/trial_1.csv")
    assert trial.rate_hz == pytest.approx(150.0, rel=1e-3)
    assert trial.t_s[-1] == pytest.approx(lasts_s - 1 / 150, abs=0.01)
    np.testing.assert_allclose(trial.raw, one.values[: len(trial.raw)])


def test_another_quantity_that_stands_first_is_no_clock(
    run: Run, tmp_path: Path
) -> None:
    one = made(1)
    rows = np.column_stack([0.05 * np.arange(500), one.values])
    write_text(tmp_path / "logs/a.csv", ["motor_deg", *axes(5)], rows)
    assert "how many rows a second" in imported(run, tmp_path, *SLIP, code=2)


@pytest.mark.parametrize(
    "name", ["Time (min)", "elapsedMinutes", "t [ticks]", "clock_angle", "time_100us"]
)
def test_a_time_in_another_unit_is_asked(run: Run, tmp_path: Path, name: str) -> None:
    write_log(tmp_path / "logs/a.csv", two_sensors(), names=[name, *TWO])
    assert "how many rows a second" in imported(run, tmp_path, *SLIP, code=2)


def test_the_time_that_is_left_is_no_clock(run: Run, tmp_path: Path) -> None:
    one = two_sensors()
    rows = np.column_stack([5.0 - one.t_s, one.t_s, one.values])
    write_text(tmp_path / "logs/a.csv", ["time_left_s", "time", *TWO], rows)
    imported(run, tmp_path, *SLIP)
    np.testing.assert_allclose(raw(tmp_path), one.values)


def test_a_clock_that_contradicts_the_rate_of_the_head_is_asked(
    run: Run, tmp_path: Path
) -> None:
    path = write_log(tmp_path / "logs/a.csv", two_sensors(), names=["time", *TWO])
    path.write_text(f"# camera sampling rate: 30 Hz\n{path.read_text()}")
    assert "how many rows a second" in imported(run, tmp_path, *SLIP, code=2)


@pytest.mark.parametrize("units", [1_000, 1_000_000])
def test_whole_milliseconds_and_microseconds_since_1970_are_a_clock(
    run: Run, tmp_path: Path, units: int
) -> None:
    one = two_sensors()
    stamps = [f"{1_700_000_000 * units + k * units // 100}" for k in range(500)]
    names = ["timestamp", *TWO]
    write_text(tmp_path / "logs/a.csv", names, one.values, first=stamps)
    assert "timestamp, 100 Hz" in imported(run, tmp_path, *SLIP)


# -- rows


@pytest.mark.parametrize("both_in_each", [501, 50])
def test_a_row_for_each_message_of_any_topic_is_refused(
    run: Run, tmp_path: Path, both_in_each: int
) -> None:
    one = two_sensors()
    lines = []
    for k, row in enumerate(one.values.tolist(), 1):
        cells, t_s = [f"{value:.4f}" for value in row], k / 100
        both = cells[3:] if k % both_in_each == 0 else ["", "", ""]
        lines.append((t_s, ",".join([f"{t_s:.4f}", *cells[:3], *both])))
        later = t_s + 0.003
        lines.append((later, ",".join([f"{later:.4f}", "", "", "", *cells[3:]])))
    hands = ("left", "right")
    names = "t," + ",".join(f"/ft_{k}/force/{a}" for k in hands for a in "xyz")
    (tmp_path / "logs").mkdir()
    text = "\n".join([names, *(line for _, line in sorted(lines))])
    (tmp_path / "logs/a.csv").write_text(text + "\n")
    assert "no row has all sensors" in imported(run, tmp_path, *SLIP, code=3)


@pytest.mark.parametrize("own_ms", [0.0, 1.0])
def test_a_row_for_each_sensor_is_asked(
    run: Run, tmp_path: Path, own_ms: float
) -> None:
    one = made(1)
    times = 1e3 * np.repeat(one.t_s, 5) + own_ms * np.tile(range(5), len(one.t_s))
    rows = np.column_stack([times, np.tile(range(5), 500), one.values.reshape(-1, 3)])
    write_text(tmp_path / "logs/a.csv", ["ms", "module", *"xyz"], rows)
    question = "each row of a is of one module that comes in turn"
    assert question in imported(run, tmp_path, *SLIP, code=2)
    # columns that are given do not make a sensor of them
    given = ("--sensors", "x,y,z")
    assert question in imported(run, tmp_path, *SLIP, *given, code=2)


@pytest.mark.parametrize("words", [("A", "B"), ("1", "2")])
@pytest.mark.parametrize("in_a_row", [1, 16, 500])
def test_a_row_for_each_board_is_asked(
    run: Run, tmp_path: Path, words: tuple[str, str], in_a_row: int
) -> None:
    one = made(1, sensors=4)
    rows = np.column_stack([np.repeat(one.t_s, 2), one.values.reshape(-1, 6)])
    order = sorted(range(1000), key=lambda k: (k // 2 // in_a_row, k % 2))
    boards = [words[k % 2] for k in order]
    write_text(
        tmp_path / "logs/a.csv", ["time", *TWO, "board"], rows[order], texts=boards
    )
    question = "each row of a is of one board that comes in turn"
    assert question in imported(run, tmp_path, *SLIP, code=2)


def test_texts_of_which_none_comes_again_are_no_boards(
    run: Run, tmp_path: Path
) -> None:
    one = two_sensors()
    rows = np.column_stack([one.t_s, one.values])[60:150]
    notes = [f"row {k}" for k in range(90)]
    write_text(tmp_path / "logs/a.csv", ["time", *TWO, "note"], rows, texts=notes)
    assert "1 trial: 1 slip" in imported(run, tmp_path, *SLIP)


def test_a_row_for_each_value_is_asked_for_another_form(
    run: Run, tmp_path: Path
) -> None:
    one = two_sensors()
    rows = np.column_stack([np.repeat(one.t_s, 6), one.values.ravel()])
    names = ["time", "value", "channel"]
    write_text(tmp_path / "logs/a.csv", names, rows, texts=TWO * 500)
    given = (*SLIP, "--sensors", "value")
    asked = imported(run, tmp_path, *given, code=2)
    assert "of one channel that comes in turn: write a row for each time" in asked


def test_a_log_that_holds_itself_twice_is_asked(run: Run, tmp_path: Path) -> None:
    one = two_sensors()
    rows = np.tile(np.column_stack([one.t_s, one.values]), (2, 1))
    write_text(tmp_path / "logs/a.csv", ["time", *TWO], rows)
    asked = imported(run, tmp_path, *SLIP, code=2)
    assert "rows of a stand there twice: take them out" in asked


def test_rows_of_another_topic_alone_are_no_samples(run: Run, tmp_path: Path) -> None:
    one = two_sensors()
    path = write_log(
        tmp_path / "logs/a.csv", one, names=["t", *TWO, "volt"], texts=[""] * 500
    )
    head, *lines = path.read_text().splitlines()
    for k in range(450, 0, -50):
        lines.insert(k, f"{one.t_s[k - 1] + 0.004:.3f},,,,,,,12.{k}")
    path.write_text("\n".join([head, *lines]) + "\n")
    assert "9 rows of no sensor left out" in imported(run, tmp_path, *SLIP)
    np.testing.assert_allclose(raw(tmp_path), one.values)


def test_a_text_that_flickers_beside_readings_is_no_board(
    run: Run, tmp_path: Path
) -> None:
    one = made(1)
    texts = np.random.default_rng(0).choice(["OK", "RETRY"], len(one.t_s), p=[0.8, 0.2])
    names = ["t", *axes(5), "radio"]
    write_log(tmp_path / "logs/cup_slip_1.csv", one, names=names, texts=texts.tolist())
    assert "not used   radio" in imported(run, tmp_path)


def test_rows_twice_are_rows_once(run: Run, tmp_path: Path) -> None:
    one = two_sensors()
    twice = np.repeat(np.column_stack([one.t_s, one.values]), 2, axis=0)
    write_text(tmp_path / "logs/a.csv", ["time", *TWO], twice)
    assert "500 rows left out that the one before repeats" in imported(
        run, tmp_path, *SLIP
    )
    np.testing.assert_allclose(raw(tmp_path), one.values)


def test_of_values_that_stay_for_several_rows_one_is_kept(
    run: Run, tmp_path: Path
) -> None:
    one = two_sensors()
    t_s = np.arange(1500) / 300.0
    rows = np.column_stack([t_s, np.repeat(one.values, 3, axis=0)])
    write_text(tmp_path / "logs/a.csv", ["time", *TWO], rows)
    assert "each value stands in 3 rows" in imported(run, tmp_path, *SLIP)
    trial = read_trial(tmp_path / "set/object/slip/trial_1.csv")
    assert trial.rate_hz == pytest.approx(100.0)


@pytest.mark.parametrize("first", [3, 0])
def test_zeros_of_a_sensor_in_a_press_are_lost(
    run: Run, tmp_path: Path, first: int
) -> None:
    one = two_sensors()
    one.values[200:220, first:] = 0.0
    write_log(tmp_path / "logs/a.csv", one, names=["t", *TWO])
    out = imported(run, tmp_path, *SLIP)
    lost = "is 0 in a press, or repeats one reading, in 20 rows: lost"
    assert (f"sensor 1 {lost}" in out, f"sensor 2 {lost}" in out) == (not first, True)
    assert np.isnan(raw(tmp_path)[200:220, first:]).all()


@pytest.mark.parametrize("code", [-9999.0, 999.99])
def test_one_large_value_on_all_axes_stands_for_none(
    run: Run, tmp_path: Path, code: float
) -> None:
    one = two_sensors()
    one.values[200:220, 3:] = code
    write_log(tmp_path / "logs/a.csv", one, names=["t", *TWO])
    assert "missing    samples of P1_FX: 20" in imported(run, tmp_path, *SLIP)
    assert np.isnan(raw(tmp_path)[200:220, 3:]).all()


@pytest.mark.parametrize("rows_a_value", [2.5, 500.0])
def test_a_sensor_that_repeats_its_reading_more_than_another_is_named(
    run: Run, tmp_path: Path, rows_a_value: float
) -> None:
    one = two_sensors()
    rows = (np.arange(500) // rows_a_value * rows_a_value).astype(int)
    one.values[:, 3:] = one.values[rows, 3:]
    write_log(tmp_path / "logs/a.csv", one, names=["t", *TWO])
    assert "sensor 2 repeats its reading in" in imported(run, tmp_path, *SLIP)


def test_a_sensor_that_was_tared_in_a_press_is_doubted(
    run: Run, tmp_path: Path
) -> None:
    one = two_sensors()
    one.values[200:, 2] -= 3.0
    write_log(tmp_path / "logs/a.csv", one, names=["t", *TWO])
    doubt = "sensor 1 reads as far below zero as a press is above it"
    assert doubt in imported(run, tmp_path, *SLIP)
    assert "sensor 2" not in run("check", tmp_path / "set")[1]


def test_an_empty_cell_of_a_column_of_numbers_never_stops_an_import(
    run: Run, tmp_path: Path
) -> None:
    one = two_sensors()
    flags = [str(k) for k in np.random.default_rng(0).integers(0, 60, 500)]
    flags[250] = ""
    write_log(tmp_path / "logs/a.csv", one, names=["t", *TWO, "status"], texts=flags)
    imported(run, tmp_path, *SLIP)
    np.testing.assert_allclose(raw(tmp_path), one.values)


def test_an_empty_cell_ends_no_trial_and_is_no_label(run: Run, tmp_path: Path) -> None:
    one = two_sensors()
    slips = one.words("0", "0", "1")
    texts = [f"{k // 250},{slip}" for k, slip in enumerate(slips)]
    texts[120] = ",0"
    texts[130] = "0,"
    names = ["t", *TWO, "trial", "slip"]
    write_log(tmp_path / "logs/a.csv", one, names=names, texts=texts)
    assert "2 trials: 1 hold, 1 slip" in imported(run, tmp_path)
    assert len(raw(tmp_path, "object/hold/trial_1")) == 250


def test_lines_between_rows_and_a_second_block_are_named(
    run: Run, tmp_path: Path
) -> None:
    one = two_sensors()
    path = write_log(tmp_path / "logs/a.csv", one, names=["t", *TWO])
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:301], "#T,3000,slip", *lines[301:]]))
    out = imported(run, tmp_path, *SLIP)
    assert "1 line between the rows left out, such as '#T,3000,slip'" in out
    np.testing.assert_allclose(raw(tmp_path), one.values)
    block = ["", "Trajectories", "100", "Frame,X,Y,Z", "1,2,3,4"]
    path.write_text("\n".join([*lines, *block]))
    out = imported(run, tmp_path, *SLIP, out="again")
    assert "4 lines of a second block left out, such as 'Trajectories'" in out
    again = read_trial(tmp_path / "again/object/slip/trial_1.csv").raw
    np.testing.assert_allclose(again, one.values)


def labview(one: Made, segments: int, comment: str, clock: np.ndarray) -> str:
    """A measurement file; comment: what ends a row, whose last name is Comment."""
    channels = "\t".join(TWO)
    of_each = {"Samples": "100", "Y_Unit_Label": "N", "X_Dimension": "Time", "X0": "0"}
    of_each |= {"Date": "2024/05/03", "Time": "10:11:12.345", "Delta_X": "0.010000"}
    lines = ["LabVIEW Measurement\t", "***End_of_Header***\t"]
    rows = np.column_stack([clock, one.values]).tolist()
    for segment in np.array_split(np.arange(len(rows)), segments):
        lines += ["", "Channels\t6" + "\t" * 6]
        lines += ["\t".join([key, *[cell] * 6]) for key, cell in of_each.items()]
        lines += ["***End_of_Header***\t", f"X_Value\t{channels}\tComment"]
        lines += ["\t".join(f"{x:.4f}" for x in rows[k]) + comment for k in segment]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(("segments", "comment"), [(1, ""), (1, "\t"), (5, "\t")])
def test_all_segments_of_a_measurement_of_labview_are_one_log_with_its_names(
    run: Run, tmp_path: Path, segments: int, comment: str
) -> None:
    one = two_sensors()
    (tmp_path / "logs").mkdir()
    text = labview(one, segments, comment, one.t_s)
    (tmp_path / "logs/a.lvm").write_text(text)
    out = imported(run, tmp_path, *SLIP)
    assert "X_Value [s], 100 Hz" in out
    assert "P0_FX" in out
    assert ("40 lines between the rows left out" in out) == (segments == 5)
    np.testing.assert_allclose(raw(tmp_path), one.values)


def test_a_segment_of_labview_whose_clock_begins_anew_is_a_trial_of_its_own(
    run: Run, tmp_path: Path
) -> None:
    one = two_sensors()
    (tmp_path / "logs").mkdir()
    text = labview(one, 2, "\t", one.t_s % 2.5)
    (tmp_path / "logs/a.lvm").write_text(text)
    out = imported(run, tmp_path, *SLIP)
    assert "a new trial" in out
    assert "2 trials" in out


HEADS = {
    "vicon": "Devices\n1000\n",
    "a period": "# Sample rate (ms): 1\n",
    "a period behind": "# Sampling interval = 1 [ms]\n",
    "a period of 0": "# Sample rate: 1000 Hz\n# Sampling interval: 0 ms\n",
    "qualisys": "NO_OF_CAMERAS\t8\nFREQUENCY\t1000\nANALOG_FREQUENCY\t0\n",
    "labview": "LabVIEW Measurement\t\nDelta_X\t0.001\n***End_of_Header***\n",
}


@pytest.mark.parametrize("head", HEADS)
def test_the_head_of_another_tools_file_gives_the_rate(
    run: Run, tmp_path: Path, head: str
) -> None:
    one = two_sensors()
    write_text(tmp_path / "logs/a.csv", TWO, one.values, head=HEADS[head])
    assert "1000 Hz, by the head of the log" in imported(run, tmp_path, *SLIP)


def test_a_clock_without_a_unit_has_the_rate_of_the_head_and_keeps_its_gaps(
    run: Run, tmp_path: Path
) -> None:
    one = made(1, sensors=2)
    kept = np.r_[0:200, 240:500]
    rows = np.column_stack([1e3 * one.t_s, one.values])[kept]
    head = "# Sampling rate: 100 Hz\n"
    write_text(tmp_path / "logs/a.csv", ["Time", *axes(2)], rows, head=head)
    out = imported(run, tmp_path, *SLIP)
    assert "in ms, as fast as the head of the log says" in out
    assert "gaps       1 of 0.41 to 0.41 s" in out


def test_counts_that_went_over_their_end_are_named_and_unwrapped_on_request(
    run: Run, tmp_path: Path
) -> None:
    one = two_sensors()
    counts = np.round(100.0 * one.values)
    counts[:, 2::3] = np.interp(one.t_s, [1.0, 2.0, 3.0, 4.0], [0, 45_000, 45_000, 0])[
        :, None
    ]
    counts[:, 2::3] += np.round(100.0 * one.values[:, :2])
    counts = np.round(counts)
    # what is missing hides nothing behind it
    counts[20, 2] = np.nan
    over = (counts + 32_768) % 65_536 - 32_768
    write_log(tmp_path / "logs/a.csv", one, over, ["t", *TWO])
    words = (*SLIP, "--unit", "count")
    assert "by 2^16: --unwrap takes them out" in imported(run, tmp_path, *words)
    imported(run, tmp_path, *words, "--unwrap", out="again")
    again = read_trial(tmp_path / "again/object/slip/trial_1.csv").raw
    np.testing.assert_allclose(again, counts)


# -- units


LBF = 4.4482216152605


@pytest.mark.parametrize(
    ("form", "newtons"),
    [
        ("{}(lbf)", LBF), ("{} [pounds-force]", LBF), ("{} (lb-f)", LBF),
        ("{} (g force)", 9.80665e-3), ("{} [milli-Newton]", 1e-3), ("{} [lbf] (filtered)", LBF),
        ("{} (raw) [N]", 1.0), ("{}_lbf_tip", LBF), ("cN_{}", 1e-2),
    ],
)  # fmt: skip
def test_a_unit_is_known_as_a_whole_wherever_it_stands(
    run: Run, tmp_path: Path, form: str, newtons: float
) -> None:
    one = two_sensors()
    names = ["time(s)", *map(form.format, TWO)]
    write_log(tmp_path / "logs/a.csv", one, one.values / newtons, names)
    imported(run, tmp_path, *SLIP)
    np.testing.assert_allclose(raw(tmp_path), one.values, atol=1e-6)


@pytest.mark.parametrize("place", ["cup_1", "cup_1_lbf", "cup_1.json"])
def test_a_unit_beside_the_readings_is_theirs(
    run: Run, tmp_path: Path, place: str
) -> None:
    one = two_sensors()
    path = tmp_path / f"logs/{place.removesuffix('.json')}.csv"
    names, units = ["t", *TWO], None
    if place == "cup_1":
        names, units = [*names, "unit"], ["lbf"] * 500
    write_log(path, one, one.values / LBF, names, texts=units)
    if place == "cup_1.json":
        facts = {"force_unit": "lbf", "mass_unit": "kg"}
        (tmp_path / "logs" / place).write_text(json.dumps(facts))
    imported(run, tmp_path, *SLIP)
    np.testing.assert_allclose(raw(tmp_path, "cup/slip/trial_1"), one.values, atol=1e-6)


def test_logs_that_say_two_units_are_asked(run: Run, tmp_path: Path) -> None:
    for k, unit in enumerate(("lbf", "mN"), 1):
        write_log(tmp_path / f"logs/cup_{k}_{unit}.csv", two_sensors())
    assert "not the same in all logs" in imported(run, tmp_path, *SLIP, code=2)


@pytest.mark.parametrize(
    "form", ["{} [V]", "{} (kPa)", "{}_psi", "{} [%]", "{} [-]", "{} [mN/count]"]
)
def test_a_unit_that_nobody_knows_is_asked(run: Run, tmp_path: Path, form: str) -> None:
    names = ["t", *map(form.format, TWO)]
    write_log(tmp_path / "logs/a.csv", two_sensors(), names=names)
    assert "what unit have the readings (the log says" in imported(
        run, tmp_path, *SLIP, code=2
    )


@pytest.mark.parametrize(
    ("head", "says"),
    [
        ("# Force unit: lbf\n", "lbf, lbf in names, head or beside them"),
        (
            "Y_Unit_Label\tVolts\tVolts\n",
            "what unit have the readings (the log says Volts)",
        ),
        ("# Time units: ms\n", "N, checked: by size"),
        ("# all forces in psi, time in s\n", "(the log says psi)"),
        ("% readings (pounds)\n", "lbf, pounds in names, head or beside them"),
        ("# recorded in Berlin by Anna\n", "N, checked: by size"),
        ("# object mass (kg): 0.2\n", "N, checked: by size"),
        ("# slips at 500 mN\n", "N, checked: by size"),
        ("# Einheit: N\n", "N, N in names, head or beside them"),
        ("# forces: gf\n", "gf, gf in names, head or beside them"),
        ("# Units lbf\n", "lbf, lbf in names, head or beside them"),
        ("FORCE_UNITS N\n", "N, N in names, head or beside them"),
        ("# values are pounds-force\n", "lbf, pounds in names, head or beside them"),
        ("# Unit: 0.01 N\n", "(the log says 0.01, N)"),
        ("# Unit: N/100\n", "(the log says N/100)"),
    ],
)
def test_a_unit_in_the_head_is_that_of_the_readings_or_asked(
    run: Run, tmp_path: Path, head: str, says: str
) -> None:
    one = two_sensors()
    path = write_log(tmp_path / "logs/a.csv", one, names=["t", *TWO])
    path.write_text(head + path.read_text())
    code = 2 if "says" in says else 0
    assert says in imported(run, tmp_path, *SLIP, code=code)


@pytest.mark.parametrize("form", ["{:,.1f}", "{:,.0f}"])
def test_thousands_have_a_sign_between_them(
    run: Run, tmp_path: Path, form: str
) -> None:
    one = two_sensors()
    names = ["t", *(f"{name} [mN]" for name in TWO)]
    lines = [";".join(names)]
    for t_s, row in zip(one.t_s, 1e3 * one.values, strict=True):
        lines.append(";".join([f"{t_s:.2f}", *map(form.format, row)]))
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs/a.csv").write_text("\n".join(lines))
    imported(run, tmp_path, *SLIP)
    assert press(raw(tmp_path)) == pytest.approx(3.0, rel=0.02)


SIGNS = {
    "German": (".", ",", ";", "{:,.0f}"),
    "French": ("\u202f", ",", "\t", "{:,.1f}"),
    "of the SI": (" ", ",", ";", "{:,.1f}"),
    "Swiss": ("\u2019", ".", ";", "{:,.1f}"),
    "American": (",", ".", ",", '"{:,.0f}"'),
}


@pytest.mark.parametrize("form", SIGNS)
def test_signs_of_a_country_between_thousands_are_read_where_a_fraction_shows_its_sign(
    run: Run, tmp_path: Path, form: str
) -> None:
    thousands, decimal, separator, spelled = SIGNS[form]
    one = two_sensors()
    names = ["t", *(f"{name} [mN]" for name in TWO)]
    lines = [separator.join(names)]
    signs = str.maketrans({",": thousands, ".": decimal})
    for t_s, row in zip(one.t_s, 1e3 * one.values, strict=True):
        cells = [f"{t_s:.3f}", *map(spelled.format, row)]
        lines.append(separator.join(cell.translate(signs) for cell in cells))
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs/a.csv").write_text("\n".join(lines), encoding="utf-8")
    imported(run, tmp_path, *SLIP)
    np.testing.assert_allclose(raw(tmp_path), one.values, atol=5.1e-4)


def test_dots_between_thousands_may_come_late_in_a_log_of_decimal_commas(
    run: Run, tmp_path: Path
) -> None:
    one = two_sensors()
    one.values[:300, 2::3] *= 0.1
    names = ["t", *(f"{name} [mN]" for name in TWO)]
    lines = [";".join(names)]
    for t_s, row in zip(one.t_s, 1e3 * one.values, strict=True):
        cells = [f"{cell:,.0f}".replace(",", ".") for cell in row]
        lines.append(";".join([f"{t_s:.2f}".replace(".", ","), *cells]))
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs/a.csv").write_text("\n".join(lines))
    imported(run, tmp_path, *SLIP)
    np.testing.assert_allclose(raw(tmp_path), one.values, atol=5.1e-4)


def test_a_dot_before_some_fractions_is_none_of_thousands_beside_decimal_commas(
    run: Run, tmp_path: Path
) -> None:
    one = two_sensors()
    lines = [";".join(["t", *TWO])]
    for t_s, row in zip(one.t_s, one.values, strict=True):
        cells = [f"{cell:.4f}".replace(".", ",") for cell in row]
        lines.append(";".join([f"{t_s:.3f}", *cells]))
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs/a.csv").write_text("\n".join(lines))
    assert "100 Hz" in imported(run, tmp_path, *SLIP)
    np.testing.assert_allclose(raw(tmp_path), one.values)


@pytest.mark.parametrize(
    ("head", "row"),
    [("a;b", "{} 234,5;{} 345,6"), ("Version 1.2\na;b", "{},234;{},345")],
)
def test_the_decimal_sign_is_that_of_the_rows(head: str, row: str) -> None:
    lines = [*head.splitlines(), *(row.format(k, k) for k in range(1, 60))]
    form = layout_of(tuple(lines)).form
    assert (form.separator, form.decimal) == (";", ",")


def test_whole_numbers_and_some_with_three_digits_behind_a_dot_are_asked(
    run: Run, tmp_path: Path
) -> None:
    one = two_sensors()
    lines = [";".join(["t", *(f"{name} [mN]" for name in TWO)])]
    for k, row in enumerate(1e3 * one.values):
        cells = [f"{cell:,.0f}".replace(",", ".") for cell in row]
        lines.append(f"14:02:{k / 100:06.3f};" + ";".join(cells))
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs/a.csv").write_text("\n".join(lines))
    out = imported(run, tmp_path, *SLIP, code=3)
    assert "a.csv: some numbers of P0_FZ [mN] are whole, others as 2.987" in out
    # three decimals of which nearly every number has all, or shorter ones, are fractions
    for decimals in (2, 3):
        values = one.values.round(decimals)
        write_log(tmp_path / "logs/a.csv", one, values, ["t", *TWO])
        imported(run, tmp_path, *SLIP, out=f"set{decimals}")


# -- quantities


BESIDE = {
    "displacement": ([name.replace("F", "D") for name in TWO], 0.3),
    "torque": ([name.replace("F", "T") for name in TWO], 0.05),
    "angles": (["angle_x", "angle_y", "angle_z"], 10.0),
    "resultant": (["resultant_X", "resultant_Y", "resultant_Z"], 2.0),
    "centre of pressure": (["CoP_x", "CoP_y", "CoP_z"], 0.1),
    "field": (["Bx", "By", "Bz"], 9.0),
}


@pytest.mark.parametrize("beside", BESIDE)
def test_quantities_beside_a_force_are_no_sensors(
    run: Run, tmp_path: Path, beside: str
) -> None:
    one = two_sensors()
    names, size = BESIDE[beside]
    rows = np.column_stack([one.t_s, one.values, size * one.values[:, : len(names)]])
    write_text(tmp_path / "logs/a.csv", ["t", *TWO, *names], rows)
    out = imported(run, tmp_path, *SLIP)
    assert "sensors    2, by the axes in their names" in out
    assert f"not used   {names[0]}, {names[1]}" in out


def test_accelerations_are_no_readings_of_fingers(run: Run, tmp_path: Path) -> None:
    one = made(1)
    names = ["t", *axes(5, "a{k}{axis}")]
    write_log(tmp_path / "logs/cup_slip_1.csv", one, names=names)
    assert "columns a#* (which are the readings?)" in imported(run, tmp_path, code=2)
    assert "5, as given" in imported(run, tmp_path, "--sensors", "a*")


def test_kinds_of_which_none_is_a_force_are_asked_and_chosen(
    run: Run, tmp_path: Path
) -> None:
    one = two_sensors()
    rows = np.column_stack([one.t_s, one.values, 0.3 * one.values])
    names = [f"pad{k}_{a}" for k in (1, 2) for a in "xyz"]
    more = [f"pad{k}_stretch_{a}" for k in (1, 2) for a in "xyz"]
    write_text(tmp_path / "logs/a.csv", ["t", *names, *more], rows)
    assert "which are the readings?" in imported(run, tmp_path, *SLIP, code=2)
    imported(run, tmp_path, *SLIP, "--sensors", "pad?_?")
    np.testing.assert_allclose(raw(tmp_path), one.values)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_sensor_that_is_the_sum_of_the_others_is_asked(
    run: Run, tmp_path: Path, sign: int
) -> None:
    one = two_sensors()
    whole = one.values[:, :3] + one.values[:, 3:]
    names = ["t", *TWO, "P2_FX", "P2_FY", "P2_FZ"]
    values = np.hstack([one.values, sign * whole])
    write_log(tmp_path / "logs/a.csv", one, values, names)
    asked = imported(run, tmp_path, *SLIP, code=2)
    assert "P2_FZ is the sum or the mean of the others" in asked
    imported(run, tmp_path, *SLIP, "--sensors", "P0_*,P1_*")
    np.testing.assert_allclose(raw(tmp_path), one.values)


@pytest.mark.parametrize("sizes", [[1.0] * 6, [1.0] * 15, [0.4, 1.0, 0.3] * 3])
def test_columns_without_axes_that_all_press_are_asked(
    run: Run, tmp_path: Path, sizes: list[float]
) -> None:
    one = made(1, sensors=len(sizes))
    names = ["t", *(f"hall{k}" for k in range(len(sizes)))]
    write_log(tmp_path / "logs/a.csv", one, one.values[:, 2::3] * sizes, names)
    asked = imported(run, tmp_path, *SLIP, code=2)
    assert "which are x, y and z of each sensor?" in asked
    assert "of the normal alone nothing is trained" in asked


@pytest.mark.parametrize(("size", "seed"), [(0.05, 1), (1.0, 1), (0.05, 2), (50.0, 2)])
def test_torques_that_follow_the_forces_are_no_sensors_of_their_own(
    run: Run, tmp_path: Path, size: float, seed: int
) -> None:
    one, beside = two_sensors(), size * two_sensors(seed).values
    force, more = one.values[:, :3], one.values[:, 3:]
    rows = np.column_stack([one.t_s, force, beside[:, :3], more, beside[:, 3:]])
    # without a heading: two sensors of six axes, not four of three
    write_text(tmp_path / "logs/a.csv", [], rows)
    assert "which are x, y and z of each sensor?" in imported(
        run, tmp_path, *SLIP, code=2
    )
    given = ",".join(f"column{k}" for k in (2, 3, 4, 8, 9, 10))
    imported(run, tmp_path, *SLIP, "--sensors", given)
    np.testing.assert_allclose(raw(tmp_path), one.values)


@pytest.mark.parametrize("form", ["noise", "rounded", "mean"])
def test_a_resultant_is_asked_whatever_its_noise_and_a_mean_too(
    run: Run, tmp_path: Path, form: str
) -> None:
    one = two_sensors()
    whole = one.values[:, :3] + one.values[:, 3:]
    noise = np.random.default_rng(7).normal(0.0, 0.05, whole.shape)
    more = {"noise": whole + noise, "rounded": whole.round(1), "mean": whole / 2}[form]
    names = ["t", *TWO, "P2_FX", "P2_FY", "P2_FZ"]
    write_log(tmp_path / "logs/a.csv", one, np.hstack([one.values, more]), names)
    asked = imported(run, tmp_path, *SLIP, code=2)
    assert "P2_FZ is the sum or the mean of the others" in asked


def test_a_thumb_that_balances_the_fingers_in_its_normal_alone_is_a_sensor(
    run: Run, tmp_path: Path
) -> None:
    one = made(1, sensors=3)
    # without a pull the shear is noise
    one.values[:, 0::3] = made(2, sensors=3).values[:, 1::3]
    noise = np.random.default_rng(7).normal(0.0, 0.02, len(one.t_s))
    one.values[:, 2] = (one.values[:, 5] + one.values[:, 8] + noise).round(4)
    write_log(tmp_path / "logs/a.csv", one)
    imported(run, tmp_path, *SLIP)
    np.testing.assert_allclose(raw(tmp_path), one.values)


def test_what_was_taken_from_many_readings_is_none(run: Run, tmp_path: Path) -> None:
    one = made(1, sensors=1)
    words = ("mean", "std", "max", "min", "rms", "range", "median", "var", "kurtosis")
    names = ["t", *(f"f{a}_{word}" for word in words for a in "xyz")]
    write_log(tmp_path / "logs/a.csv", one, np.tile(one.values, len(words)), names)
    asked = imported(run, tmp_path, *SLIP, code=2)
    assert "which columns of a are x, y and z of each sensor? (t, fx_mean" in asked


@pytest.mark.parametrize(
    ("form", "beside"),
    [
        ("Kraft {} [N]", "Weg {} [mm]"), ("{} [N]", "{} [mm]"), ("{} [uT]", "{} [mm]"),
        ("pad {} (N)", "bend {} (deg)"), ("Nano17-A F{} (N)", "Nano17-A T{} (Nmm)"),
        ("Kraft_{}", "Strecke_{}"), ("{} [N]", "{} [uT]"),
    ],
)  # fmt: skip
def test_names_and_units_in_brackets_say_which_columns_are_the_readings(
    run: Run, tmp_path: Path, form: str, beside: str
) -> None:
    one = made(1, sensors=1)
    names = [name.format(a) for name in (beside, form) for a in "xyz"]
    values = np.hstack([0.3 * one.values, one.values])
    write_log(tmp_path / "logs/a.csv", one, values, ["t", *names])
    out = imported(run, tmp_path, *SLIP)
    assert f"sensors    1, by the axes in their names: {form.format('x')}" in out
    assert f"not used   {beside.format('x')}" in out


@pytest.mark.parametrize(
    ("form", "beside"),
    [
        ("{} [N]", "raw {} [N]"), ("s1_{}_raw", "s1_{}_N"), ("F{}_T", "F{}_I"),
        ("s1_a_{}", "s1_b_{}"),
    ],
)  # fmt: skip
def test_units_that_do_not_say_which_columns_are_the_readings_are_no_answer(
    run: Run, tmp_path: Path, form: str, beside: str
) -> None:
    one = two_sensors()
    names = [name.format(a) for name in (form, beside) for a in "xyz"]
    write_log(tmp_path / "logs/a.csv", one, names=["t", *names])
    assert "which are the readings?" in imported(run, tmp_path, *SLIP, code=2)


@pytest.mark.parametrize(
    "names",
    [
        ["Fx", "Fy", "Fz", "Fx", "Fy", "Fz"],
        [f"Nano17-{k} F{a} (N)" for k in "AB" for a in "xyz"],
        [f"Sensor{k}_F{a}" for k in "AB" for a in "xyz"],
    ],
)
def test_forces_that_differ_in_a_letter_or_have_one_name_are_of_two_sensors(
    run: Run, tmp_path: Path, names: list[str]
) -> None:
    one = two_sensors()
    write_log(tmp_path / "logs/a.csv", one, names=["t", *names])
    imported(run, tmp_path, *SLIP)
    np.testing.assert_allclose(raw(tmp_path), one.values)


@pytest.mark.parametrize(
    "form", ["trial{}_F{}", "run {} F{}", "rep_{}_f{}", "F{1} (Versuch {0})"]
)
def test_trials_beside_each_other_are_no_sensors(
    run: Run, tmp_path: Path, form: str
) -> None:
    names = [form.format(k, a) for k in (1, 2, 3) for a in "xyz"]
    write_log(tmp_path / "logs/a.csv", made(1, sensors=3), names=["t", *names])
    asked = imported(run, tmp_path, *SLIP, code=2)
    assert "columns of trials (write each below the other)" in asked


# -- fingers


@pytest.mark.parametrize(
    "words",
    [
        ("fingerone", "fingertwo", "fingerthree", "fingerfour", "fingerfive"),
        ("th", "ff", "mf", "rf", "lf"),
        ("thumb", "index", "middle", "ring", "little"),
        ("Thumb", "IndexFinger", "MiddleFinger", "RingFinger", "LittleFinger"),
        ("rh_thdistal", "rh_ffdistal", "rh_mfdistal", "rh_rfdistal", "rh_lfdistal"),
        ("THtip", "FFtip", "MFtip", "RFtip", "LFtip"),
        ("Daumen", "Zeigefinger", "Mittelfinger", "Ringfinger", "KleinerFinger"),
        ("sensor_1", "sensor_2", "sensor_3", "sensor_4", "sensor_5"),
    ],
)
@pytest.mark.parametrize("in_files", [True, False])
def test_fingers_stand_in_the_order_of_a_hand_whatever_their_order_in_a_file(
    run: Run, tmp_path: Path, words: tuple[str, ...], in_files: bool
) -> None:
    one = made(1, sensors=1)
    # the last one first, and each finger presses harder than the one before
    sizes = [*enumerate(words, 1)][::-1]
    if in_files:
        for size, word in sizes:
            path = tmp_path / f"logs/cup_slip_1_{word}.csv"
            write_log(path, one, size * one.values, ["t", "fx", "fy", "fz"])
    else:
        names = ["t", *(f"{word}_f{a}" for _, word in sizes for a in "xyz")]
        values = np.hstack([size * one.values for size, _ in sizes])
        write_log(tmp_path / "logs/cup_slip_1.csv", one, values, names)
    imported(run, tmp_path)
    pressed = np.median(raw(tmp_path, "cup/slip/trial_1")[150:250, 2::3], axis=0)
    np.testing.assert_allclose(pressed, 3.0 * np.arange(1, 6), rtol=0.05)
    card = (tmp_path / "set/hand.toml").read_text()
    assert card.count('"thumb"') == 1


def test_files_of_one_sensor_that_run_at_the_same_time_are_asked(
    run: Run, tmp_path: Path
) -> None:
    words = {"gamma": 3.0, "alpha": 1.0, "beta": 2.5}
    one = made(1, sensors=1)
    for word, size in words.items():
        path = tmp_path / f"logs/cup_slip/{word}.csv"
        write_log(path, one, size * one.values, ["t", "fx", "fy", "fz"])
    asked = imported(run, tmp_path, code=2)
    assert "are alpha,beta,gamma fingers of one trial? nothing says it" in asked
    imported(run, tmp_path, "--fingers", ",".join(words))
    pressed = np.median(raw(tmp_path, "cup/slip/trial_1")[150:250, 2::3], axis=0)
    np.testing.assert_allclose(pressed, [9.0, 3.0, 7.5], rtol=0.05)
    out = imported(run, tmp_path, "--object", ",".join(words), out="trials")
    assert "3 trials: 3 slip" in out


def test_numbered_fingers_and_a_thumb_are_one_hand(run: Run, tmp_path: Path) -> None:
    words = ("finger1", "finger2", "thumb")
    one = made(1, sensors=3)
    names = ["t", *(f"{word}_f{a}" for word in words for a in "xyz")]
    write_log(tmp_path / "logs/cup_slip_1.csv", one, names=names)
    out = imported(run, tmp_path)
    assert "sensors    3, by the axes in their names: thumb_fx" in out
    values = raw(tmp_path, "cup/slip/trial_1")
    np.testing.assert_allclose(values, np.roll(one.values, 3, axis=1))


@pytest.mark.parametrize(
    ("sides", "words"),
    [
        (("left", "right"), ("_thumb", "_index")), (("LH", "RH"), ("1", "2")),
        (("hand1", "hand2"), ("_thumb", "_index")), (("hand_1", "hand_2"), ("_a", "_b")),
        (("Left", "Right"), ("Thumb", "Index")), (("links", "rechts"), ("_1", "_2")),
    ],
)  # fmt: skip
def test_two_hands_are_asked(
    run: Run, tmp_path: Path, sides: tuple[str, str], words: tuple[str, str]
) -> None:
    hands = [f"{hand}{word}" for hand in sides for word in words]
    names = ["t", *(f"{hand}_f{a}" for hand in hands for a in "xyz")]
    write_log(tmp_path / "logs/a.csv", made(1, sensors=4), names=names)
    assert "columns of two hands" in imported(run, tmp_path, *SLIP, code=2)
    imported(run, tmp_path, *SLIP, "--sensors", f"{sides[0]}*")
    assert raw(tmp_path).shape[1] == 6


def test_two_hands_in_files_are_asked(run: Run, tmp_path: Path) -> None:
    for k, hand in enumerate(("left", "right"), 1):
        write_log(tmp_path / f"logs/t1_{hand}.csv", made(k))
    asked = imported(run, tmp_path, *SLIP, code=2)
    assert "are left,right fingers of one trial? nothing says it" in asked
    imported(run, tmp_path, *SLIP, "--fingers", "left,right")
    assert raw(tmp_path).shape == (500, 30)


@pytest.mark.parametrize("words", [("hand_1", "hand_2"), range(1, 6)])
def test_hands_with_a_sensor_each_are_the_sensors_of_one(
    run: Run, tmp_path: Path, words: range | tuple[str, ...]
) -> None:
    hands = [word if isinstance(word, str) else f"hand{word}" for word in words]
    one = made(1, sensors=len(hands))
    names = ["t", *(f"{hand}_f{a}" for hand in hands for a in "xyz")]
    write_log(tmp_path / "logs/a.csv", one, names=names)
    imported(run, tmp_path, *SLIP)
    np.testing.assert_allclose(raw(tmp_path), one.values)


@pytest.mark.parametrize(
    ("form", "words", "given"),
    [
        ("{}_f{}", ("Zeigefinger", "Daumen"), "*_f?"),
        ("{}_f{}", ("kleiner Finger", "Daumen"), "*_f?"),
        ("{}_f{}", ("annulaire", "pouce"), "*_f?"),
        ("{}_f{}", ("rh_ffdistal", "rh_thdistal"), "*_f?"),
        ("{}_f{}", ("RightIndex", "RightThumb"), "Right*"),
        ("{}F{}", ("index", "thumb"), ""),
        ("F{1}{0}", ("Index", "Thumb"), ""),
        ("{}_cell_{}", ("index", "thumb"), "index*,thumb*"),
    ],
)
def test_the_thumbs_side_is_that_of_the_thumb_wherever_it_stands(
    run: Run, tmp_path: Path, form: str, words: tuple[str, str], given: str
) -> None:
    one = two_sensors()
    one.values[:, 5] *= 2.0
    letters = "abc" if "cell" in form else "xyz"
    names = ["t", *(form.format(word, a) for word in words for a in letters)]
    write_log(tmp_path / "logs/a.csv", one, names=names)
    imported(run, tmp_path, *SLIP, *(("--sensors", given) if given else ()))
    np.testing.assert_allclose(raw(tmp_path), np.roll(one.values, 3, axis=1))
    card = (tmp_path / "set/hand.toml").read_text()
    assert card.index('side = "thumb"') < card.index('side = "opposing"')


# -- words


@pytest.mark.parametrize(
    ("word", "action"),
    [
        ("slip", "slip"), ("dropped", "slip"), ("no-slip", "hold"), ("hand-over", "pass"),
        ("grasp", None), ("holder", None), ("empty", None), ("slippers", None), ("rest", None),
    ],
)  # fmt: skip
def test_an_action_is_a_whole_word(word: str, action: str | None) -> None:
    assert action_of_word(word) == action


@pytest.mark.parametrize(
    ("sentence", "action"),
    [
        ("pull soft-ball", "pull"), ("put down the cup", "put-down"),
        ("pick up the empty bottle", None), ("grasp the holder", None),
    ],
)  # fmt: skip
def test_a_sentence_is_read_where_an_action_is_its_first_word(
    sentence: str, action: str | None
) -> None:
    assert action_of_sentence(sentence) == action


def test_a_label_that_is_the_same_in_every_row_says_what_the_trial_is(
    run: Run, tmp_path: Path
) -> None:
    for k, word in ((1, "slip"), (2, "no slip")):
        one = made(k)
        names = ["t", *axes(5), "label"]
        write_log(tmp_path / f"logs/{k}.csv", one, names=names, texts=[word] * 500)
    assert "2 trials: 1 slip, 1 hold" in imported(run, tmp_path)
    assert not (tmp_path / "set/object/slip/trial_1.truth.json").exists()


@pytest.mark.parametrize(
    ("label", "situation"),
    [
        ("GraspStable", "grasp"), ("slip detected", None), ("slip prevented", None),
        ("pre-slip", None), ("success", None), ("pick up the empty cup", None),
        ("open hand", "nothing"), ("slip_end", ""),
    ],
)  # fmt: skip
def test_a_label_means_what_all_of_its_words_mean(
    label: str, situation: str | None
) -> None:
    assert situation_of_word(label) == situation


@pytest.mark.parametrize("name", ["slip_count", "slip_enabled"])
def test_a_column_about_slips_that_is_no_mark_of_them_is_asked(
    run: Run, tmp_path: Path, name: str
) -> None:
    one = made(1)
    names = ["t", *axes(5), name]
    texts = one.words("0", "1", "1")
    write_log(tmp_path / "logs/a.csv", one, names=names, texts=texts)
    assert f"what is '1' in column {name}" in imported(run, tmp_path, code=2)


def test_a_column_of_two_values_that_is_a_reading_is_no_label(
    run: Run, tmp_path: Path
) -> None:
    one = made(1)
    names = ["t", *axes(5), "pressure_cell"]
    write_log(tmp_path / "logs/a.csv", one, names=names, texts=one.words("0", "0", "1"))
    assert "what happens in these trials?" in imported(run, tmp_path, code=2)


def test_a_log_that_begins_in_a_grasp_shows_no_sign_of_a_press(
    run: Run, tmp_path: Path
) -> None:
    one = two_sensors()
    # from the grasp to the open hand: the readings fall with time
    values, words = one.values[150:], one.words("nothing", "grasp", "slip")[150:]
    names, rows = ["t", *TWO, "phase"], np.column_stack([one.t_s[150:], values])
    write_text(tmp_path / "logs/a.csv", names, rows, texts=words)
    assert "signs" not in imported(run, tmp_path, "--unit", "N")
    np.testing.assert_allclose(raw(tmp_path), values)


def test_an_open_hand_that_presses_is_doubted(run: Run, tmp_path: Path) -> None:
    for k, action in enumerate(("nothing", "slip"), 1):
        write_log(tmp_path / f"logs/p1_{action}_1.csv", made(k))
    doubt = "an open hand that presses with 7"
    assert doubt in imported(run, tmp_path)
    assert doubt in run("check", tmp_path / "set")[1]


# -- further forms, as public threads show them


def esp_idf_monitor(one: Made) -> str:
    """Each line with a level, milliseconds and a tag before it (ESP-IDF)."""
    lines = ["I (31) boot: ESP-IDF v5.1", "I (32) hand: ready"]
    for t_s, row in zip(one.t_s, one.values.tolist(), strict=True):
        cells = ",".join(f"{cell:.4f}" for cell in row)
        lines.append(f"I ({1e3 * t_s + 340:.0f}) hand: {cells}")
    return "\n".join(lines) + "\n"


def rostopic_echo(one: Made) -> str:
    """A comment sign before the names, stamps of 19 digits, texts beside (rostopic echo -p)."""
    head = "%time,field.header.seq,field.header.stamp,field.header.frame_id"
    lines = [",".join([head, *axes(5, "field.pads{k}.force.{axis}")])]
    for k, row in enumerate(one.values.tolist()):
        stamp = 1_700_000_000_000_000_000 + k * 10_000_000
        cells = [stamp, k, stamp, "pads", *(f"{cell:.4f}" for cell in row)]
        lines.append(",".join(map(str, cells)))
    return "\n".join(lines) + "\n"


def an_empty_line_after_each_row(one: Made) -> str:
    """Line ends of Windows, written in text mode (CR CR LF)."""
    rows = np.column_stack([one.t_s, one.values])
    lines = [",".join(f"{cell:.4f}" for cell in row) for row in rows.tolist()]
    return "\r\r\n".join([",".join(["t", *axes(5)]), *lines]) + "\r\r\n"


def opensim_storage(one: Made) -> str:
    """Keys and values, `endheader`, names, tabs (.mot and .sto of OpenSim)."""
    rows = np.column_stack([one.t_s, one.values])
    head = (
        f"forces\nversion=1\nnRows={len(rows)}\nnColumns=16\ninDegrees=yes\nendheader"
    )
    names = "\t".join(["time", *axes(5, "{k}_ground_force_v{axis}")])
    lines = ["\t".join(f"{cell:.4f}" for cell in row) for row in rows.tolist()]
    return "\n".join([head, names, *lines]) + "\n"


def lines_that_leave_a_dead_sensor_out(one: Made) -> str:
    """No cell stands for a sensor that does not answer: all others move to the left."""
    rows = np.column_stack([one.t_s, one.values])
    lines = []
    for k, row in enumerate(rows.tolist()):
        cells = [f"{cell:.4f}" for cell in row]
        lines.append(",".join(cells[:1] + cells[4:] if k in (200, 201) else cells))
    return "\n".join([",".join(["t", *axes(5)]), *lines]) + "\n"


def opensignals(one: Made) -> str:
    """A counter of four bits, and JSON in a comment above it (OpenSignals)."""
    facts = '{"00:07": {"sampling rate": 100, "column": ["nSeq", "CH1"]}}'
    lines = ["# OpenSignals Text File Format", f"# {facts}", "# EndOfHeader"]
    for k, row in enumerate(one.values.tolist()):
        lines.append("\t".join([str(k % 16), *(f"{cell:.4f}" for cell in row)]))
    return "\n".join(lines) + "\n"


def newest_row_first(one: Made) -> str:
    """As dashboards and telephones export (ThingSpeak, Grafana)."""
    rows = np.column_stack([one.t_s, one.values]).tolist()
    lines = [",".join(f"{cell:.4f}" for cell in row) for row in rows]
    return "\n".join([",".join(["t", *axes(5)]), *lines[::-1]]) + "\n"


def long_minus_signs(one: Made) -> str:
    """As programs write numbers for people (Mathematica, R's scales)."""
    rows = np.column_stack([one.t_s, one.values]).tolist()
    lines = [",".join(f"{cell:.4f}" for cell in row) for row in rows]
    return "\n".join([",".join(["t", *axes(5)]), *lines]).replace("-", "\N{MINUS SIGN}")


def a_sensor_that_hangs(one: Made) -> str:
    """A driver that gives its last reading again while a sensor does not answer."""
    values = one.values.copy()
    values[200:321, 12:] = values[200, 12:]
    rows = np.column_stack([one.t_s, values]).tolist()
    lines = [",".join(f"{cell:.4f}" for cell in row) for row in rows]
    return "\n".join([",".join(["t", *axes(5)]), *lines]) + "\n"


FURTHER = {
    write.__name__: write
    for write in (
        esp_idf_monitor, rostopic_echo, an_empty_line_after_each_row, opensim_storage,
        lines_that_leave_a_dead_sensor_out, opensignals, newest_row_first, long_minus_signs,
        a_sensor_that_hangs,
    )
}  # fmt: skip
LOST = {"lines_that_leave_a_dead_sensor_out": 2, "a_sensor_that_hangs": 120}
"""Rows in which a sensor's readings are lost; the others are whole."""


@pytest.mark.parametrize("form", FURTHER)
def test_a_form_of_a_public_thread_is_right_or_asked(
    run: Run, tmp_path: Path, form: str
) -> None:
    one = made(1)
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs/a.txt").write_bytes(FURTHER[form](one).encode())
    words: tuple[object, ...] = SLIP
    if form == "opensignals":
        # a counter of four bits is no clock, and no reading
        assert "--sensors" in imported(run, tmp_path, *SLIP, code=2)
        columns = "column[2-9],column1[0-6]"
        words = (*SLIP, "--rate", 100, "--sensors", columns)
    imported(run, tmp_path, *words)
    trial = read_trial(tmp_path / "set/object/slip/trial_1.csv")
    assert trial.rate_hz == pytest.approx(100.0, rel=1e-3)
    np.testing.assert_allclose(trial.raw[:200], one.values[:200], atol=1e-4)
    np.testing.assert_allclose(trial.raw[-150:], one.values[-150:], atol=1e-4)
    assert np.isnan(trial.raw[:, -1]).sum() == LOST.get(form, 0)
    assert len(trial.raw) == 500


def rows_over_two_lines(one: Made) -> str:
    """As numpy prints an array, without a heading."""
    lines = []
    for row in np.column_stack([one.t_s, one.values]).tolist():
        cells = [f"{cell:.4f}" for cell in row]
        lines += ["[" + " ".join(cells[:10]), "  " + " ".join(cells[10:]) + "]"]
    return "\n".join(lines) + "\n"


def lines_of_influx(one: Made) -> str:
    """A row for each finger, a name before each number (InfluxDB's line protocol)."""
    lines = []
    for t_s, row in zip(one.t_s, one.values.reshape(-1, 5, 3).tolist(), strict=True):
        for k, (x, y, z) in enumerate(row):
            stamp = f"{1_700_000_000 + t_s:.9f}".replace(".", "")
            lines.append(f"pads,finger=f{k} fx={x:.4f},fy={y:.4f},fz={z:.4f} {stamp}")
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("form", "says"),
    [
        (rows_over_two_lines, "lines have another number of cells than"),
        (lines_of_influx, "a.txt is no table"),
    ],
)
def test_a_form_of_a_public_thread_that_is_no_table_is_refused(
    run: Run, tmp_path: Path, form: Callable[[Made], str], says: str
) -> None:
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs/a.txt").write_text(form(made(1)))
    assert says in imported(run, tmp_path, *SLIP, code=3)


@pytest.mark.parametrize(
    "form", ["{} [0.01 N]", "{} (x10^-2 N)", "{} (N/100)", "{} [10⁻² N]"]
)
def test_a_unit_with_a_factor_is_asked(run: Run, tmp_path: Path, form: str) -> None:
    one = two_sensors()
    names = ["t (s)", *map(form.format, TWO)]
    write_log(tmp_path / "logs/a.csv", one, 100 * one.values, names)
    factor = form[4:-1]
    assert f"the log says {factor}" in imported(run, tmp_path, *SLIP, code=2)
    # a hundredth of a newton has a name
    imported(run, tmp_path, *SLIP, "--unit", "cN", out="centi")
    centi = read_trial(tmp_path / "centi/object/slip/trial_1.csv").raw
    np.testing.assert_allclose(centi, one.values, atol=1e-6)
    write_log(tmp_path / "logs/a.csv", one, names=["t [10 ms]", *TWO])
    assert "how many rows a second" in imported(run, tmp_path, *SLIP, code=2)


# -- facts beside a log, and what is refused


@pytest.mark.parametrize("place", ["cup_1.json", "facts.json"])
def test_an_object_beside_a_log_names_its_trial_and_when_it_fell(
    run: Run, tmp_path: Path, place: str
) -> None:
    write_log(tmp_path / "logs/cup_1.csv", made(1))
    facts = {"subject": "anna", "object": "mug", "outcome": "drop", "drop_time_s": 3.0}
    (tmp_path / "logs" / place).write_text(json.dumps(facts))
    imported(run, tmp_path)
    truth = (tmp_path / "set/anna/mug/slip/trial_1.truth.json").read_text()
    slips = [p for p in json.loads(truth)["phases"] if p["label"] == "risky_slip"]
    assert [slip["t0_s"] for slip in slips] == [3.0]


def test_a_broken_object_that_is_called_as_a_log_is_refused_by_its_name(
    run: Run, tmp_path: Path
) -> None:
    write_log(tmp_path / "logs/cup_1.csv", made(1))
    (tmp_path / "logs/cup_1.json").write_text('{"subject": "anna", ')
    assert "cup_1.json: cannot be read" in imported(run, tmp_path, *SLIP, code=3)
    (tmp_path / "logs/cup_1.json").rename(tmp_path / "logs/settings.json")
    assert "not read: settings.json" in imported(run, tmp_path, *SLIP)


@pytest.mark.parametrize("no_time", [None, float("nan")])
def test_an_object_without_a_time_of_the_drop_is_a_trial_in_which_nothing_falls(
    run: Run, tmp_path: Path, no_time: float | None
) -> None:
    for k, at_s in ((1, 3.0), (2, no_time)):
        write_log(tmp_path / f"logs/rec_{k}.csv", made(k))
        facts = {"subject": f"p{k}", "success": k == 2, "drop_time_s": at_s}
        (tmp_path / f"logs/rec_{k}.json").write_text(json.dumps(facts))
    assert "2 trials: 1 slip, 1 hold" in imported(run, tmp_path)


EVENTS = [
    {"t": 1.0, "label": "grasp"},
    {"t": 3.0, "label": "slip"},
    {"t": 3.5, "label": "grasp"},
]
PHASES = [
    {"t0_s": 1.0, "t1_s": 4.0, "label": "grasp"},
    {"t0_s": 3.0, "t1_s": 3.5, "label": "slip"},
]


@pytest.mark.parametrize(
    "value",
    [
        {"subject": "anna", "object": "mug", "events": EVENTS},
        {
            "subject": "anna",
            "object": "mug",
            "notes": {"by": "video", "phases": PHASES},
        },
    ],
)
def test_a_list_of_events_in_an_object_beside_a_log_says_when_it_slips(
    run: Run, tmp_path: Path, value: object
) -> None:
    for k in (1, 2):
        write_log(tmp_path / f"logs/rec_{k}.csv", made(k))
        (tmp_path / f"logs/rec_{k}.json").write_text(json.dumps(value))
    assert "labels     *.json: t" in imported(run, tmp_path)
    for k in (1, 2):
        path = tmp_path / f"set/anna/mug/slip/trial_{k}.truth.json"
        phases = json.loads(path.read_text())["phases"]
        slips = [p for p in phases if p["label"] == "risky_slip"]
        assert [(slip["t0_s"], slip["t1_s"]) for slip in slips] == [(3.0, 3.5)]


def test_a_list_in_an_object_that_holds_no_events_is_named(
    run: Run, tmp_path: Path
) -> None:
    write_log(tmp_path / "logs/cup_1.csv", made(1))
    value = {
        "subject": "anna",
        "steps": [{"nr": 1, "what": "wash"}, {"nr": 2, "what": "dry"}],
    }
    (tmp_path / "logs/cup_1.json").write_text(json.dumps(value))
    asked = imported(run, tmp_path, code=2)
    assert "not used   *.json (columns nr, what)" in asked
    assert "what happens in these trials?" in asked


def test_a_list_of_numbers_in_an_object_beside_a_log_is_named(
    run: Run, tmp_path: Path
) -> None:
    write_log(tmp_path / "logs/cup_1.csv", made(1))
    facts = {"subject": "anna", "slip_times": [3.0]}
    (tmp_path / "logs/cup_1.json").write_text(json.dumps(facts))
    out = imported(run, tmp_path, *SLIP)
    assert "not used   *.json (columns slip_times)" in out


@pytest.mark.parametrize(
    ("name", "data", "says"),
    [
        ("a.mat", b"MATLAB 5.0", "a.mat is a MATLAB file"),
        ("a.h5", b"\x89HDF", "a.h5 is HDF5"),
        ("a.npy", b"\x93NUMPY", "a.npy is numpy"),
        ("b.npy", b"\x93NUMPY{'a': '<f8', 'shape': (5, 3), }\n\0\0", "b.npy is numpy"),
        ("a.png", b"\x89PNG", "a.png is a picture"),
        ("a.csv", b"version https://git-lfs.github.com/spec/v1\n", "a Git LFS pointer"),
        ("a.tdms", b"TDSm", "a.tdms is of LabVIEW"),
        ("a.pkl", b"\x80\x04", "a.pkl is a pickle"),
        ("a.jsonl", b'{"t": 0.0, "fx": 0.1}\n', "save it as CSV"),
    ],
)
def test_what_is_refused_names_a_file_that_was_seen(
    run: Run, tmp_path: Path, name: str, data: bytes, says: str
) -> None:
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / name).write_bytes(data)
    # which tells less
    (tmp_path / "logs/README.md").write_text("# slips\n")
    assert says in imported(run, tmp_path, code=3)
