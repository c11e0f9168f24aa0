"""`check --repair`: at most one torn last line is moved aside, and whatever else is wrong is
refused as it is."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from full_disk import full_disk
from hazard_marks import DAMAGED_FILE
from hypothesis import given
from hypothesis import strategies as st
from recorder_bench import meta_of

from holdfast.cli.main import main
from holdfast.core import tactile_file
from holdfast.core.errors import DataError, OutputError
from holdfast.core.tactile_file import TactileFile, repair_table
from holdfast.core.trial_file import read_trial
from holdfast.core.trial_layout import read_events
from holdfast.sessions.recorder.folder import repair

ROWS = 200
Damage = Callable[[bytes], bytes]
EVENT = b'{"t_s": 0.1, "mark": "load_onset", "provenance": "key"}'


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A tactile.csv of six sensors, as the recorder leaves it."""
    path = tmp_path_factory.mktemp("recorded") / "tactile.csv"
    file = TactileFile(path, 18)
    for k in range(ROWS):
        values = np.random.default_rng(k).normal(size=18)
        values += np.nan if k == 7 else 0.0
        file.write(10_000_000 * k, 7 * k, k, values, np.arange(6) != k % 11)
    file.close()
    return path.read_bytes()


def trial(
    folder: Path, data: bytes, state: str = "recording", events: bytes = EVENT + b"\n"
) -> Path:
    """A trial's folder with this in it."""
    folder = folder / "p01/cup/pull/trial_1"
    folder.mkdir(parents=True)
    (folder / "tactile.csv").write_bytes(data)
    (folder / "events.jsonl").write_bytes(events)
    meta = {"recorder": 1, "state": state, "action": "pull"}
    (folder / "meta.json").write_text(json.dumps(meta))
    return folder


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


DISAGREEMENTS: dict[str, Damage] = {
    "a comma lost from the header": lambda data: data.replace(b"Y1,", b"Y1", 1),
    "a second recording behind it": lambda data: data + data,
    "a cell lost in the middle": lambda data: data.replace(b",1\n0.9", b"\n0.9", 1),
    "text in the last line": lambda data: data[:-2] + b"?\n",
    "two torn lines": lambda data: data + b"2.0,1.5,\n2.01,1.",
    "zeros in the middle": lambda data: data[:9000] + bytes(600) + data[9600:],
}


@DAMAGED_FILE.mark
@pytest.mark.parametrize("state", ["recording", "kept"])
@pytest.mark.parametrize("damage", DISAGREEMENTS.values(), ids=DISAGREEMENTS)
def test_where_header_and_rows_disagree_repair_refuses_and_changes_nothing(
    tmp_path, capsys, recorded, damage, state
):
    assert damage(recorded) != recorded
    folder = trial(tmp_path, damage(recorded), state, EVENT + b"\n{")
    before = bytes_of(folder)
    assert main(["check", "--repair", str(tmp_path)]) == 3
    assert "not repaired" in capsys.readouterr().out
    assert bytes_of(folder) == before


@DAMAGED_FILE.mark
@pytest.mark.parametrize("state", ["recording", "kept"])
def test_a_torn_last_line_is_moved_beside_the_file_and_never_deleted(
    tmp_path, capsys, recorded, state
):
    torn = recorded[recorded.rindex(b"\n", 0, -1) + 1 : -9]
    folder = trial(tmp_path, recorded + torn, state, EVENT + b"\n" + EVENT[:20])
    assert main(["check", "--repair", str(tmp_path)]) == 0
    assert "tactile.csv.torn" in capsys.readouterr().out
    files = bytes_of(folder)
    meta = json.loads(files["meta.json"])
    assert meta["state"] == {"recording": "interrupted", "kept": "kept"}[state]
    assert {name: files[name] for name in files if name != "meta.json"} == {
        "tactile.csv": recorded,
        "tactile.csv.torn": torn,
        "events.jsonl": EVENT + b"\n",
        "events.jsonl.torn": EVENT[:20],
    }
    assert main(["check", "--repair", str(tmp_path)]) == 0
    assert bytes_of(folder) == files


@DAMAGED_FILE.mark
def test_an_earlier_torn_line_is_never_replaced(tmp_path, recorded):
    path = tmp_path / "tactile.csv"
    for torn in (b"2.0,1", b"2.01,3.5", b"2.0,1"):
        path.write_bytes(recorded + torn)
        repair_table(path)
    assert bytes_of(tmp_path) == {
        "tactile.csv": recorded,
        "tactile.csv.torn": b"2.0,1",
        "tactile.csv.torn2": b"2.01,3.5",
    }


UNUSUAL: dict[str, Damage] = {
    "as it was recorded": lambda data: data,
    "without the final newline": lambda data: data[:-1],
    "with newlines of Windows": lambda data: data.replace(b"\n", b"\r\n"),
    "half of a newline of Windows": lambda data: data.replace(b"\n", b"\r\n")[:-1],
    "saved by a spreadsheet": lambda data: b"\xef\xbb\xbf" + data,
}


@DAMAGED_FILE.mark
@pytest.mark.parametrize("state", ["recording", "kept"])
@pytest.mark.parametrize("change", UNUSUAL.values(), ids=UNUSUAL)
def test_a_file_whose_rows_are_whole_loses_nothing(tmp_path, recorded, change, state):
    folder = trial(tmp_path, change(recorded), state, EVENT)
    before = bytes_of(folder)
    assert main(["check", "--repair", str(tmp_path)]) == 0
    after = bytes_of(folder)
    table = folder / "tactile.csv"
    assert repair_table(table).rows == len(read_trial(table).t_s) == ROWS
    assert (after.pop("meta.json") == before.pop("meta.json")) is (state == "kept")
    assert after == before
    assert read_events(folder / "events.jsonl") == [json.loads(EVENT)]


