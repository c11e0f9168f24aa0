"""`holdfast import` of other formats: what `convert` writes, and plain files of others."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from command_line import Run, imported
from foreign_logs import Made, axes, made, write_sheet, write_text
from own_data import write_people_folders
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from xdf_file import clock_offsets, markers, samples, stream_header, xdf_bytes

from holdfast.core.trial_file import read_trial
from holdfast.data.datasets import load
from holdfast.interop.formats.mcap_file import Writer as McapWriter
from holdfast.interop.formats.parquet import pa, pq

ONLY = "p0?/soft-ball/*"


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_people_folders(tmp_path_factory.mktemp("own"))


@pytest.mark.parametrize("form", ["parquet", "mcap", "lerobot"])
def test_what_convert_writes_comes_back_with_its_labels(
    run: Run, own: Path, tmp_path: Path, form: str
) -> None:
    logs, back = tmp_path / "logs", tmp_path / "back"
    words = ("convert", own, "--to", form, "--out", logs, "--only", ONLY)
    assert run(*words)[0] == 0
    code, out, err = run("import", logs, "--out", back, "--yes")
    assert code == 0, out + err
    before = {one.trial_id: one for one in load(own, windows="none").recordings}
    after = load(back, windows="none").recordings
    assert len(after) == 6
    for one in after:
        first = before[one.trial_id]
        assert (one.person, one.object_name, one.action) == (
            first.person,
            first.object_name,
            first.action,
        )
        spans = [(phase.first, phase.stop, phase.situation) for phase in first.phases]
        assert [(p.first, p.stop, p.situation) for p in one.phases] == spans
        # the values have no bias any more, and float32 digits in LeRobot; normals point outwards
        np.testing.assert_allclose(
            np.abs(one.samples[:, :3]), np.abs(first.samples[:, :3]), atol=0.02
        )


# -- plain files of others


def mcap_of_json(path: Path, one: Made) -> None:
    with path.with_suffix(".mcap").open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        schema = writer.register_schema("pads", "jsonschema", b"{}")
        pads = writer.register_channel("/pads", "json", schema)
        notes = writer.register_channel("/notes", "json", schema)
        for k, row in enumerate(one.values.tolist()):
            t_ns = 1_700_000_000_000_000_000 + k * 10_000_000
            forces = [
                dict(zip("xyz", row[3 * s : 3 * s + 3], strict=True)) for s in range(5)
            ]
            data = json.dumps({"seq": k, "force": forces}).encode()
            writer.add_message(pads, t_ns, data, t_ns)
            if k in (0, 100, 300, 350):
                text = {0: "open", 100: "holding", 300: "slipping", 350: "holding"}[k]
                data = json.dumps({"state": text}).encode()
                writer.add_message(notes, t_ns, data, t_ns)
        writer.finish()


def bag_of_wrenches(path: Path, one: Made, first: int = 0) -> None:
    """first: row in which the last sensor begins."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    make = store.types
    zero = make["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        kind = "geometry_msgs/msg/WrenchStamped"
        for s in range(5):
            topic = writer.add_connection(f"/ft{s}", kind, typestore=store)
            for k, row in enumerate(one.values[:, 3 * s : 3 * s + 3].tolist()):
                # a message of the third sensor is lost
                if (s == 2 and k == 40 and not first) or (s == 4 and k < first):
                    continue
                stamp = make["builtin_interfaces/msg/Time"](
                    sec=k // 100, nanosec=k % 100 * 10_000_000
                )
                header = make["std_msgs/msg/Header"](stamp=stamp, frame_id="a")
                force = make["geometry_msgs/msg/Vector3"](x=row[0], y=row[1], z=row[2])
                wrench = make["geometry_msgs/msg/Wrench"](force=force, torque=zero)
                message = make[kind](header=header, wrench=wrench)
                data = store.serialize_cdr(message, kind)
                writer.write(topic, 10**9 + k * 10_000_000, data)


def parquet_of_lists(path: Path, one: Made) -> None:
    columns = {
        "timestamp": pa.array((1e9 * one.t_s).astype(np.int64), pa.timestamp("ns")),
        "tactile": pa.array(
            one.values.reshape(-1, 15).tolist(), pa.list_(pa.float64())
        ),
    }
    pq.write_table(pa.table(columns), path.with_suffix(".parquet"))


def lerobot_of_a_robot(path: Path, one: Made) -> None:
    features = {
        "observation.tactile": {"dtype": "float32", "names": axes(5, "p{k}.{axis}")}
    }
    (path / "meta").mkdir(parents=True)
    (path / "meta/info.json").write_text(json.dumps({"features": features}))
    rows = len(one.t_s)
    data = path / "data/chunk-000/episode_000000.parquet"
    data.parent.mkdir(parents=True)
    table = {
        "observation.tactile": pa.array(
            one.values.tolist(), pa.list_(pa.float64(), 15)
        ),
        "timestamp": pa.array(one.t_s),
        "episode_index": pa.array(np.zeros(rows, dtype=np.int64)),
    }
    pq.write_table(pa.table(table), data)


NAMED = "".join(f"<channel><label>{name}</label></channel>" for name in axes(5))
"""The labels of the channels of an XDF stream."""


def xdf_of_a_lab(path: Path, one: Made) -> None:
    texts = [(7.0, "open"), (8.0, "grasp"), (10.0, "slip"), (10.5, "grasp")]
    path.with_suffix(".xdf").write_bytes(
        xdf_bytes(
            [
                stream_header(1, "Pads", "double64", 15, 100.0, NAMED),
                stream_header(2, "Markers", "string", 1, 0.0),
                samples(1, 7.0 + one.t_s, one.values),
                markers(2, texts),
            ]
        )
    )


def sheet_of_a_lab(path: Path, one: Made) -> None:
    rows = [
        [1e3 * t, *row] for t, row in zip(one.t_s, one.values.tolist(), strict=True)
    ]
    names = ["Time (ms)", *axes(5, "Pad {k} {axis} (N)")]
    write_sheet(path.with_suffix(".xlsx"), [["Lab 7"], [], names, *rows])


PLAIN: dict[str, Callable[[Path, Made], None]] = {
    write.__name__: write
    for write in (
        mcap_of_json,
        bag_of_wrenches,
        parquet_of_lists,
        lerobot_of_a_robot,
        xdf_of_a_lab,
        sheet_of_a_lab,
    )
}


def test_the_unit_of_the_channels_of_a_stream_is_that_of_the_readings(
    run: Run, tmp_path: Path
) -> None:
    one = made(1)
    channels = NAMED.replace("</label>", "</label><unit>lbf</unit>")
    header = stream_header(1, "Pads", "double64", 15, 100.0, channels)
    (tmp_path / "logs").mkdir()
    chunks = [header, samples(1, one.t_s, one.values / 4.4482216)]
    (tmp_path / "logs/cup_slip_1.xdf").write_bytes(xdf_bytes(chunks))
    imported(run, tmp_path)
    values = read_trial(tmp_path / "set/cup/slip/trial_1.csv").raw
    np.testing.assert_allclose(values, one.values, atol=1e-6)


@pytest.mark.parametrize("form", PLAIN)
def test_a_plain_file_of_others_becomes_a_trial(
    run: Run, tmp_path: Path, form: str
) -> None:
    one = made(4)
    source = tmp_path / "logs"
    source.mkdir()
    PLAIN[form](source / "p03_cup_slip", one)
    (source / "notes.md").write_text("no log")
    out = imported(run, tmp_path)
    (place,) = (tmp_path / "set").rglob("trial_1.csv")
    trial = read_trial(place)
    wanted = one.values.copy()
    if form == "bag_of_wrenches":
        wanted[40, 6:9] = np.nan
    np.testing.assert_allclose(trial.raw, wanted, atol=1e-6)
    np.testing.assert_allclose(trial.t_s, one.t_s, atol=1e-6)
    assert ("labels" in out) == (form in ("mcap_of_json", "xdf_of_a_lab"))
    if "labels" in out:
        truth = json.loads(place.with_suffix(".truth.json").read_text())["phases"]
        assert [(p["t0_s"], p["label"]) for p in truth] == [
            (0.0, "nothing"),
            (1.0, "grasp"),
            (3.0, "risky_slip"),
            (3.5, "grasp"),
        ]


# -- corners


def xdf_stream(path: Path, one: Made, parts: int = 1) -> np.ndarray:
    """The pads as a stream; parts: it is written so many times, as by a sender that began anew."""
    chunks = []
    for k in range(parts):
        rows = slice(k * 250, (k + 1) * 250) if parts == 2 else slice(None)
        chunks.append(stream_header(k + 1, "Pads", "double64", 15, 100.0, NAMED))
        chunks.append(samples(k + 1, 7.0 + one.t_s[rows], one.values[rows]))
    path.with_suffix(".xdf").write_bytes(xdf_bytes(chunks))
    return one.values


def xdf_with_a_clock_reset(path: Path, one: Made) -> np.ndarray:
    """The sender's clock is set back by 100 s in the middle, and the recorder measures that."""
    t_s = 7.0 + one.t_s - np.where(one.t_s >= 2.5, 100.0, 0.0)
    chunks = [stream_header(1, "Pads", "double64", 15, 100.0, NAMED)]
    before, after = one.t_s < 2.5, one.t_s >= 2.5
    chunks += [
        samples(1, t_s[before], one.values[before]),
        clock_offsets(1, [7.0, 8.0, 9.4], 0.0),
    ]
    chunks += [samples(1, t_s[after], one.values[after])]
    chunks.append(clock_offsets(1, [-90.4, -89.0, -88.1], 100.0))
    path.with_suffix(".xdf").write_bytes(xdf_bytes(chunks))
    return one.values


def bag_whose_topics_begin_late(path: Path, one: Made) -> np.ndarray:
    bag_of_wrenches(path, one, first=30)
    return one.values[30:]


def mcap_that_was_cut_off(path: Path, one: Made) -> np.ndarray:
    mcap_of_json(path, one)
    whole = path.with_suffix(".mcap")
    whole.write_bytes(whole.read_bytes()[:-2000])
    return one.values


def mcap_with_nan_in_its_json(path: Path, one: Made) -> np.ndarray:
    one.values[40, 6:9] = np.nan
    mcap_of_json(path, one)
    return one.values


def lerobot_without_names(path: Path, one: Made) -> np.ndarray:
    lerobot_of_a_robot(path, one)
    feature = {"observation.tactile": {"dtype": "float32", "names": None}}
    (path / "meta/info.json").write_text(json.dumps({"features": feature}))
    return one.values


def the_same_log_in_two_formats(path: Path, one: Made) -> np.ndarray:
    sheet_of_a_lab(path, one)
    rows = np.column_stack([one.t_s, one.values])
    write_text(path.with_suffix(".csv"), ["t_s", *axes(5)], rows)
    return one.values


CORNERS: dict[str, Callable[[Path, Made], np.ndarray]] = {
    "xdf without clock offsets": xdf_stream,
    "xdf of a sender that began anew": partial(xdf_stream, parts=2),
    "xdf of a stream twice": partial(xdf_stream, parts=3),
    "xdf with a clock reset": xdf_with_a_clock_reset,
    "bag whose topics begin late": bag_whose_topics_begin_late,
    "mcap that was cut off": mcap_that_was_cut_off,
    "mcap with nan in its json": mcap_with_nan_in_its_json,
    "lerobot without names": lerobot_without_names,
    "the same log in two formats": the_same_log_in_two_formats,
}


@pytest.mark.parametrize("corner", CORNERS)
def test_a_corner_of_another_tool_is_one_whole_trial(
    run: Run, tmp_path: Path, corner: str
) -> None:
    source = tmp_path / "logs"
    source.mkdir()
    left = CORNERS[corner](source / "p03_cup_slip", made(4))
    out = imported(run, tmp_path)
    assert "1 trial: 1 " in out
    (place,) = (tmp_path / "set").rglob("trial_1.csv")
    raw = read_trial(place).raw
    rows = min(len(raw), len(left))
    assert rows >= len(left) - 60
    np.testing.assert_allclose(raw[:rows], left[:rows], atol=1e-6)


def test_logs_of_two_formats_are_one_set(run: Run, tmp_path: Path) -> None:
    source = tmp_path / "logs"
    source.mkdir()
    sheet_of_a_lab(source / "p01_cup_slip", made(1))
    parquet_of_lists(source / "p02_cup_hold", made(2))
    out = imported(run, tmp_path, "--unit", "N")
    assert "2 trials: 1 slip, 1 hold" in out
    assert (tmp_path / "set/p02/cup/hold/trial_1.csv").is_file()


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.mcap", b"\x89MCAP0\r\n" + bytes(40)),
        ("a.parquet", b"PAR1" + bytes(40)),
        ("a.xlsx", b"PK\3\4" + bytes(40)),
        ("a.xdf", b"XDF:" + bytes(40)),
        ("a.csv", bytes(40)),
        ("bag/metadata.yaml", b"rosbag2_bagfile_information: [\n"),
        ("set/meta/info.json", b"[]"),
    ],
)
def test_a_damaged_file_is_refused_by_name(
    run: Run, tmp_path: Path, name: str, data: bytes
) -> None:
    path = tmp_path / "logs" / name
    path.parent.mkdir(parents=True)
    path.write_bytes(data)
    refused = imported(run, tmp_path, code=3)
    assert f"{tmp_path}/logs/{name.split('/')[0]}" in refused
