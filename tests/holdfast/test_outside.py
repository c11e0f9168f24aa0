"""Huge, hostile and mistaken input: a typed error of one line, before memory or time is spent on
it."""

from __future__ import annotations

import json
import os
import re
import struct
import tracemalloc
import warnings
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import skops.io
from hazard_marks import AMBIGUOUS, HUGE_INPUT, MISTAKEN_ARGUMENT, TERMINAL_ESCAPES
from hypothesis import given
from hypothesis import strategies as st
from small_model import artifact, card_of, sealed_bytes, spec, with_metadata

from holdfast.cli.command import finish
from holdfast.cli.main import main
from holdfast.core import archives, reading
from holdfast.core.errors import (
    LONGEST_LINE,
    ArtifactError,
    CardError,
    ColumnError,
    DataError,
    DataNotFound,
    HoldfastError,
    NotAModel,
    NotANumber,
    TimeError,
    TooLarge,
    UsageError,
    one_line,
    visible,
)
from holdfast.core.reading import MOST_DOCUMENT_BYTES, MOST_LINE_BYTES, json_of
from holdfast.core.trial_file import check_columns, read_trial
from holdfast.core.trial_layout import read_json
from holdfast.drivers.calibration import read_bias, read_calibration
from holdfast.drivers.camera.recording import read_about, read_tracks
from holdfast.drivers.camera.sources import read_frames
from holdfast.drivers.replay import open_replay
from holdfast.drivers.virtual.clock import VirtualClock
from holdfast.drivers.virtual.faults import read_fault
from holdfast.edge_runtime.model_file import CARD_KEY, read_sealed
from holdfast.edge_runtime.monitor import GripMonitor, Model
from holdfast.export.artifact import read_artifact, write_artifact
from holdfast.export.exporting import export_artifact
from holdfast.live.hand_sources import open_bus, open_live
from holdfast.live.sources import open_source
from holdfast.sessions.known_loads import read_load_sets
from holdfast.sessions.onset import _starts_s
from holdfast.sessions.recorder.labels import read_events, read_meta
from holdfast.sessions.recorder.protocol import read_protocol
from holdfast.simulation.scene_file import read_scene_file
from holdfast.training.datasets.public_files import read_arrays, read_table

MB = 1 << 20


@contextmanager
def little_memory(most_bytes: int) -> Iterator[None]:
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < most_bytes
    finally:
        tracemalloc.stop()


def sparse(path: Path, size: int) -> Path:
    """A file of so many zero bytes that takes no room on the disk."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        file.truncate(size)
    return path


TABLES: dict[str, tuple[str, Callable[[Path], object]]] = {
    "a trial": ("trial_1.csv", read_trial),
    "a trial that is replayed": ("tactile.csv", lambda path: open_replay(path.parent)),
    "loads to calibrate by": ("loads.csv", read_load_sets),
    "tags of a camera": ("tags.csv", lambda path: read_tracks(path.parent)),
    "a table of a data set": ("trials.csv", read_table),
    "the host's time of a trial": (
        "tactile.csv",
        lambda path: _starts_s(path.parent, None),  # type: ignore[arg-type]
    ),
}


@HUGE_INPUT.mark
@pytest.mark.parametrize("kind", TABLES)
def test_a_line_of_100_mb_is_refused_and_not_kept(tmp_path: Path, kind: str) -> None:
    name, read = TABLES[kind]
    path = sparse(tmp_path / name, 100 * MB)
    with little_memory(2 * MB), pytest.raises(TooLarge, match="line 1 is longer"):
        read(path)


@HUGE_INPUT.mark
@pytest.mark.parametrize("kind", TABLES)
@pytest.mark.parametrize("at", ["header", "row"])
def test_a_cell_that_csv_does_not_take_is_a_typed_error(
    tmp_path: Path, kind: str, at: str
) -> None:
    name, read = TABLES[kind]
    cell, path = "1" * 131_073, tmp_path / name
    path.write_text(
        f"{cell}\n0\n"
        if at == "header"
        else f"Time,X1,Y1,Z1\n0,1,2,3\n0.1,{cell},2,3\n",
        encoding="ascii",
    )
    with pytest.raises(DataError):
        read(path)


@HUGE_INPUT.mark
def test_a_quoted_cell_over_many_lines_is_a_typed_error(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(
        'Time,X1,Y1,Z1\n0,1,2,3\n0.1,"' + "1\n" * 70_000 + '",2,3\n', encoding="ascii"
    )
    with pytest.raises(NotANumber):
        read_trial(tmp_path / "t.csv")


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@given(lengths=st.lists(st.integers(0, 300), max_size=40), chunk=st.integers(1, 400))
def test_lines_are_measured_alike_wherever_the_file_is_cut(
    tmp_path_factory: pytest.TempPathFactory, end: str, lengths: list[int], chunk: int
) -> None:
    """With limits of its own: 200 bytes a line, read so many at a time."""
    path = tmp_path_factory.getbasetemp() / "lines.csv"
    path.write_bytes(end.join("1" * length for length in lengths).encode())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reading, "MOST_LINE_BYTES", 200)
        patch.setattr(reading, "CHUNK_BYTES", min(chunk, 200))
        if max(lengths, default=0) > 200:
            with pytest.raises(TooLarge):
                reading.require_lines(path)
        else:
            reading.require_lines(path)


class Counted(str):
    """A column's name that counts how often it is compared."""

    compared = 0

    def __eq__(self, other: object) -> bool:
        Counted.compared += 1
        return str.__eq__(self, other)

    __hash__ = str.__hash__