@DAMAGED_FILE.mark
@given(data=st.data())
def test_wherever_the_power_was_cut_every_byte_is_in_the_file_or_beside_it(
    recorded, tmp_path_factory, data
):
    head = recorded.index(b"\n") + 1
    cut = data.draw(st.integers(head, len(recorded)))
    zeros = data.draw(st.sampled_from([0, 1, 4096]))
    place = tmp_path_factory.mktemp("cut")
    path = place / "tactile.csv"
    path.write_bytes(recorded[:cut] + bytes(zeros))
    mended = repair_table(path)
    kept = path.read_bytes()
    aside = mended.torn.read_bytes() if mended.torn else b""
    assert kept + aside == recorded[:cut] + bytes(zeros)
    whole = recorded[:cut].count(b"\n") - 1 + (recorded[cut : cut + 1] == b"\n")
    assert (mended.rows, mended.cut_bytes) == (whole, len(aside))
    assert repair_table(path) == type(mended)(whole, 0, None)
    shutil.rmtree(place)


@DAMAGED_FILE.mark
@given(data=st.data())
def test_whatever_a_header_is_changed_to_no_sample_is_lost(
    recorded, tmp_path_factory, data
):
    head = recorded.index(b"\n")
    at, byte = data.draw(st.integers(0, head)), data.draw(st.binary(max_size=2))
    damaged = recorded[:at] + byte + recorded[at + 1 :]
    place = tmp_path_factory.mktemp("header")
    path = place / "tactile.csv"
    path.write_bytes(damaged)
    with suppress(DataError):
        assert repair_table(path).rows == ROWS
    assert bytes_of(place) == {"tactile.csv": damaged}
    shutil.rmtree(place)


# -- before the header


@DAMAGED_FILE.mark
@pytest.mark.parametrize("zeros", [0, 512])
@pytest.mark.parametrize("written", ["", "Time,X1", "all but the newline"])
def test_a_trial_killed_before_its_header_was_written_is_void_once(
    tmp_path, capsys, recorded, written, zeros
):
    header = recorded.partition(b"\n")[0]
    begun = header if written.startswith("all") else written.encode()
    folder = trial(tmp_path, begun + bytes(zeros), events=b"")
    assert main(["check", "--repair", str(tmp_path)]) == 0
    assert "marked as void" in capsys.readouterr().out
    assert meta_of(folder)["state"] == "void"
    before = bytes_of(folder)
    assert main(["check", "--repair", str(tmp_path)]) == 0
    assert "void: no sample was recorded" in capsys.readouterr().out
    assert bytes_of(folder) == before
    assert before["tactile.csv"] == begun + bytes(zeros)


@DAMAGED_FILE.mark
@pytest.mark.parametrize("folder", ["", "p01/cup/pull/trial_1"])
def test_a_trial_killed_before_it_had_a_file_is_void_too(tmp_path, capsys, folder):
    there = trial(tmp_path, b"")
    for name in ("tactile.csv", "events.jsonl"):
        (there / name).unlink()
    assert main(["check", "--repair", str(tmp_path / folder)]) == 0
    assert "marked as void" in capsys.readouterr().out
    assert meta_of(there)["state"] == "void"


@DAMAGED_FILE.mark
@pytest.mark.parametrize("left", [b"", b"Time,X1", "no table", "no meta"])
def test_a_trial_that_lost_its_samples_or_its_meta_is_refused_and_stays_as_it_is(
    tmp_path, capsys, recorded, left
):
    table = recorded + b"2.0,1" if isinstance(left, str) else left
    folder = trial(tmp_path, table, "kept")
    if left == "no table":
        (folder / "tactile.csv").unlink()
    if left == "no meta":
        (folder / "meta.json").write_text("")
    before = bytes_of(folder)
    assert main(["check", "--repair", str(tmp_path)]) == 3
    assert "not repaired" in capsys.readouterr().out
    assert bytes_of(folder) == before


# -- a disk that takes nothing


@DAMAGED_FILE.mark
@pytest.mark.parametrize("torn", [b"2.0,1", b""])
def test_on_a_full_disk_nothing_is_cut_and_repair_ends_it_when_there_is_room(
    tmp_path, recorded, torn
):
    folder = trial(tmp_path, recorded + torn)
    before = bytes_of(folder)
    with full_disk(room=2), pytest.raises(OutputError):
        repair(folder)
    assert bytes_of(folder) == before
    repair(folder)
    assert meta_of(folder)["state"] == "interrupted"
    assert (folder / "tactile.csv").read_bytes() == recorded


def test_a_line_has_all_digits_and_a_disk_is_synced_once_a_second_of_samples(
    tmp_path, monkeypatch
):
    synced: list[int] = []
    monkeypatch.setattr(tactile_file.os, "fsync", synced.append)
    file = TactileFile(tmp_path / "tactile.csv", 3)
    times_ns = [-5, 999_999_994, 999_999_995, 1_999_999_994, 1_999_999_995]
    values = np.array([0.1, np.nan, -1e-300])
    for k, t_ns in enumerate(times_ns):
        file.write(t_ns, 7, k, values, np.array([k > 0]))
    file.close()
    # twice by the time of the samples, and at the end
    assert len(synced) == 3
    lines = (tmp_path / "tactile.csv").read_text().splitlines()
    assert lines[0] == "Time,X1,Y1,Z1,host_ns,sequence,valid1"
    assert lines[1] == "0.000000000,0.1,nan,-1e-300,7,0,0"
    assert lines[4] == "1.999999999,0.1,nan,-1e-300,7,3,1"
