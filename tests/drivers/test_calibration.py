"""Field to force: the law of the map, its files and their errors; the bias and its warnings."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hard_marks import SINGULAR
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from own_data import rewrite

from holdfast.cli import hand
from holdfast.cli.command import Parser
from holdfast.core.contract import FloatArray, IntArray, channel_names
from holdfast.core.errors import (
    ChannelError,
    ColumnError,
    DataError,
    EmptyRecording,
    NotANumber,
    TooFewGroups,
    UnitError,
)
from holdfast.drivers.calibration import (
    Bias,
    Calibration,
    bias_of,
    read_bias,
    read_calibration,
    write_bias,
    write_calibration,
)
from holdfast.sessions.calibrate import Fit, LoadSet, measured_shear_gain, read_loads
from holdfast.sessions.calibrate import calibrate as fit_calibration
from holdfast.simulation.effects.magnet import HEIGHT, dipole_ut, place_m, shear_gain

FINITE = st.floats(-1e4, 1e4)
FIELDS = arrays(np.float64, (4, 2, 3), elements=FINITE)


def made(n_sensors: int = 2, *, rest: bool = False, seed: int = 0) -> Calibration:
    rng = np.random.default_rng(seed)
    resting = float(rest) * rng.normal(0.0, 1000.0, (n_sensors, 3))
    return Calibration(
        rng.normal(0.0, 0.01, (n_sensors, 3, 3)),
        resting,
        np.zeros(n_sensors, dtype=np.bool_),
        "made up",
        "2026-01-02",
        "N",
        100,
        np.full((n_sensors, 3), 0.25),
    )


def pressed(
    n_sensors: int = 2, *, seed: int = 1
) -> tuple[FloatArray, FloatArray, IntArray]:
    """(field [M, S, 3] uT, matrix [S, 3, 3], blocks [M]) of loads in every direction, each sensor
    in its turn."""
    rng = np.random.default_rng(seed)
    matrix = np.diag([0.008, 0.009, 0.01]) + rng.normal(0.0, 0.001, (n_sensors, 3, 3))
    blocks = np.repeat(np.arange(4), 20)
    return rng.normal(0.0, 500.0, (80, n_sensors, 3)), matrix, blocks


def total(matrix: FloatArray, field: FloatArray) -> FloatArray:
    return np.einsum("sij,tsj->ti", matrix, field)


# The map


@given(FIELDS, FIELDS, st.floats(-100.0, 100.0))
def test_the_force_of_a_sum_of_fields_is_the_sum_of_their_forces(
    a: FloatArray, b: FloatArray, factor: float
) -> None:
    c = made()
    np.testing.assert_allclose(
        c.apply(a + factor * b), c.apply(a) + factor * c.apply(b), rtol=1e-9, atol=1e-6
    )


def test_the_resting_field_is_no_force() -> None:
    c = made(rest=True)
    assert not c.apply(c.rest_ut).any()


def test_a_lost_channel_makes_its_own_sensor_nan_and_no_other() -> None:
    field = np.ones((1, 2, 3))
    field[0, 1, 0] = np.nan
    assert np.isnan(made().apply(field)).tolist() == [[[False] * 3, [True] * 3]]


@pytest.mark.parametrize("shape", [(3, 3), (2, 2), (6,), (5, 1, 3)])
def test_a_field_of_another_hand_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ChannelError, match=r"2 sensors.*next: use"):
        made().apply(np.zeros(shape))


# The fit


def loads_of(
    field_ut: FloatArray,
    force_n: FloatArray,
    blocks: IntArray,
    reversed_: Any = None,
) -> LoadSet:
    """Rows as a set of loads; fields are less their rest."""
    upright = np.zeros(field_ut.shape[1], dtype=np.bool_)
    turned = upright if reversed_ is None else reversed_
    rest_ut = np.zeros(field_ut.shape[1:])
    return LoadSet("loads", blocks, field_ut, force_n, "N", rest_ut, turned, 0)


def fit(*rows: Any) -> Fit:
    return fit_calibration(loads_of(*rows), "made", "2026-01-02")


@given(st.integers(0, 2**32 - 1), st.integers(1, 6))
def test_noiseless_loads_give_back_the_matrix(seed: int, n_sensors: int) -> None:
    field, matrix, blocks = pressed(n_sensors, seed=seed)
    flipped = np.arange(n_sensors) % 2 == 1
    sign = np.where(flipped, -1.0, 1.0)[:, None]
    fitted = fit(sign * field, total(matrix, field), blocks, flipped)
    np.testing.assert_allclose(fitted.calibration.matrix_n_per_ut, matrix, atol=1e-9)
    assert fitted.held_out_n.max() < 1e-6


def test_a_held_out_block_is_judged_by_the_others_only() -> None:
    """A block with loads that contradict all others shows its whole error."""
    field, matrix, blocks = pressed(1)
    force = total(matrix, field)
    force[blocks == 3] *= -1.0
    only = blocks < 3
    others = fit(field[only], force[only], blocks[only]).calibration
    error = others.apply(field[~only]).sum(axis=1) - force[~only]
    np.testing.assert_allclose(
        fit(field, force, blocks).held_out_n[3], np.sqrt(np.mean(error**2, axis=0))
    )


@SINGULAR.mark
def test_loads_one_way_give_no_matrix_for_three() -> None:
    field, matrix, blocks = pressed(1)
    field[:, :, :2] = 0.0
    with pytest.raises(DataError, match="3 axes move the field in 1 direction"):
        fit(field, total(matrix, field), blocks)


# Its file


AWKWARD = [0.1 + 0.2, -5e-324, 1.7976931348623157e308]


def test_a_calibration_comes_back_bit_for_bit(tmp_path: Path) -> None:
    c = replace(
        made(),
        rest_ut=np.array([AWKWARD] * 2),
        reversed=np.array([True, False]),
        residual_n=np.full((2, 3), 1.0 / 3.0),
        shear_gain=1.0 / 3.0,
    )
    back = vars(read_calibration(write_calibration(tmp_path / "c.json", c)))
    for name, value in vars(c).items():
        if isinstance(value, np.ndarray):
            assert back[name].tobytes() == value.tobytes()
        else:
            assert back[name] == value


BROKEN: list[tuple[dict[str, Any], str]] = [
    ({"kind": "bias"}, "kind = 'bias'; next: allowed: calibration"),
    ({"matrix_n_per_ut": [[[1.0], [1.0, 2.0], [1.0]]] * 2}, "matrix_n_per_ut"),
    ({"matrix_n_per_ut": [[[1.0, 2.0, float("nan")]] * 3] * 2}, "NaN is not a finite"),
    ({"matrix_n_per_ut": [[[0.0] * 3] * 3] * 2}, "sensor 1 is singular"),
    (
        {"matrix_n_per_ut": [np.eye(3).tolist(), [[1, 2, 3], [0] * 3, [2, 4, 6]]]},
        "sensor 2 is singular",
    ),
    ({"rest_ut": [[0.0, 0.0, 0.0]]}, "rest_ut has 1; next: allowed: 2 rows"),
    ({"reversed": [False] * 3}, "reversed has 3; next: allowed: 2 rows"),
    ({"shear_gain": 0.0999}, "shear_gain = 0.0999"),
    ({"shear_gain": 10.01}, "shear_gain = 10.01"),
]


@SINGULAR.mark
@pytest.mark.parametrize(("change", "says"), BROKEN)
def test_a_broken_calibration_is_refused_with_what_where_and_what_is_allowed(
    tmp_path: Path, change: dict[str, Any], says: str
) -> None:
    path = write_calibration(tmp_path / "c.json", made())
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(DataError) as caught:
        read_calibration(path)
    assert "c.json: " in str(caught.value)
    assert says in str(caught.value)


def test_an_older_file_has_no_shear_gain(tmp_path: Path) -> None:
    path = write_calibration(tmp_path / "c.json", replace(made(), shear_gain=1.0))
    content = json.loads(path.read_text())
    del content["shear_gain"]
    path.write_text(json.dumps(content))
    assert read_calibration(path).shear_gain is None


# The bias


def resting(n: int = 300, n_sensors: int = 6) -> FloatArray:
    """[T, C] uT of an untouched hand, with the noise the chip has."""
    noise = np.random.default_rng(7).normal(0.0, 1.0, (n, 3 * n_sensors)) * np.tile(
        [22.0, 22.0, 11.0], n_sensors
    )
    return np.tile([120.0, -80.0, 2300.0], n_sensors) + noise


def test_the_bias_of_a_quiet_hand_is_its_median_without_a_warning() -> None:
    rows = resting()
    bias, warned = bias_of(rows, "uT")
    assert warned == ()
    np.testing.assert_array_equal(bias.values, np.median(rows, axis=0))
    assert (bias.n, bias.unit, bias.reversed.any()) == (300, "uT", False)
    assert bias.spread[2] == pytest.approx(11.0, rel=0.2)


def test_a_channel_lost_for_a_whole_third_is_reported_without_a_warning_of_numpy() -> (
    None
):
    rows = resting()
    rows[:150, 0] = np.nan
    assert len(bias_of(rows, "uT")[1]) == 1


def test_a_reversed_magnet_is_found_and_named() -> None:
    rows = resting()
    rows[:, 9:12] *= -1.0
    bias, warned = bias_of(rows, "uT")
    assert bias.reversed.tolist() == [False, False, False, True, False, False]
    assert len(warned) == 1
    assert "reversed" in warned[0]
    assert " in Z4;" in warned[0]


def test_what_no_unloaded_sensor_reads_is_no_good_bias() -> None:
    _, warned = bias_of(np.full((30, 3), [0.0, 600.0, 0.0]), "N")
    assert warned[0].startswith("reads more than 500 N at rest: Y1;")


def test_counts_have_no_usual_noise() -> None:
    with pytest.raises(UnitError, match="take the bias in N or in uT"):
        bias_of(resting(), "count")


def test_a_bias_comes_back_bit_for_bit(tmp_path: Path) -> None:
    # the largest that is read, of which no digit may be lost
    values = np.array([*AWKWARD[:2], np.nextafter(500.0, 0.0)])
    spread = np.array([1.0 / 3.0, 0.0, 2.0])
    known = {"date": "2026-05-01", "calibration": "0123456789abcdef"}
    bias = Bias(values, spread, 30, "N", np.array([True]), **known)
    back = read_bias(write_bias(tmp_path / "b.json", bias))
    assert (back.date, back.calibration) == tuple(known.values())
    assert back.values.tobytes() == values.tobytes()
    assert back.spread.tobytes() == spread.tobytes()
    assert (back.n, back.unit, back.reversed.tolist()) == (30, "N", [True])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"unit": "g"}, "unit = 'g'; next: allowed: N or uT or count"),
        ({"values": [1.0, 2.0, 3.0]}, "3 values, 18 in spread, and 6 in reversed"),
        ({"kind": "calibration"}, "kind = 'calibration'"),
        ({"values": [4e5] * 18}, "beyond 300000 uT"),
        ({"spread": [4e5] * 18}, "beyond 300000 uT"),
        ({"spread": [-1.0] * 18}, "spread below 0"),
        ({"n": 0}, "n = 0"),
    ],
)
def test_a_broken_bias_is_refused(
    tmp_path: Path, change: dict[str, Any], says: str
) -> None:
    path = write_bias(tmp_path / "b.json", bias_of(resting(), "uT")[0])
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(DataError) as caught:
        read_bias(path)
    assert says in str(caught.value)


# The verb


def calibrate_with(*words: str | Path) -> int:
    parser = Parser(prog="holdfast calibrate")
    hand.add_calibrate_arguments(parser)
    return hand.run_calibrate(parser.parse_args([str(word) for word in words]))


def write_loads(
    path: Path, *, n_probings: int = 6, reversed_sensor: int | None = None
) -> FloatArray:
    """A CSV of two fingertips pressed in turn; returns their matrices."""
    rng = np.random.default_rng(3)
    matrix = pressed()[1]
    pieces = []
    for k in range(n_probings):
        ramp = np.concatenate(
            [np.zeros(10), np.sin(np.linspace(0.0, np.pi, 40)), np.zeros(3)]
        )[:, None]
        force = np.zeros((53, 2, 3))
        side = ramp * np.roll(ramp, 3) * rng.normal(0.0, 2.0, 3)
        force[:, k % 2] = ramp * [rng.normal(), rng.normal(), 8.0] + side
        pieces.append(force)
    force = np.concatenate(pieces)
    field = np.einsum("sij,tsj->tsi", np.linalg.inv(matrix), force)
    sign = np.ones((2, 1))
    if reversed_sensor is not None:
        sign[reversed_sensor] = -1.0
    field = sign * (field + np.array([100.0, 50.0, 2000.0]))
    table = np.column_stack(
        [np.arange(len(force)) / 100.0, field.reshape(len(force), 6), force.sum(axis=1)]
    )
    header = ",".join(("Time", *channel_names(2), "Fx", "Fy", "Fz"))
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.12g")
    return matrix


@pytest.mark.parametrize("upside_down", [None, 1])
def test_loads_in_a_csv_file_become_a_calibration(
    tmp_path: Path, upside_down: int | None, capsys: pytest.CaptureFixture[str]
) -> None:
    matrix = write_loads(tmp_path / "loads.csv", reversed_sensor=upside_down)
    words = ("--out", tmp_path / "c.json", "--json", tmp_path / "f.json")
    assert calibrate_with(tmp_path / "loads.csv", *words) == 0
    c = read_calibration(tmp_path / "c.json")
    assert c.shear_gain == pytest.approx(1.0)
    np.testing.assert_allclose(c.matrix_n_per_ut, matrix, atol=1e-8)
    assert c.reversed.tolist() == [False, upside_down == 1]
    np.testing.assert_allclose(
        np.abs(c.rest_ut), [[100.0, 50.0, 2000.0]] * 2, atol=1e-8
    )
    assert (c.source, c.load_unit) == ("loads.csv/loads", "N")
    assert len(c.date) == len("2026-01-02")
    content = json.loads((tmp_path / "f.json").read_text())
    assert content["probings"] == 6
    assert content["errors"]["normal"]["rmse_n"] < 1e-6
    assert content["shear_gain"] == c.shear_gain
    printed = capsys.readouterr().out
    assert "6 probings, 318 rows, 2 sensors" in printed
    assert f"shear gain: {c.shear_gain:.3g}" in printed


def touches(normal_only: bool = False) -> LoadSet:
    """Presses on a sensor of the scenes, whose silicone stiffens; shear at light and firm ones."""
    presses = []
    for firm_n in (1.0, 14.0, 2.0, 14.0):
        shear_n = [] if normal_only else [0.5 * firm_n]
        rows = np.linspace(0.0, 1.0, 30)[:, None]
        loads = [(0.0, 0.0, firm_n)]
        loads += [(x, y, firm_n) for n in shear_n for x, y in ((n, 0.0), (0.0, -n))]
        presses += [rows * np.array([load]) for load in loads]
    rest_ut = dipole_ut(place_m(np.zeros((1, 3)), HEIGHT.default))[0]
    force_n = np.concatenate(presses)
    field_ut = dipole_ut(place_m(force_n, HEIGHT.default)) - rest_ut
    blocks = np.repeat(np.arange(len(presses)), 30)
    return loads_of(field_ut[:, None], force_n, blocks)


def test_the_shear_gain_of_stiffening_silicone_is_that_of_light_touches() -> None:
    gain = fit_calibration(touches(), "made", "").calibration.shear_gain
    assert gain is not None
    assert gain == pytest.approx(shear_gain(), rel=0.1)
    assert gain < 0.75


def test_presses_without_shear_show_no_shear_gain() -> None:
    straight = touches(normal_only=True).force_n
    assert measured_shear_gain(straight, straight) is None


Change = Callable[[FloatArray], FloatArray]


def turned_sign(table: FloatArray) -> FloatArray:
    table[:, -1] *= -1.0
    return table


def in_grams(table: FloatArray) -> FloatArray:
    table[:, -3:] *= 101.97
    return table


def late(table: FloatArray) -> FloatArray:
    table[:, -3:] = np.roll(table[:, -3:], 10, axis=0)
    return table


def nothing(table: FloatArray) -> FloatArray:
    """Loads as they were."""
    return table


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (turned_sign, "the presses have a negative Fz"),
        (in_grams, "grams taken for newtons; next: --load-unit gf"),
        (late, "the loads come 10 rows after the field"),
        (nothing, ""),
    ],
)
def test_what_would_spoil_a_calibration_is_a_warning(
    tmp_path: Path, change: Change, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "loads.csv"
    write_loads(path)
    rewrite(path, change)
    assert calibrate_with(path, "--out", tmp_path / "c.json") == 0
    warned = [one for one in capsys.readouterr().out.splitlines() if "warning" in one]
    assert len(warned) == bool(says)
    assert says in "".join(warned)


@pytest.mark.parametrize("rest_ut", [-20.0, 20.0])
def test_a_magnet_is_turned_over_at_any_rest_that_its_noise_allows(
    tmp_path: Path, rest_ut: float
) -> None:
    def moved(table: FloatArray) -> FloatArray:
        table[:, 6] += rest_ut - 2000.0
        return table

    path = tmp_path / "loads.csv"
    write_loads(path)
    rewrite(path, moved)
    assert read_loads(path, "N").reversed_.tolist() == [False, rest_ut < 0.0]


def test_one_press_is_too_little_to_hold_one_out(tmp_path: Path) -> None:
    write_loads(tmp_path / "loads.csv", n_probings=1)
    with pytest.raises(
        TooFewGroups, match=r"1 probings.*press every fingertip at least twice"
    ):
        calibrate_with(tmp_path / "loads.csv", "--out", tmp_path / "c.json")


@pytest.mark.parametrize(
    ("text", "error", "says"),
    [
        ("Time,X1,Y1,Z1,Fx,Fy\n0,1,2,3,4,5\n", ColumnError, "missing: Fz;"),
        ("Time,X1,Z1,g,Fx,Fy,Fz\n0,1,2,3,4,5,6\n", ColumnError, "missing: Y1;"),
        ("Time,X1,Y1,Z1,Fx,Fy,Fz\n0,1,2,3,4,5,6,7\n", ColumnError, "8 columns"),
        ("Time,X1,Y1,Z1,Fx,Fy,Fz\n0,1,2,much,4,5,6\n", NotANumber, "much"),
    ],
)
def test_a_csv_file_in_another_layout_is_refused(
    tmp_path: Path, text: str, error: type[DataError], says: str
) -> None:
    (tmp_path / "loads.csv").write_text(text)
    with pytest.raises(error, match=f"loads.csv: .*{says}"):
        calibrate_with(tmp_path / "loads.csv", "--out", tmp_path / "c.json")


# -- limits, exactly


@pytest.mark.parametrize(
    ("first", "middle", "last", "drifts"),
    [
        (0.0, 0.0, 0.12, False),
        (0.0, 0.0, 0.1201, True),
        (0.1201, 0.0, 0.0, True),
        (0.0, 0.3, 0.0, False),
        (0.1, 0.3, -0.03, True),
    ],
)
def test_a_drift_lies_between_the_first_and_the_last_third(
    first: float, middle: float, last: float, drifts: bool
) -> None:
    rows = np.zeros((90, 3))
    rows[:, 1] = np.repeat([first, middle, last], 30)
    _, warnings = bias_of(rows, "N")
    assert any("drifts by more than 0.12 N: Y1;" in one for one in warnings) == drifts


def test_a_bias_needs_thirty_rows_and_one_row_in_twenty_may_be_lost() -> None:
    rows = np.zeros((100, 6))
    assert bias_of(rows[:30], "uT")[0].n == 30
    with pytest.raises(EmptyRecording, match="29 rows"):
        bias_of(rows[:29], "uT")
    for lost, warned in ((5, False), (6, True)):
        rows[:lost, 4] = np.inf
        assert bool(bias_of(rows, "N")[1]) == warned
    assert bias_of(rows, "N")[1][0].startswith("up to 6 of 100 rows are lost in Y2; ")
    rows[:, 4] = np.nan
    rows[:29, 4] = 0.0
    with pytest.raises(NotANumber, match="fewer than 30 finite rows in Y2"):
        bias_of(rows, "N")
    rows[29, 4] = 0.0
    bias_of(rows, "N")


def test_noise_is_a_standard_deviation_above_what_an_untouched_hand_has() -> None:
    for unit, most in (("N", 0.12), ("uT", 40.0)):
        rows = np.zeros((100, 3))
        for factor, warned in ((0.999, False), (1.001, True)):
            rows[::2, 2], rows[1::2, 2] = factor * most, -factor * most
            bias, warnings = bias_of(rows, unit)  # type: ignore[arg-type]
            assert bias.spread[2] == pytest.approx(factor * most)
            assert (
                any(f"noise above {most:g} {unit}: Z1;" in one for one in warnings)
                == warned
            )
