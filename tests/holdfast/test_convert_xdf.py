"""`holdfast convert FILE.xdf --to trials`: an XDF session becomes trials for training."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from command_line import fails
from xdf_file import clock_offsets, markers, samples, stream_header, xdf_bytes

from holdfast.core.contract import channel_names
from holdfast.core.trial_file import read_trial
from holdfast.training.datasets import load

RATE_HZ, ROWS = 100.0, 900
SENDER_S, OFFSET_S = 5000.0, -4000.0
"""The tactile stream's clock at its first sample, and what makes it the recorder's clock."""
START_S = SENDER_S + OFFSET_S
LOST = (200, 201, 202)
ORDER = [*range(17, -1, -1)]
"""The stream sends its channels the other way round, and says so by their labels."""
SESSION = [
    (0.5, "begin soft-ball/pull"),
    (0.5, "nothing"),
    (1.5, "grasp"),
    (3.0, "a remark"),
    (3.5, "risky_slip"),
    (4.0, "nothing"),
    (4.5, "end"),
    (5.0, "begin soft-ball/pass"),
    (5.0, "nothing"),
    (6.0, "grasp"),
    (7.0, "safe_slip"),
    (8.0, "nothing"),
]


@pytest.fixture(scope="module")
def values() -> np.ndarray:
    noise = np.random.default_rng(3).normal(0.0, 0.02, (ROWS, 18))
    t_s = np.arange(ROWS) / RATE_HZ
    held = ((t_s > 1.5) & (t_s < 4.0)) | ((t_s > 6.0) & (t_s < 8.0))
    noise[:, 2::3] += 3.0 * held[:, None]
    return noise


def described(unit: str) -> str:
    names = channel_names(6)
    return "".join(
        f"<channel><label>{names[k]}</label><unit>{unit}</unit></channel>"
        for k in ORDER
    )


def write_session(
    path: Path, values: np.ndarray, texts=SESSION, unit: str = "N"
) -> None:
    t_s = np.arange(ROWS) / RATE_HZ
    kept = np.setdiff1d(np.arange(ROWS), LOST)
    path.write_bytes(
        xdf_bytes(
            [
                stream_header(1, "Fingers", "double64", 18, RATE_HZ, described(unit)),
                stream_header(2, "Markers", "string", 1, 0.0),
                samples(1, SENDER_S + t_s[kept], values[kept][:, ORDER]),
                markers(2, [(START_S + at_s, text) for at_s, text in texts]),
                clock_offsets(1, [START_S, START_S + 5.0], OFFSET_S),
                clock_offsets(2, [START_S, START_S + 5.0], 0.0),
            ]
        )
    )


def test_markers_cut_a_session_into_trials_with_phases(run, tmp_path, values):
    write_session(tmp_path / "s.xdf", values)
    words = ("convert", tmp_path / "s.xdf", "--to", "trials", "--out", tmp_path / "set")
    code, out, err = run(*words, "--person", "p01")
    assert code == 0, err
    places = [
        tmp_path / f"set/p01/soft-ball/{action}/trial_1.csv"
        for action in ("pull", "pass")
    ]
    assert out.splitlines()[:2] == [str(place) for place in places]
    pull, give = (read_trial(place) for place in places)
    assert (len(pull.t_s), len(give.t_s)) == (400, 400)
    np.testing.assert_allclose(give.raw, values[500:900], rtol=1e-8)
    lost = [row - 50 for row in LOST]
    assert np.flatnonzero(~pull.valid.any(axis=1)).tolist() == lost
    kept = np.setdiff1d(np.arange(400), lost)
    np.testing.assert_allclose(pull.raw[kept], values[50:450][kept], rtol=1e-8)
    data = load(tmp_path / "set", windows="natural")
    phases = {
        one.action: [(p.first, p.situation) for p in one.phases]
        for one in data.recordings
    }
    assert phases == {
        "pull": [(0, 0), (100, 1), (300, 3), (350, 0)],
        "pass": [(0, 0), (100, 1), (200, 2), (300, 0)],
    }
    assert json.loads((tmp_path / "set/meta.json").read_text()) == {"unit": "N"}


def test_a_second_recording_continues_the_numbers_and_keeps_the_unit(
    run, tmp_path, values
):
    write_session(tmp_path / "s.xdf", values, SESSION[1:6])
    write_session(tmp_path / "u.xdf", values, SESSION[1:6], unit="microtesla")
    words = ("--to", "trials", "--out", tmp_path / "set", "--person", "p01")
    named = ("--object", "cup", "--action", "pull")
    for _ in range(2):
        assert run("convert", tmp_path / "s.xdf", *words, *named)[0] == 0
    folder = tmp_path / "set/p01/cup/pull"
    assert sorted(path.name for path in folder.glob("*.csv")) == [
        "trial_1.csv",
        "trial_2.csv",
    ]
    says = "the set is in N, the stream in uT"
    fails(run, 3, "UnitError", "convert", tmp_path / "u.xdf", *words, *named, says=says)


def test_what_a_file_lacks_is_named(run, tmp_path, values):
    write_session(tmp_path / "s.xdf", values, SESSION[1:6], unit="")
    words = ("convert", tmp_path / "s.xdf", "--to", "trials", "--out", tmp_path / "set")
    fails(run, 2, "UsageError", *words, says="--person p01")
    words = (*words, "--person", "p01")
    fails(run, 3, "UnitError", *words, says="--unit N")
    words = (*words, "--unit", "N")
    fails(run, 3, "LabelError", *words, says="begin OBJECT/ACTION")
    fails(
        run,
        3,
        "LabelError",
        *words,
        "--object",
        "../cup",
        "--action",
        "pull",
        says="OBJECT",
    )
    fails(run, 3, "DataNotFound", *words, "--stream", "Other", says="Fingers")
    assert not (tmp_path / "set").exists()


@pytest.mark.parametrize(
    "content", [b"", b"not XDF at all", b"XDF:\x04" + struct.pack("<I", 9)]
)
def test_a_file_that_is_no_xdf_is_an_error(run, tmp_path, content):
    (tmp_path / "s.xdf").write_bytes(content)
    words = ("convert", tmp_path / "s.xdf", "--to", "trials", "--out", tmp_path / "set")
    code, _, err = run(*words, "--person", "p01")
    assert code == 3
    assert "Traceback" not in err
    assert err.startswith("error: ")


@pytest.mark.parametrize(
    ("stamps", "says"),
    [
        (np.repeat(np.arange(ROWS // 2), 2) / RATE_HZ, "stand still"),
        (
            np.where(np.arange(ROWS) == ROWS - 1, 1e15, np.arange(ROWS) / RATE_HZ),
            "no times",
        ),
        (
            np.arange(ROWS) / RATE_HZ + 60.0 * (np.arange(ROWS) > 500),
            "5999 samples are missing",
        ),
    ],
)
def test_stamps_that_are_no_recording_are_refused(run, tmp_path, values, stamps, says):
    header = stream_header(1, "Fingers", "double64", 18, RATE_HZ, described("N"))
    (tmp_path / "s.xdf").write_bytes(
        xdf_bytes([header, samples(1, START_S + stamps, values)])
    )
    words = ("convert", tmp_path / "s.xdf", "--to", "trials", "--out", tmp_path / "set")
    named = ("--person", "p01", "--object", "cup", "--action", "pull")
    fails(run, 3, "TimeError", *words, *named, says=says)
    assert not (tmp_path / "set").exists()
