"""`holdfast repair`: at most one torn last line is moved aside, and whatever else is wrong is
refused as it is."""

from __future__ import annotations

import json
import resource
import shutil
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hazard_marks import DAMAGED_FILE
from hypothesis import given
from hypothesis import strategies as st

from holdfast.cli.main import main
from holdfast.core.errors import ColumnError, DataError, EmptyRecording, OutputError
from holdfast.core.tactile_file import TactileFile, repair_lines, repair_table
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
        values = np.random.default_rng(k).normal(size=18) + np.where(
            k == 7, np.nan, 0.0
        )
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
    (folder / "meta.json").write_text(
        json.dumps({"recorder": 1, "state": state, "action": "pull"})
    )
    return folder


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def state_of(folder: Path) -> str:
    return str(json.loads((folder / "meta.json").read_text())["state"])


def first_line(change: Damage) -> Damage:
    def damage(data: bytes) -> bytes:
        head, newline, rows = data.partition(b"\n")
        return change(head) + newline + rows

    return damage


DISAGREEMENTS: dict[str, Damage] = {
    "a comma lost from the header": first_line(
        lambda head: head.replace(b"Y1,", b"Y1", 1)
    ),
    "a column appended to the header": first_line(lambda head: head + b",note"),
    "a column cut from the header": first_line(
        lambda head: head.removesuffix(b",valid6")
    ),
    "a known column appended to the header": first_line(
        lambda head: head + b",device_us"
    ),
    "a title above": lambda data: b"grip trial, Monday\n" + data,
    "an empty line above": lambda data: b"\n" + data,
    "the header's newline flipped": lambda data: data.replace(b"\n", b"\x8a", 1),
    "the header's newline lost": lambda data: data.replace(b"\n", b"", 1),
    "a letter of the header flipped": first_line(
        lambda head: head.replace(b"Z4", b"Z\x14")
    ),
    "zeros over the header": first_line(lambda head: bytes(len(head))),
    "no header": lambda data: data.partition(b"\n")[2],
    "other newlines": lambda data: data.replace(b"\n", b"\r"),
    "every newline lost": lambda data: data.replace(b"\n", b""),
    "a second recording behind it": lambda data: data + data,
    "a header as last line": lambda data: data + data.partition(b"\n")[0] + b"\n",
    "a cell lost in the middle": lambda data: b"\n".join(
        cut_cell(data.split(b"\n"), 90)
    ),
    "a cell too many in the last line": lambda data: data[:-1] + b",1\n",
    "text in the last line": lambda data: data[:-2] + b"?\n",
    "a remark at the end": lambda data: data + b"end of recording",
    "two torn lines": lambda data: data + b"2.0,1.5,\n2.01,1.",
    "zeros in the middle": lambda data: data[:9000] + bytes(600) + data[9600:],
}


def cut_cell(lines: list[bytes], at: int) -> list[bytes]:
    return [
        line.rpartition(b",")[0] if k == at else line for k, line in enumerate(lines)
    ]


@DAMAGED_FILE.mark
@pytest.mark.parametrize("state", ["recording", "kept", "interrupted"])
@pytest.mark.parametrize("damage", DISAGREEMENTS.values(), ids=DISAGREEMENTS)
def test_where_header_and_rows_disagree_repair_refuses_and_changes_nothing(
    tmp_path, capsys, recorded, damage, state
):
    folder = trial(tmp_path, damage(recorded), state, EVENT + b"\n{")
    before = bytes_of(folder)
    assert main(["repair", str(tmp_path)]) == 3
    assert "not repaired" in capsys.readouterr().out
    assert bytes_of(folder) == before


def test_the_error_of_a_damaged_header_shows_the_header_that_belongs_there(
    tmp_path, recorded
):
    header = recorded.partition(b"\n")[0].decode()
    for name in (
        "a column appended to the header",
        "a column cut from the header",
        "a title above",
    ):
        path = tmp_path / "tactile.csv"
        path.write_bytes(DISAGREEMENTS[name](recorded))
        with pytest.raises(ColumnError, match=f"nothing was changed.* {header}$"):
            repair_table(path)


