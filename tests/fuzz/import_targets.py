"""Targets of `holdfast import`: maps, tables, workbooks, event tables, bags, messages."""

from __future__ import annotations

import io
import json
import tempfile
import zipfile
from collections.abc import Callable
from contextlib import ExitStack
from functools import cache
from pathlib import Path

import bag_writer
import numpy as np
from xdf_file import markers, samples, stream_header, xdf_bytes

from holdfast.core.column_map import flat_fields, read_column_map
from holdfast.core.errors import NotANumber
from holdfast.core.reading import json_of
from holdfast.interop import lerobot, mcap_file, ros2, tables, xdf
from holdfast.interop.import_map import import_map_of, import_map_of_text
from holdfast.interop.import_trials import TrialImport
from holdfast.interop.logs.layout import TableFormat
from holdfast.interop.logs.text_table import read_text_table
from holdfast.interop.logs.workbook import read_workbook
from holdfast.interop.proposal import propose

_KEPT = ExitStack()


@cache
def folder() -> Path:
    """A place for files, this process's own."""
    return Path(_KEPT.enter_context(tempfile.TemporaryDirectory(prefix="fuzz-import-")))


def written(name: str, data: bytes) -> Path:
    """The bytes as a file, in a folder of its own."""
    path = folder() / name.replace(".", "-") / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(data)
    return path


def column_map(data: bytes) -> None:
    """A map with all its tables, and a row that has its columns."""
    columns = read_column_map(written("map.toml", data))
    row = dict.fromkeys(columns.columns, 1.5)
    assert columns.values_of(row).shape == (3 * len(columns.sensors),)
    columns.stamp_ns(row, 3)
    again = import_map_of(columns)
    assert import_map_of_text(columns.to_toml(), columns.path).facts == again.facts


def message(data: bytes) -> None:
    """A message of a live sender, flattened."""
    try:
        value = json_of(data)
    except ValueError as error:
        raise NotANumber(str(error)) from None
    flat_fields(value)


def foreign_table(data: bytes) -> None:
    """A text table of any layout."""
    columns, _ = read_text_table(written("log.csv", data), TableFormat())
    assert len({len(column) for column in columns.values()}) == 1


def proposed(data: bytes) -> None:
    """A log without a map: what is proposed is read, and the log by it."""
    path = written("log.csv", data)
    plan = import_map_of_text(propose(path).text, path.with_name("map.toml"))
    TrialImport(path, plan).read()


def workbook(data: bytes) -> None:
    """A sheet."""
    read_workbook(written("log.xlsx", data), TableFormat())


def event_table(data: bytes) -> None:
    """A table of events beside a log."""
    place = written("events.csv", data)
    rows = "\n".join(f"{10 * k},0,0,{k % 7}" for k in range(60))
    place.with_name("log.csv").write_text(f"ms,x,y,z\n{rows}\n", encoding="utf-8")
    TrialImport(place.parent, import_map_of_text(EVENTS_MAP, Path("map.toml"))).read()


def mcap_log(data: bytes) -> None:
    """A log of messages."""
    mcap_file.read_log(written("log.mcap", data), "log").table(["a.x", "b.y"])


def xdf_log(data: bytes) -> None:
    """Streams of a lab."""
    xdf.read_log(written("log.xdf", data), "log")


def parquet_log(data: bytes) -> None:
    """A table of columns."""
    tables.read_log(written("log.parquet", data), "log")


def lerobot_info(data: bytes) -> None:
    """The description of a set of a robot."""
    place = folder() / "lerobot"
    (place / "meta").mkdir(parents=True, exist_ok=True)
    (place / "data").mkdir(exist_ok=True)
    (place / "data/file.parquet").write_bytes(small_parquet())
    (place / "meta/info.json").write_bytes(data)
    lerobot.read_log(place, "lerobot")


def bag_metadata(data: bytes) -> None:
    """The description of a bag of ROS 2."""
    place, _ = small_bag()
    (place / "metadata.yaml").write_bytes(data)
    ros2.read_log(place, "bag")


@cache
def small_bag() -> tuple[Path, bytes]:
    """A bag of two texts, and its metadata.yaml."""
    place = folder() / "bag"
    with bag_writer.Writer(
        place, version=9, storage_plugin=bag_writer.StoragePlugin.MCAP
    ) as writer:
        bag = bag_writer._Bag(writer)
        for k in range(2):
            bag.text("/what", k, "slip")
    return place, (place / "metadata.yaml").read_bytes()