@HUGE_INPUT.mark
@pytest.mark.parametrize("name", ["A{}", "X{}", "same", "valid{}"])
def test_a_hundred_thousand_columns_are_looked_at_once_each(name: str) -> None:
    """Counted in comparisons, which were 10^10: the check of the columns takes no longer than
    reading them."""
    header = [
        Counted(one) for one in ("Time", *(name.format(k) for k in range(100_000)))
    ]
    Counted.compared = 0
    with pytest.raises(ColumnError) as caught:
        check_columns(list[str](header), Path("t.csv"))
    assert Counted.compared < 20 * len(header)
    assert len(str(caught.value)) < 1000


@HUGE_INPUT.mark
def test_a_file_of_a_hundred_thousand_columns_is_refused(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(
        "Time," + ",".join(f"A{k}" for k in range(100_000)) + "\n", encoding="ascii"
    )
    with pytest.raises(TooLarge):
        read_trial(tmp_path / "t.csv")


# -- archives

ARRAYS: dict[str, Callable[[Path], object]] = {
    "frames": read_frames,
    "a data set": lambda path: read_arrays(path, {"frames": (None,)}),
}


def npy(shape: str, data: bytes = b"") -> bytes:
    """An array whose header says what it likes."""
    head = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".encode()
    head += b" " * (-(len(head) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head + data


def packed(path: Path, **members: bytes) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(f"{name}.npy", data)
    return path


@HUGE_INPUT.mark
@pytest.mark.parametrize("kind", ARRAYS)
@pytest.mark.parametrize(
    "shape",
    [
        "(1000000000,)",
        "(2**62,)",
        "(1000000000000000000000000,)",
        "(-1,)",
        "(2, 99999)",
    ],
)
def test_an_array_that_claims_more_than_it_has_is_refused_by_its_header(
    tmp_path: Path, kind: str, shape: str
) -> None:
    path = packed(
        tmp_path / "a.npz", frames=npy(shape, bytes(16)), time_s=npy("(2,)", bytes(16))
    )
    with little_memory(2 * MB), pytest.raises(DataError):
        ARRAYS[kind](path)


@HUGE_INPUT.mark
@pytest.mark.parametrize("kind", ARRAYS)
def test_an_archive_that_inflates_a_thousandfold_is_refused_unread(
    tmp_path: Path, kind: str
) -> None:
    path = packed(tmp_path / "a.npz", frames=npy("(4194304,)", bytes(32 * MB)))
    with little_memory(2 * MB), pytest.raises(TooLarge, match="times its size"):
        ARRAYS[kind](path)


@HUGE_INPUT.mark
@pytest.mark.parametrize("kind", ARRAYS)
def test_an_archive_that_says_it_has_8_gb_is_refused_unread(
    tmp_path: Path, kind: str
) -> None:
    path = packed(tmp_path / "a.npz", frames=npy("(2,)", bytes(16)))
    data = bytearray(path.read_bytes())
    at = data.rfind(b"PK\x01\x02")
    data[at + 24 : at + 28] = struct.pack("<I", 2**32 - 2)
    data[at + 20 : at + 24] = struct.pack("<I", 2**31)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("more.npy", b"x")
    path.write_bytes(bytes(data))
    with pytest.MonkeyPatch.context() as patch, little_memory(2 * MB):
        patch.setattr(archives, "MOST_BYTES", 2**32 - 3)
        with pytest.raises(TooLarge, match=r"4\.3 GB"):
            ARRAYS[kind](path)


@HUGE_INPUT.mark
def test_a_list_of_a_million_members_is_not_read(tmp_path: Path) -> None:
    path = packed(tmp_path / "a.npz", frames=npy("(2,)", bytes(16)))
    data = path.read_bytes()
    entry, end = (
        data[data.rfind(b"PK\x01\x02") : data.rfind(b"PK\x05\x06")],
        data[data.rfind(b"PK\x05\x06") :],
    )
    many = entry * 30_000
    result = end[:8] + struct.pack("<HHI", 30_000, 30_000, len(many)) + end[16:]
    path.write_bytes(data[: data.rfind(b"PK\x01\x02")] + many + result)
    with little_memory(2 * MB), pytest.raises(TooLarge, match="list of members"):
        read_frames(path)


@HUGE_INPUT.mark
def test_an_array_without_an_archive_is_not_read_at_all(tmp_path: Path) -> None:
    (tmp_path / "a.npz").write_bytes(npy("(1000000000,)"))
    with little_memory(2 * MB), pytest.raises(DataError):
        read_frames(tmp_path / "a.npz")


@pytest.mark.parametrize("kind", ARRAYS)
@pytest.mark.parametrize("compression", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_an_archive_in_another_compression_is_refused(
    tmp_path: Path, kind: str, compression: int
) -> None:
    with zipfile.ZipFile(tmp_path / "a.npz", "w", compression) as archive:
        archive.writestr("frames.npy", npy("(2,)", bytes(16)))
    with pytest.raises(DataError):
        ARRAYS[kind](tmp_path / "a.npz")


def written(folder: Path) -> Path:
    write_artifact(folder, artifact(spec()))
    return folder


@HUGE_INPUT.mark
@pytest.mark.parametrize("name", ["rows.npz", "situation.skops"])
def test_an_artifact_whose_parts_would_fill_the_memory_is_refused_unread(
    tmp_path: Path, name: str
) -> None:
    folder = written(tmp_path / "artifact")
    packed(folder / name, rows=npy("(4194304,)", bytes(32 * MB)))
    with little_memory(4 * MB), pytest.raises(ArtifactError, match="times its size"):
        read_artifact(folder)


def test_an_archive_of_ours_is_read_as_before(tmp_path: Path) -> None:
    folder = written(tmp_path / "artifact")
    assert len(read_artifact(folder).heads) == 2
    archives.require_modest_archive(folder / "situation.skops")
    assert skops.io.get_untrusted_types(file=folder / "situation.skops") == [
        "sklearn.tree._tree.Tree"
    ]
    np.savez_compressed(tmp_path / "z.npz", a=np.zeros((100, 1000)), b=np.arange(3))
    archives.require_modest_archive(tmp_path / "z.npz")


# -- documents

DOCUMENTS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "a calibration": ("c.json", read_calibration),
    "a bias": ("b.json", read_bias),
    "a truth beside a trial": ("t.json", read_json),
    "a trial's meta": ("meta.json", lambda path: read_meta(path.parent)),
    "a trial's events": ("events.jsonl", read_events),
    "a camera's numbers": ("camera.json", lambda path: read_about(path.parent)),
    "a scene's card": ("card.toml", lambda path: read_scene_file(str(path))),
    "a protocol": ("protocol.toml", read_protocol),
    "an artifact's index": ("artifact.json", lambda path: read_artifact(path.parent)),
}


@HUGE_INPUT.mark
@pytest.mark.parametrize("kind", DOCUMENTS)
def test_a_document_of_a_gigabyte_is_refused_unread(tmp_path: Path, kind: str) -> None:
    name, read = DOCUMENTS[kind]
    path = sparse(tmp_path / name, 1 << 30)
    with (
        little_memory(3 * MOST_DOCUMENT_BYTES),
        pytest.raises((TooLarge, ArtifactError)),
    ):
        read(path)


@HUGE_INPUT.mark
def test_a_model_file_of_a_terabyte_is_refused_unread(tmp_path: Path) -> None:
    with pytest.MonkeyPatch.context() as patch, little_memory(3 * MB):
        patch.setattr("holdfast.edge_runtime.model_file.MOST_BYTES", MB)
        with pytest.raises(NotAModel, match="larger than 1 MiB"):
            read_sealed(sparse(tmp_path / "m.onnx", 1 << 40))


# -- devices, links and names of files

ANY_FILE = TABLES | DOCUMENTS | {name: ("a.npz", read) for name, read in ARRAYS.items()}


@HUGE_INPUT.mark
@pytest.mark.parametrize("device", ["/dev/zero", "/dev/null", "a pipe"])
@pytest.mark.parametrize("kind", ANY_FILE)
def test_a_device_or_a_pipe_is_refused_unread(
    tmp_path: Path, kind: str, device: str
) -> None:
    name, read = ANY_FILE[kind]
    if device == "a pipe":
        os.mkfifo(tmp_path / name)
    else:
        (tmp_path / name).symlink_to(device)
    with little_memory(2 * MB), pytest.raises((DataNotFound, CardError, ArtifactError)):
        read(tmp_path / name)


@HUGE_INPUT.mark
@pytest.mark.parametrize("part", ["forest", "network"])
@pytest.mark.parametrize(
    "named",
    ["/dev/zero", "pipe", "zero", "../outside.skops", "link", ".", "", "a\0b", 7, [7]],
)
def test_an_artifact_names_regular_files_of_its_folder_only(
    tmp_path: Path, part: str, named: object
) -> None:
    folder = written(tmp_path / "artifact")
    outside = (folder / "situation.skops").rename(tmp_path / "outside.skops")
    (folder / "link").symlink_to(outside)
    (folder / "zero").symlink_to("/dev/zero")
    os.mkfifo(folder / "pipe")
    index = json.loads((folder / "artifact.json").read_text("utf-8"))
    index["heads"]["situation"][part] = named
    (folder / "artifact.json").write_text(json.dumps(index), encoding="utf-8")
    with (
        little_memory(4 * MB),
        pytest.raises(ArtifactError, match="is not a file in this folder"),
    ):
        read_artifact(folder)


@HUGE_INPUT.mark
def test_an_artifact_s_rows_may_be_no_link_to_a_device(tmp_path: Path) -> None:
    folder = written(tmp_path / "artifact")
    (folder / "rows.npz").unlink()
    (folder / "rows.npz").symlink_to("/dev/zero")
    with little_memory(4 * MB), pytest.raises(ArtifactError):
        read_artifact(folder)


# -- JSON that two programs would read differently

JSONS = [kind for kind, (name, _) in DOCUMENTS.items() if ".json" in name]


@AMBIGUOUS.mark
@pytest.mark.parametrize("kind", JSONS)
@pytest.mark.parametrize(
    "text",
    [
        '{"unit": "N", "unit": "uT"}',
        '{"a": [{"b": 1, "b": 1}]}',
        '{"a": 9223372036854775808}',
        '{"a": 1e999}',
        '{"a": NaN}',
        '{"a": -Infinity}',
    ],
)
def test_a_key_that_comes_twice_and_a_number_that_is_none_are_refused(
    tmp_path: Path, kind: str, text: str
) -> None:
    name, read = DOCUMENTS[kind]
    (tmp_path / name).write_text(text + "\n", encoding="ascii")
    with pytest.raises((DataError, ArtifactError)) as caught:
        read(tmp_path / name)
    # refused as JSON, and not for what the object lacks
    said = str(caught.value)
    assert "ValueError" in said or "readable" in said or "twice" in said


@AMBIGUOUS.mark
@pytest.mark.parametrize(
    ("number", "says"),
    [
        ("nan", r"record.rate_hz = nan"),
        ("-inf", r"record.rate_hz = -inf"),
        ("1e999", r"record.rate_hz = inf"),
        (f"{2**63}", "not valid TOML: record.rate_hz needs more than 64 bits"),
    ],
)
def test_a_card_names_the_key_of_a_number_that_is_none(
    tmp_path: Path, number: str, says: str
) -> None:
    text = f"[record]\nrate_hz = {number}\n"
    (tmp_path / "card.toml").write_text(text, encoding="ascii")
    with pytest.raises(CardError, match=says):
        read_scene_file(str(tmp_path / "card.toml"))


@pytest.mark.parametrize(
    "text", ["9223372036854775807", "-9223372036854775808", "[true, null, 1e308]"]
)
def test_the_largest_numbers_are_read(text: str) -> None:
    assert json_of(text) == json.loads(text)


# -- rates

RATES = ["1e-300", "5e-324", "1e300", "-1", "0", "NaN", "1e999", "true", '"150"']


@AMBIGUOUS.mark
@pytest.mark.parametrize("rate", RATES)
def test_a_model_s_card_has_a_possible_rate(tmp_path: Path, rate: str) -> None:
    data = sealed_bytes()
    card = json.dumps(card_of(data)).replace('"rate_hz": 50.0', f'"rate_hz": {rate}')
    (tmp_path / "m.onnx").write_bytes(with_metadata(data, **{CARD_KEY: card}))
    with pytest.raises(NotAModel):
        GripMonitor(Model(tmp_path / "m.onnx"))


@AMBIGUOUS.mark
@pytest.mark.parametrize("rate", [rate for rate in RATES if rate != "NaN"])
def test_a_scene_has_a_possible_rate(tmp_path: Path, rate: str) -> None:
    text = read_scene_file("pull-soft-ball").text
    with_rate = re.sub(r"rate_hz *= *\S+", f"rate_hz = {rate}", text)
    assert with_rate != text
    (tmp_path / "card.toml").write_text(with_rate, encoding="utf-8")
    with pytest.raises(CardError):
        read_scene_file(str(tmp_path / "card.toml"))


@AMBIGUOUS.mark
@pytest.mark.parametrize("step_s", ["1e-300", "1e-9", "1e5", "1e300"])
def test_a_recording_has_a_possible_rate(tmp_path: Path, step_s: str) -> None:
    rows = "".join(f"{k * float(step_s)!r},1,2,3\n" for k in range(9))
    (tmp_path / "t.csv").write_text("Time,X1,Y1,Z1\n" + rows, encoding="ascii")
    with pytest.raises(TimeError):
        read_trial(tmp_path / "t.csv")


@AMBIGUOUS.mark
@pytest.mark.parametrize("words", [["record", "--rate"], ["bias", "--seconds"]])
@pytest.mark.parametrize("number", ["1e-300", "1e300", "nan", "-1", "0"])
def test_a_time_or_a_rate_on_the_command_line_is_possible(
    words: list[str], number: str, capsys
) -> None:
    assert main([*words, number]) == UsageError.exit_code
    assert "is not a number above 0, from" in capsys.readouterr().err


# -- what reaches a terminal

ESCAPES = "\x1b[2J\x1b]0;title\x07\x9b31m\u202egpj.exe\u2066\u200b\x7f\r\b"


def harmless(text: str) -> bool:
    return all(line.isprintable() for line in text.split("\n"))


@TERMINAL_ESCAPES.mark
@given(text=st.text(st.characters()))
def test_whatever_a_message_says_it_is_one_printable_line(text: str) -> None:
    error = HoldfastError(text, where=text, cause=text, next_step=text)
    assert str(error).isprintable()
    assert len(str(error)) <= LONGEST_LINE + 4
    assert visible(text).isprintable()
    assert one_line("plain words, µT and 日本") == "plain words, µT and 日本"


@TERMINAL_ESCAPES.mark
@pytest.mark.parametrize(
    "words",
    [
        ["replay", "{}", "x.csv"],
        ["replay", "{model}", "{}"],
        ["{}"],
        ["simulate", "{}", "--out", "{}"],
        ["run", "{model}", "--source", "{}"],
        ["train", "--data", "{}", "--out", "y"],
        ["export", "{}"],
        ["calibrate", "{}", "--out", "x"],
        ["repair", "{}"],
        ["evaluate", "{model}", "--data", "{}"],
        ["scan", "{}"],
    ],
    ids=lambda words: words[0],
)
def test_no_escape_in_an_argument_reaches_the_terminal(
    words: list[str], tmp_path: Path, capfd, monkeypatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "m.onnx").write_bytes(sealed_bytes())
    assert (
        main(
            [word.replace("{}", ESCAPES).replace("{model}", "m.onnx") for word in words]
        )
        != 0
    )
    out, err = capfd.readouterr()
    assert harmless(out)
    assert harmless(err)


@TERMINAL_ESCAPES.mark
def test_no_escape_in_a_column_a_file_or_a_cell_reaches_the_terminal(
    tmp_path: Path, capfd
) -> None:
    names = (
        f"Time,X1,Y1,Z1,{ESCAPES}",
        f"{ESCAPES},X1",
        f"Time,X1,Y1,Z1\n0,{ESCAPES},1,1\n1,1,1,1",
    )
    for head in names:
        path = tmp_path / "trial\x1b[2J_1.csv"
        path.write_text(f"{head}\n", encoding="utf-8", newline="")
        with pytest.raises(DataError) as caught:
            read_trial(path)
        assert str(caught.value).isprintable()


@TERMINAL_ESCAPES.mark
def test_no_escape_in_a_scenes_title_or_in_a_trials_folder_reaches_the_terminal(
    tmp_path: Path, capfd
) -> None:
    card = '[record]\nrate_hz=50\n[[trials]]\nobjects=["soft-ball"]\naction="pull"\ncount=1\n'
    path = tmp_path / "card\x1b[2J.toml"
    path.write_text(
        f"title={json.dumps(ESCAPES.replace(chr(127), ''))}\n{card}", encoding="utf-8"
    )
    code = main(["simulate", str(path), "--out", str(tmp_path / "out\x1b[2J")])
    trial = tmp_path / "person\x1b[31m" / "trial_1"
    trial.mkdir(parents=True)
    (trial / "meta.json").write_text('{"state": "kept"}', encoding="utf-8")
    (trial / "tactile.csv").write_text("Time,X1,Y1,Z1\n0,1,2,3\n", encoding="utf-8")
    main(["repair", str(tmp_path / "person\x1b[31m")])
    out, err = capfd.readouterr()
    assert harmless(out), out
    assert harmless(err), err
    assert code == 0, err
    assert "\\x1b[2J" in out
    assert "\\x1b[31m" in out


@TERMINAL_ESCAPES.mark
def test_no_escape_in_a_warning_or_an_error_of_the_system_reaches_the_terminal(
    capfd, monkeypatch
) -> None:
    def warned(_: object) -> int:
        warnings.warn(ESCAPES, UserWarning, stacklevel=1)
        raise OSError(f"no {ESCAPES}")

    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        assert finish(warned, []) == 5
    assert harmless(capfd.readouterr().err)


# -- arguments that mean something else


@MISTAKEN_ARGUMENT.mark
@pytest.mark.parametrize(
    ("word", "meant"),
    [
        ("ft232h", "usb://ft232h"),
        ("ft232h", "virtual://ft232h"),
        ("ft232h?number=1", "usb://ft232h?number=1"),
        ("/dev/i2c-1", "i2c://1"),
        ("i2c-7", "i2c://7"),
        ("apple", "sim://apple"),
        ("thesis?trial=3", "sim://thesis?trial=3"),
        ("sim:apple", "sim://apple"),
        ("replay:/x.csv", "replay://x.csv"),
        ("usb:/ft232h", "usb://ft232h"),
    ],
)
def test_a_source_without_its_scheme_is_refused_with_what_to_write(
    word: str, meant: str, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError) as caught:
        open_source(word)
    assert f"write {meant}" in str(caught.value) or f", {meant}" in str(caught.value)


@MISTAKEN_ARGUMENT.mark
def test_a_live_source_and_a_scan_without_a_scheme_are_refused_too(
    tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.chdir(tmp_path)
    clock = VirtualClock()
    with pytest.raises(UsageError, match="write usb://ft232h for the bridge itself"):
        open_live("ft232h", clock=clock, report=print)
    with pytest.raises(UsageError, match="write usb://ft232h for the bridge itself"):
        open_bus("ft232h", clock)


def test_a_file_with_the_name_of_a_bridge_is_a_file(
    tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ft232h").write_text(
        "Time,X1,Y1,Z1\n0,1,2,3\n0.1,1,2,3\n0.2,1,2,3\n", encoding="ascii"
    )
    assert open_source("ft232h").values.shape == (3, 3)


@MISTAKEN_ARGUMENT.mark
def test_an_unescaped_plus_in_a_fault_is_refused_with_its_escape() -> None:
    url = "virtual://ft232h?fault=nack:3@1.5+0.2"
    with pytest.raises(UsageError) as caught:
        open_live(url, clock=VirtualClock(), report=print)
    assert "write fault=nack:3@1.5%2B0.2" in str(caught.value)
    open_live(url.replace("+", "%2B"), clock=VirtualClock(), report=print).close()
    with pytest.raises(UsageError, match="is not a fault"):
        read_fault("nack 3")


@MISTAKEN_ARGUMENT.mark
def test_a_models_card_given_for_the_model_is_recognised(tmp_path: Path) -> None:
    card = tmp_path / "m.json"
    for there in (False, True):
        if there:
            card.write_text("{}", encoding="ascii")
        with pytest.raises(NotAModel) as caught:
            read_sealed(card)
        assert f"name the model: {tmp_path / 'm.onnx'}" in str(caught.value)


@MISTAKEN_ARGUMENT.mark
def test_an_export_to_a_json_file_would_be_overwritten_by_its_card_and_is_refused(
    tmp_path: Path,
) -> None:
    with pytest.raises(UsageError) as caught:
        export_artifact(tmp_path, tmp_path / "m.json")
    assert f"write --out {tmp_path / 'm.onnx'}" in str(caught.value)
    assert os.listdir(tmp_path) == []


def test_the_longest_line_holds_more_than_any_hand_of_ours_needs() -> None:
    assert MOST_LINE_BYTES > 3 * 64 * 25


# -- limits, exactly


def zipped(path: Path, *arrays: np.ndarray) -> Path:
    named: Any = {f"a{k}": array for k, array in enumerate(arrays)}
    np.savez_compressed(path, **named)
    return path


def test_a_small_archive_may_be_of_zeros_and_a_larger_one_packed_to_a_five_hundredth(
    tmp_path: Path,
) -> None:
    small = np.zeros((16 << 20) - 128, np.uint8)
    archives.require_modest_archive(zipped(tmp_path / "a.npz", small))
    path = zipped(tmp_path / "b.npz", np.zeros((16 << 20) - 127, np.uint8))
    with zipfile.ZipFile(path) as opened:
        (member,) = opened.infolist()
    times = member.file_size // member.compress_size
    assert 500 < times < 2000
    with pytest.raises(TooLarge, match=f"unpack to {times} times its size"):
        archives.require_modest_archive(path)
    for noise, fits in ((15_000, False), (25_000, True)):
        noisy = np.random.default_rng(1).integers(0, 256, noise).astype(np.uint8)
        path = zipped(tmp_path / "c.npz", small, noisy)
        with zipfile.ZipFile(path) as opened:
            size = sum(one.compress_size for one in opened.infolist())
        assert ((16 << 20) + noise + 128 <= 500 * size) == fits
        if fits:
            archives.require_modest_archive(path)
        else:
            with pytest.raises(TooLarge, match="times its size"):
                archives.require_modest_archive(path)


def test_the_list_of_an_archive_s_members_may_have_a_mib(tmp_path: Path) -> None:
    path = zipped(tmp_path / "a.npz", np.zeros(3))
    data = bytearray(path.read_bytes())
    at = data.rfind(b"PK\x05\x06")
    for size in (1 << 20, (1 << 20) + 1):
        data[at + 12 : at + 16] = size.to_bytes(4, "little")
        path.write_bytes(data)
        error = TooLarge if size > 1 << 20 else zipfile.BadZipFile
        with pytest.raises(error):
            archives.require_modest_archive(path)
    # a comment of any length may follow
    path.write_bytes(data[:at] + data[at:-2] + b"\xff\xff" + b"c" * 65535)
    with pytest.raises(TooLarge):
        archives.require_modest_archive(path)


@pytest.mark.parametrize(("levels", "fits"), [(33, True), (34, False)])
def test_a_document_nests_33_levels(tmp_path: Path, levels: int, fits: bool) -> None:
    text = "[" * levels + "]" * levels
    card = tmp_path / "card.toml"
    card.write_text(f"a = {text[1:-1]}")
    if fits:
        json_of(text)
        reading.read_toml(card)
        return
    with pytest.raises(ValueError, match="nested too deep"):
        json_of(text)
    with pytest.raises(CardError, match="nested too deep"):
        reading.read_toml(card)


def test_whole_numbers_have_64_bits_and_their_place_is_named() -> None:
    assert json_of(f"[{2**63 - 1}, {-(2**63)}]") == [2**63 - 1, -(2**63)]
    for number in (2**63, -(2**63) - 1):
        with pytest.raises(ValueError, match=r"a\[1\].b needs more than 64 bits"):
            json_of(f'{{"a": [1, {{"b": {number}}}]}}')
    with pytest.raises(ValueError, match=r"a.b\[0\] = inf is not a finite number"):
        json_of('{"a": {"b": [1e999]}}')


def test_a_document_has_16_mib_and_a_line_of_a_table_128_kib(tmp_path: Path) -> None:
    text = json.dumps("x" * ((16 << 20) - 2))
    path = tmp_path / "a"
    path.write_text(text)
    assert reading.text_of(path) == text
    assert len(json_of(text)) == (16 << 20) - 2
    with pytest.raises(ValueError, match="too long"):
        json_of(text + " ")
    path.write_text(text + " ")
    with pytest.raises(TooLarge, match="more than 16 MiB"):
        reading.text_of(path)
    for length in (128 << 10, (128 << 10) + 1):
        path.write_text("a\n" + "b" * length + "\nc\n")
        if length == 128 << 10:
            reading.require_lines(path)
            continue
        with pytest.raises(TooLarge, match="line 2 is longer than 131072 bytes"):
            reading.require_lines(path)
    with pytest.raises(TooLarge, match="more than 4 GiB"):
        reading.require_lines(sparse(tmp_path / "big", (4 << 30) + 1))


def test_an_archive_may_hold_packed_and_unpacked_members(tmp_path: Path) -> None:
    single = zipped(tmp_path / "a.npz", np.arange(3.0))
    with zipfile.ZipFile(single) as opened:
        data = opened.read("a0.npy")
    with zipfile.ZipFile(tmp_path / "b.npz", "w") as opened:
        for kind in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            opened.writestr(f"a{kind}.npy", data, kind)
    archives.require_modest_archive(tmp_path / "b.npz")


def test_a_shipped_model_is_named_by_a_bare_name_that_no_file_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    name = reading.DEFAULT_MODEL
    assert reading.model_path(name) == reading.MODELS / f"{name}.onnx"
    for word in ("nowhere", f"mine/{name}", f"{name}.onnx"):
        assert reading.model_path(word) == Path(word)
    Path(name).touch()
    assert reading.model_path(name) == Path(name)