@DAMAGED_FILE.mark
@pytest.mark.parametrize("state", ["recording", "kept"])
def test_a_torn_last_line_is_moved_beside_the_file_and_never_deleted(
    tmp_path, capsys, recorded, state
):
    torn = recorded[recorded.rindex(b"\n", 0, -1) + 1 : -9]
    folder = trial(tmp_path, recorded + torn, state, EVENT + b"\n" + EVENT[:20])
    assert main(["repair", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert (
        f"{len(torn)} bytes of an incomplete line removed, {ROWS} samples complete"
        in printed
    )
    assert "tactile.csv.torn" in printed
    assert "20 bytes of an incomplete event removed" in printed
    files = bytes_of(folder)
    assert (files["tactile.csv"], files["tactile.csv.torn"]) == (recorded, torn)
    assert (files["events.jsonl"], files["events.jsonl.torn"]) == (
        EVENT + b"\n",
        EVENT[:20],
    )
    assert state_of(folder) == {"recording": "interrupted", "kept": "kept"}[state]
    assert main(["repair", str(tmp_path)]) == 0
    assert bytes_of(folder) == files
    assert "complete" in capsys.readouterr().out


@DAMAGED_FILE.mark
def test_an_earlier_torn_line_is_never_replaced(tmp_path, recorded):
    path = tmp_path / "tactile.csv"
    for torn in (b"2.0,1", b"2.01,3.5", b"2.0,1"):
        path.write_bytes(recorded + torn)
        repair_table(path)
    assert {one.name: one.read_bytes() for one in tmp_path.iterdir()} == {
        "tactile.csv": recorded,
        "tactile.csv.torn": b"2.0,1",
        "tactile.csv.torn2": b"2.01,3.5",
    }


UNUSUAL: dict[str, Damage] = {
    "as it was recorded": lambda data: data,
    "without the final newline": lambda data: data[:-1],
    "with newlines of Windows": lambda data: data.replace(b"\n", b"\r\n"),
    "the same without the last": lambda data: data.replace(b"\n", b"\r\n")[:-2],
    "half of a newline of Windows": lambda data: data.replace(b"\n", b"\r\n")[:-1],
    "saved by a spreadsheet": lambda data: b"\xef\xbb\xbf" + data,
    "with an empty line at the end": lambda data: data + b"\n",
}


@DAMAGED_FILE.mark
@pytest.mark.parametrize("state", ["recording", "kept"])
@pytest.mark.parametrize("change", UNUSUAL.values(), ids=UNUSUAL)
def test_a_file_whose_rows_are_whole_loses_nothing(tmp_path, recorded, change, state):
    folder = trial(tmp_path, change(recorded), state, EVENT)
    before = bytes_of(folder)
    assert main(["repair", str(tmp_path)]) == 0
    after = bytes_of(folder)
    assert (
        repair_table(folder / "tactile.csv").rows
        == len(read_trial(folder / "tactile.csv").t_s)
        == ROWS
    )
    assert (after.pop("meta.json") == before.pop("meta.json")) is (state == "kept")
    assert after == before
    assert read_events(folder / "events.jsonl") == [json.loads(EVENT)]


@DAMAGED_FILE.mark
@given(data=st.data())
def test_wherever_the_power_was_cut_every_byte_is_in_the_file_or_beside_it(
    recorded, tmp_path_factory, data
):
    head = recorded.index(b"\n") + 1
    cut, zeros = (
        data.draw(st.integers(head, len(recorded))),
        data.draw(st.sampled_from([0, 1, 4096])),
    )
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
    assert {one.name: one.read_bytes() for one in place.iterdir()} == {
        "tactile.csv": damaged
    }
    shutil.rmtree(place)


# -- before the header


@DAMAGED_FILE.mark
@pytest.mark.parametrize("zeros", [0, 512])
@pytest.mark.parametrize(
    "written", ["", "Time,X1", "Time,X1,Y1,Z1,host", "all but the newline"]
)
def test_a_trial_killed_before_its_header_was_written_is_void_once(
    tmp_path, capsys, recorded, written, zeros
):
    begun = (
        recorded.partition(b"\n")[0] if written.startswith("all") else written.encode()
    )
    folder = trial(tmp_path, begun + bytes(zeros), events=b"")
    assert main(["repair", str(tmp_path)]) == 0
    assert "marked as void" in capsys.readouterr().out
    assert state_of(folder) == "void"
    before = bytes_of(folder)
    assert main(["repair", str(tmp_path)]) == 0
    assert "void: no sample was recorded" in capsys.readouterr().out
    assert bytes_of(folder) == before
    assert before["tactile.csv"] == begun + bytes(zeros)


@DAMAGED_FILE.mark
@pytest.mark.parametrize("folder", ["", "p01/cup/pull/trial_1"])
def test_a_trial_killed_before_it_had_a_file_is_void_too(tmp_path, capsys, folder):
    there = trial(tmp_path, b"")
    for name in ("tactile.csv", "events.jsonl"):
        (there / name).unlink()
    assert main(["repair", str(tmp_path / folder)]) == 0
    assert "marked as void" in capsys.readouterr().out
    assert state_of(there) == "void"


@DAMAGED_FILE.mark
@pytest.mark.parametrize("left", [b"", b"Time,X1", None])
def test_a_kept_trial_whose_samples_are_gone_is_refused_and_stays_as_it_is(
    tmp_path, capsys, left
):
    folder = trial(tmp_path, left or b"", "kept")
    if left is None:
        (folder / "tactile.csv").unlink()
    before = bytes_of(folder)
    assert main(["repair", str(tmp_path)]) == 3
    assert "not repaired" in capsys.readouterr().out
    assert bytes_of(folder) == before


@DAMAGED_FILE.mark
def test_a_trial_whose_meta_cannot_be_read_is_refused_before_anything_is_changed(
    tmp_path, recorded
):
    folder = trial(tmp_path, recorded + b"2.0,1")
    (folder / "meta.json").write_text("")
    before = bytes_of(folder)
    assert main(["repair", str(tmp_path)]) == 3
    assert bytes_of(folder) == before


# -- a disk that takes nothing


@pytest.fixture
def full_disk() -> Iterator[Callable[[bool], None]]:
    """Let no file grow beyond two bytes, or let them again."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda full: resource.setrlimit(
        resource.RLIMIT_FSIZE, (2, before[1]) if full else before
    )
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


@DAMAGED_FILE.mark
@pytest.mark.parametrize("torn", [b"2.0,1", b""])
def test_on_a_full_disk_nothing_is_cut_and_repair_ends_it_when_there_is_room(
    tmp_path, recorded, full_disk, torn
):
    folder = trial(tmp_path, recorded + torn)
    before = bytes_of(folder)
    full_disk(True)
    with pytest.raises(OutputError):
        repair(folder)
    full_disk(False)
    assert bytes_of(folder) == before
    repair(folder)
    assert (state_of(folder), (folder / "tactile.csv").read_bytes()) == (
        "interrupted",
        recorded,
    )


def test_events_are_judged_by_their_own_lines(tmp_path):
    path = tmp_path / "events.jsonl"
    for data, whole in (
        (b"", 0),
        (b"{}\n{}", 2),
        (b"{}\n\0\0", 1),
        (b"{}\0", 1),
        (b'{}\n{"a', 1),
    ):
        path.write_bytes(data)
        mended = repair_lines(path, lambda line: line == b"{}")
        assert mended.rows == whole
        assert path.read_bytes() == data[: len(data) - mended.cut_bytes]
    with pytest.raises(EmptyRecording):
        repair_lines(tmp_path / "absent.jsonl", lambda _: True)