MAP = b"""unit = "mN"
hand = ""
[time]
column = "t"
unit = "ms"
[[sensors]]
x = "x"
y = "y"
z = "-z"
[trials]
by = "gaps"
gap_s = 2
path = "{person}_{trial}"
[facts]
action = "slip"
[actions]
"torn away" = "pull"
[masses_g]
mug = 198
[events]
file = "e.csv"
start = "from"
label = "what"
[events.labels]
"slid" = "risky_slip"
"""
EVENTS_MAP = """unit = "N"
[time]
column = "ms"
unit = "ms"
[[sensors]]
x = "x"
y = "y"
z = "z"
[events]
file = "events.csv"
start = "from"
end = "to"
label = "what"
rest = "grasp"
"""
TABLE = b"# made by a logger\ntime;thumb_x;thumb_y;thumb_z;note\n"
TABLE += b"".join(b"%d;0,%d;1,5;-2,5;a\n" % (10 * k, k) for k in range(9))
OF = "http://schemas.openxmlformats.org"
WORKBOOK = {
    "[Content_Types].xml": f"""<Types xmlns="{OF}/package/2006/content-types">
<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>
<Override PartName="/xl/workbook.xml"
ContentType="application/vnd.openxmlformats-officedocument.spreadsheetml.sheet.main+xml"/>
<Override PartName="/xl/worksheets/sheet1.xml"
ContentType="application/vnd.openxmlformats-officedocument.spreadsheetml.worksheet+xml"/></Types>""",
    "_rels/.rels": f"""<Relationships xmlns="{OF}/package/2006/relationships">
<Relationship Id="r1" Type="{OF}/officeDocument/2006/relationships/officeDocument"
Target="xl/workbook.xml"/></Relationships>""",
    "xl/workbook.xml": f"""<workbook xmlns="{OF}/spreadsheetml/2006/main"
xmlns:r="{OF}/officeDocument/2006/relationships">
<sheets><sheet name="a" sheetId="1" r:id="r1"/></sheets></workbook>""",
    "xl/_rels/workbook.xml.rels": f"""<Relationships xmlns="{OF}/package/2006/relationships">
<Relationship Id="r1" Type="{OF}/officeDocument/2006/relationships/worksheet"
Target="worksheets/sheet1.xml"/></Relationships>""",
    "xl/worksheets/sheet1.xml": f"""<worksheet xmlns="{OF}/spreadsheetml/2006/main"><sheetData>
<row r="1"><c r="A1" t="inlineStr"><is><t>from</t></is></c>
<c r="B1" t="inlineStr"><is><t>what</t></is></c></row>
<row r="2"><c r="A2"><v>0.5</v></c><c r="B2" t="inlineStr"><is><t>slip</t></is></c></row>
<row r="3"><c r="A3"><v>2</v></c></row></sheetData></worksheet>""",
}
LABELLED = b"time_ms,a_x,a_y,a_z,label\n" + b"".join(
    b"%d,0.%d,1.5,-2.5,%s\n" % (10 * k, k, b"slip" if k > 4 else b"held")
    for k in range(9)
)


@cache
def small_workbook() -> bytes:
    """A sheet of events, in the fewest parts that a workbook has."""
    target = io.BytesIO()
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in WORKBOOK.items():
            archive.writestr(name, f'<?xml version="1.0"?>{text}')
    return target.getvalue()


@cache
def small_parquet() -> bytes:
    """A table with numbers, texts and lists."""
    path = folder() / "small.parquet"
    columns = {
        "episode_index": np.array([0, 0, 1]),
        "v": np.arange(6.0).reshape(3, 2),
        "what": np.array(["a", "b", "a"]),
    }
    tables.write_columns(path, columns)
    return path.read_bytes()


@cache
def small_mcap() -> bytes:
    """Two topics of JSON."""
    target = io.BytesIO()
    writer = mcap_file.Writer(target)
    writer.start()
    schema = writer.register_schema("any", "jsonschema", b"{}")
    for topic in ("a", "b"):
        channel = writer.register_channel(topic, "json", schema)
        for k in range(3):
            data = json.dumps({"x": k, "y": [k, None]}).encode()
            writer.add_message(channel, k * 10**7, data, k * 10**7)
    writer.finish()
    return target.getvalue()


@cache
def small_xdf() -> bytes:
    """A stream of three channels and one of texts."""
    return xdf_bytes(
        [
            stream_header(1, "F", "double64", 3, 100.0),
            stream_header(2, "M", "string", 1, 0.0),
            samples(1, [0.0, 0.01, 0.02], np.arange(9.0).reshape(3, 3)),
            markers(2, [(0.01, "slip")]),
        ]
    )


INFO = b'{"features": {"v": {"names": ["x", "y"]}}, "holdfast": {"unit": "N"}}'
IMPORT_TARGETS: dict[str, tuple[Callable[[bytes], object], tuple[bytes, ...], int]] = {
    "column_map": (column_map, (MAP, MAP[: MAP.index(b"[trials]")]), 300),
    "flat_message": (message, (b'{"t": 1, "f": [{"x": 2.5}]}', b"[[1, 2], 3]"), 500),
    "foreign_table": (
        foreign_table,
        (TABLE, b"\xef\xbb\xbf" + TABLE.replace(b";", b"\t"), b"1 2 3\n4 5 6\n"),
        150,
    ),
    "proposed_map": (proposed, (LABELLED, TABLE), 60),
    "workbook": (workbook, (small_workbook(),), 60),
    "event_table": (
        event_table,
        (b"from,to,what\n0.1,0.2,risky_slip\n0.3,,nothing\n", b"from;what\n0,1;slip\n"),
        60,
    ),
    "mcap_log": (mcap_log, (small_mcap(),), 150),
    "xdf_log": (xdf_log, (small_xdf(),), 150),
    "parquet_log": (parquet_log, (small_parquet(),), 100),
    "lerobot_info": (lerobot_info, (INFO, b"{}"), 100),
    "bag_metadata": (bag_metadata, (small_bag()[1],), 60),
}
"""Name -> what takes the bytes, seeds, runs of a bounded run."""
