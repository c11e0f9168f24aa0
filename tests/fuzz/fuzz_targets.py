"""What comes from outside, and what takes it: a table of targets, each fed with bytes.

One law for all: any input is taken, or refused with one of our errors (holdfast/core/errors.py),
which is one line. Nothing else, no warning either, comes out; nothing hangs, nothing eats the
memory.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import os
import socket
import tempfile
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import usb.core
from import_targets import IMPORT_TARGETS

from holdfast.core.column_map import column_map_of
from holdfast.core.contract import RISKY_SLIP
from holdfast.core.errors import HoldfastError, NotAModel
from holdfast.core.line_key import LinkKey
from holdfast.core.line_port import line_url
from holdfast.core.line_session import SILENCE_NS, LineReceiver, LineRefused
from holdfast.core.tactile_file import RepairResult, repair_table
from holdfast.core.trial_file import read_trial
from holdfast.core.trial_layout import mass_g as read_mass_g
from holdfast.core.trial_layout import read_events
from holdfast.drivers.bus import Bus
from holdfast.drivers.calibration import read_bias, read_calibration
from holdfast.drivers.camera.sources import LENS, read_frames
from holdfast.drivers.ft232h import Ft232h
from holdfast.drivers.hand import Hand
from holdfast.drivers.layout import read_layout
from holdfast.drivers.line_feeds import LineSplitter
from holdfast.drivers.replay import open_replay
from holdfast.drivers.sample_lines import SampleReader
from holdfast.drivers.virtual.clock import VirtualClock
from holdfast.drivers.virtual.faults import read_fault
from holdfast.drivers.virtual.ft232h import VirtualFt232h
from holdfast.drivers.virtual.usb_backend import VirtualBackend
from holdfast.drivers.virtual.usb_device import Device
from holdfast.drivers.virtual.virtual_hand import VirtualHand
from holdfast.edge_runtime.commands import Command, command_port
from holdfast.edge_runtime.decision import DecisionState, decide, period_us
from holdfast.edge_runtime.model import golden_from_json, read_model
from holdfast.edge_runtime.model_file import (
    CARD_KEY,
    SEAL_KEY,
    read_card,
    read_sealed,
)
from holdfast.edge_runtime.onnx_bytes import read_onnx
from holdfast.edge_runtime.preparation import Tare
from holdfast.live.hand_sources import is_lines, open_live
from holdfast.live.line_sources import read_line_url
from holdfast.live.page.link import read_address
from holdfast.live.page.server import Access, PageHandler, PageServer
from holdfast.live.page.stream import LiveStream
from holdfast.live.sources import require_meant
from holdfast.sessions.known_loads import read_load_sets
from holdfast.sessions.recorder.labels import relabel
from holdfast.sessions.recorder.protocol import read_protocol
from holdfast.sessions.study.journal import progress_of
from holdfast.sessions.study.protocol import read_study
from holdfast.simulation import scene_file
from holdfast.simulation.scene import Scene
from holdfast.training.datasets.public_files import read_arrays, read_table
from holdfast.training.timeline import read_truth

ROOT = Path(__file__).resolve().parents[2]
SMALL_MODEL = Path(__file__).resolve().parent / "small.onnx"
"""Of two sensors and two trees: tests/small_model.py, sealed_bytes(). Written anew where the format
changes."""
MODEL_CARD = ROOT / "models" / "holdfast-150hz.json"
READS = 6
LEFT_ALONE = 60
"""Answers: 57 bring up a hand on an FT232H and read it."""

BOARD = ("usb", "i2c", "lsl")
"""Sources on this very machine: their URLs are taken apart as the others are, but nothing of a
stranger is opened."""
LINE_MAP = column_map_of(
    'unit = "gf"\n[time]\ncolumn = "t"\n[[sensors]]\nx = "f.0"\ny = "-f.1"\nz = "f.2"\n'
)
LINE_KEY = LinkKey(b"k" * 32, "samples")
ERRNOS = (5, 13, 16, 19, 32, 75, 110)


@dataclass(frozen=True)
class Target:
    """What takes bytes from outside: `feed` raises a HoldfastError or nothing.

    seeds: inputs to begin with, the first of which is taken; runs: of a bounded run, a second or
    two.
    """

    feed: Callable[[bytes], object]
    seeds: tuple[bytes, ...]
    runs: int = 500


def refused(target: Target, data: bytes) -> HoldfastError | None:
    """Feed a target: our error where it refuses, None where it takes it; anything else comes
    out."""
    try:
        target.feed(data)
    except HoldfastError as error:
        answer = error
    else:
        return None
    assert "\n" not in str(answer)
    return answer


@cache
def folder() -> Path:
    """A place for files, this process's own."""
    return Path(_kept().enter_context(tempfile.TemporaryDirectory(prefix="fuzz-")))


@cache
def _kept() -> ExitStack:
    return ExitStack()


def written(name: str, data: bytes) -> Path:
    """The bytes as a file."""
    path = folder() / name
    path.write_bytes(data)
    return path


def text_of(data: bytes) -> str:
    """As the command line hands bytes over."""
    return os.fsdecode(data)


# -- files


def trial(data: bytes) -> None:
    """A trial's CSV, read, prepared and walked through."""
    read_trial(written("trial_1.csv", data))


def meta(data: bytes) -> None:
    """The recorded JSON beside a trial: its unit, and its object's mass."""
    place = folder() / "stone" / "hold"
    place.mkdir(parents=True, exist_ok=True)
    (place / "trial_1.csv").write_text(
        "Time,X1,Y1,Z1\n0,1,2,3\n0.01,1,2,3\n", encoding="utf-8"
    )
    (place.parent / "meta.json").write_bytes(data)
    # either may refuse what the other takes
    refused(Target(lambda _: open_replay(place / "trial_1.csv"), ()), b"")
    read_mass_g(place.parent)


def truth(data: bytes) -> None:
    """The phases beside a trial."""
    read_truth(written("trial_1.truth.json", data), np.arange(5) / 50.0)


def scene(data: bytes) -> None:
    """A scene's card, and two trials drawn from it."""
    Scene(scene_file.read_scene_file(str(written("mine.toml", data))), 0).trials(2)


def protocol(data: bytes) -> None:
    """A recording protocol, and a person's order of it."""
    read_protocol(written("protocol.toml", data)).ordered(0, "p01")


def study_card(data: bytes) -> None:
    """A study protocol, and all that is computed from it."""
    study = read_study(written("study.toml", data))
    assert study.minutes_after(0) <= study.minutes
    repetitions = sum(part.repetitions for part in study.parts)
    assert len(study.recording_protocol().tasks) == repetitions


def study_journal(data: bytes) -> None:
    """The journal of a person's study, and where it goes on."""
    path = written("study.jsonl", data)
    progress_of(read_events(path), path, 3)


def events(data: bytes) -> None:
    """What happened in a recorded trial, made into its phases."""
    place = folder() / "trial_1"
    place.mkdir(exist_ok=True)
    (place / "tactile.csv").write_bytes(HEAD + ROWS)
    (place / "meta.json").write_text(
        '{"action": "pull", "unit": "N"}', encoding="utf-8"
    )
    (place / "events.jsonl").write_bytes(data)
    relabel(place)


def mended(data: bytes) -> None:
    """A recorded file, mended: every byte is in it or beside it, and mending again changes
    nothing."""
    path = written("tactile.csv", data)
    for torn in path.parent.glob("tactile.csv.*"):
        torn.unlink()
    try:
        found = repair_table(path)
    except HoldfastError:
        assert path.read_bytes() == data
        raise
    aside = found.torn.read_bytes() if found.torn else b""
    assert path.read_bytes() + aside == data
    assert aside.rstrip(b"\0").rstrip(b"\r\n").count(b"\n") == 0, "at most one line"
    assert repair_table(path) == RepairResult(found.rows, 0, None)


def calibration(data: bytes) -> None:
    """A calibration, and what it makes of a field."""
    found = read_calibration(written("calibration.json", data))
    with np.errstate(all="ignore"):
        found.apply(np.zeros((len(found.matrix), 3)))


def bias(data: bytes) -> None:
    """What an unloaded hand reads."""
    read_bias(written("bias.json", data))


def loads(data: bytes) -> None:
    """Loads and fields to calibrate by."""
    read_load_sets(written("loads.csv", data))


def model(data: bytes) -> None:
    """A model file's own bytes, up to the seal."""
    read_sealed(written("model.onnx", data))


def onnx_bytes(data: bytes) -> None:
    """A model file's graph, read from its bytes; every number of its arrays is within the bytes."""
    try:
        graph = read_onnx(data)
    except ValueError as error:
        raise NotAModel(str(error)) from None
    assert sum(one.nbytes for one in graph.constants.values()) <= len(data)


def resealed_model(data: bytes) -> None:
    """A small model with some bytes exchanged, sealed again: refused before it is run, or whole.

    Five bytes an exchange: where (three), what to do (one), and a byte.
    """
    altered = _sealed_again(_exchanged(bytearray(SMALL_MODEL.read_bytes()), data[:200]))
    card, _, graph = read_model(altered, "m.onnx")
    assert graph.inputs["sample"].shape[-1] == card.n_channels


def _exchanged(model: bytearray, script: bytes) -> bytearray:
    for at in range(0, len(script) - 4, 5):
        place, how, byte = (
            int.from_bytes(script[at : at + 3], "little"),
            script[at + 3] % 4,
            script[at + 4],
        )
        place %= len(model)
        if how == 0:
            model[place] = byte
        elif how == 1:
            model[place] ^= 1 << byte % 8
        elif how == 2:
            del model[place]
        else:
            model.insert(place, byte)
    return model


def _sealed_again(model: bytearray) -> bytes:
    at = model.rfind(b"holdfast.sha256\x12\x40") + 17
    if at < 17 or at + 64 > len(model):
        raise NotAModel("no seal")
    model[at : at + 64] = b"0" * 64
    model[at : at + 64] = hashlib.sha256(model).hexdigest().encode()
    return bytes(model)


def arrays(data: bytes) -> None:
    """An archive of arrays: frames, and a data set's."""
    path = written("a.npz", data)
    with np.errstate(all="ignore"):
        refused(
            Target(lambda _: read_arrays(path, {"frames": (None, None, None)}), ()), b""
        )
        read_frames(path)


def table(data: bytes) -> None:
    """A table that may have long lines."""
    read_table(written("trials.csv", data))


def message(data: bytes) -> None:
    """What a message says of what came from outside; it is one printable line."""
    text = text_of(data)
    assert str(HoldfastError(text, where=text)).isprintable()
    require_meant(text)


def sealed_card(data: bytes) -> None:
    """The card in a model file's metadata, and the parts that are made of it alone."""
    card = read_card(
        {CARD_KEY: data.decode(errors="replace"), SEAL_KEY: "0" * 64}, "model.onnx"
    )
    decide(
        card.decision,
        DecisionState(),
        RISKY_SLIP,
        1000,
        period_us=period_us(card.rate_hz),
    )
    Tare(card.preparation, card.n_channels).prepare(
        np.zeros(card.n_channels), np.ones(card.n_channels // 3, bool)
    )
    assert card.rate_hz > 0.0
    assert 0 < card.settle_samples < 1e6


def golden(data: bytes) -> None:
    """The golden sequences in a model file's metadata."""
    golden_from_json(data.decode(errors="replace"), "model.onnx")


# -- words


def fault(data: bytes) -> None:
    """A scripted fault."""
    read_fault(text_of(data))


def layout(data: bytes) -> None:
    """Where the fingers are."""
    read_layout(text_of(data))


def source(data: bytes) -> None:
    """A source's URL, opened where that takes no hardware; one reading of it."""
    url = text_of(data)
    try:
        scheme = urlsplit(url).scheme
    except ValueError:
        scheme = ""
    if scheme in BOARD:
        url = url.lstrip().replace(scheme, "virtual", 1)
    os.chdir(folder())
    if is_lines(url):
        # no port of a stranger's choice is opened
        read_line_url(url)
        return
    opened = open_live(url, clock=VirtualClock(), report=lambda line: None)
    opened.read()
    opened.close()


def sample_lines(data: bytes) -> None:
    """Lines of a program that sends samples: first a header or a key, then lines in pieces."""
    sealed = data[:1] == b"k"
    reader = SampleReader(
        LINE_MAP if data[:1] == b"m" else None, key=LINE_KEY if sealed else None
    )
    splitter = LineSplitter()
    for k, at in enumerate(range(1, len(data), 97)):
        for line in splitter.split(data[at : at + 97]):
            with suppress(LineRefused):
                text = LINE_KEY.sealed(line) if sealed and k % 2 else line
                sample = reader.take(text, k % 3, 10_000_000 * k)
                if sample is not None:
                    assert reader.map is not None
                    assert sample.values.shape == (len(reader.map.channels),)
                    assert sample.valid.shape == (len(reader.map.sensors),)
                    held = np.repeat(sample.valid, 3)
                    assert np.isfinite(sample.values[held]).all()


def commands(data: bytes) -> None:
    """The user's commands, a datagram a line; the port goes on listening whatever comes."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        address = probe.getsockname()
    messages: list[str] = []
    clock = VirtualClock()
    with (
        command_port(
            f"{address[0]}:{address[1]}", messages.append, clock.now_ns
        ) as ask,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as user,
    ):
        user.connect(address)
        for result in data[:8192].split(b"\n"):
            user.send(result)
            assert isinstance(ask(), Command)
        # a session that the data began is over
        clock.spend(SILENCE_NS + 1)
        user.send(b'{"session": 1, "sequence": 0, "override": true}')
        assert ask().override
    assert all(line.isprintable() for line in messages)
    assert len(messages) < 20


LINK_KEY = LinkKey(b"k" * 32, "grip")


def link_line(data: bytes) -> None:
    """A line of a link: it is obeyed or skipped, nothing forged is obeyed with a key, and the
    genuine line after it is."""
    for key in (None, LINK_KEY):
        clock = VirtualClock()
        receiver = LineReceiver(clock.now_ns, 150, key=key, needs_session=False)
        for line in data.split(b"\n"):
            try:
                fields = receiver.take(line, lambda fields: fields)
            except LineRefused:
                continue
            assert key is None
            assert all_finite(list(fields.values()))
        clock.spend(SILENCE_NS + 1)
        genuine = b'{"session":9007199254740991,"sequence":9007199254740991}'
        taken = receiver.take(
            key.sealed(genuine) if key else genuine, lambda fields: fields
        )
        assert taken == {}


def all_finite(values: list[Any]) -> bool:
    """Whether all numbers are, also within lists and objects."""
    while values:
        value = values.pop()
        if isinstance(value, dict):
            values += value.values()
        elif isinstance(value, list):
            values += value
        elif isinstance(value, float) and not math.isfinite(value):
            return False
    return True


def link_url(data: bytes) -> None:
    """Where commands are to come from: an address, or one error."""
    try:
        where = line_url(text_of(data), "commands")
    except ValueError:
        return
    assert isinstance(where.options, dict)


def web_address(data: bytes) -> None:
    """Where the live page is to listen."""
    host, port = read_address(text_of(data))
    assert host
    assert 0 <= port < 65536


def web_request(data: bytes) -> None:
    """What a browser sends to the live page: every answer is one of HTTP, and what is served is
    the page's own."""
    stream = LiveStream({"actions": [], "unit": "N"})
    stream.take({"end": "the run has ended"}, 0.0)
    stream.publish(0.0)
    ours, theirs = socket.socketpair()
    with ours, theirs, socket.create_server(("127.0.0.1", 0)) as listener:
        access = Access("token", ()) if data[:1] == b"t" else Access("", ("localhost",))
        server = PageServer(listener, stream, access, lambda action: True)
        ours.sendall(data[1:8192])
        ours.shutdown(socket.SHUT_WR)
        theirs.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
        PageHandler(theirs, ("127.0.0.1", 0), server)
        theirs.close()
        answer = b"".join(iter(lambda: ours.recv(1 << 16), b""))
    if b"Holdfast live" in answer:
        assert b"/token/" in data if access.token else b"localhost" in data.lower()


# -- replies of a bridge


class Spoilt(Device):
    """An emulated bridge whose answers are spoilt as the bytes say; honest again when they are at
    an end.

    Two bytes say how many answers are left alone first. Then a byte an answer: its lowest three
    bits say how it is spoilt, with what the next bytes hold.
    """

    def __init__(self, device: Any, script: bytes) -> None:
        self._device, self._script = device, script[2:]
        self._left_alone = int.from_bytes(script[:2], "little") % LEFT_ALONE
        self.vendor, self.product, self.speed = (
            device.vendor,
            device.product,
            device.speed,
        )
        self.interfaces, self.kernel_driver = device.interfaces, device.kernel_driver

    def control_out(
        self, request_type: int, request: int, value: int, index: int, data: bytes
    ) -> None:
        self._device.control_out(request_type, request, value, index, data)

    def control_in(
        self, request_type: int, request: int, value: int, index: int, length: int
    ) -> bytes:
        return self._spoil(
            self._device.control_in(request_type, request, value, index, length), length
        )

    def write(self, endpoint: int, data: bytes) -> None:
        self._device.write(endpoint, data)

    def read(self, endpoint: int, length: int) -> bytes:
        return self._spoil(self._device.read(endpoint, length), length)

    def reset(self) -> None:
        self._device.reset()

    def _take(self, count: int) -> bytes:
        taken, self._script = self._script[:count], self._script[count:]
        return taken

    def _spoil(self, answer: bytes, length: int) -> bytes:
        if self._left_alone:
            self._left_alone -= 1
            return answer
        how = (self._take(1) or b"\0")[0]
        more = self._take(1)[0] if how & 7 > 3 and self._script else 0
        if how & 7 == 4:
            return answer[: more % (len(answer) + 1)]
        if how & 7 == 5:
            return (answer[:more] + self._take(how >> 3) + answer[more + (how >> 3) :])[
                :length
            ]
        if how & 7 == 6:
            return self._take(more)[:length]
        if how & 7 == 7:
            number = ERRNOS[more % len(ERRNOS)]
            raise usb.core.USBError(os.strerror(number), number, number)
        return answer


def bridge(
    device: Callable[[VirtualHand], Device], driver: Callable[[Any], Bus]
) -> Callable[[bytes], None]:
    """A driver whose bridge answers what the bytes say: a hand on it starts or does not, and then
    never raises."""

    def feed(data: bytes) -> None:
        clock = VirtualClock()
        virtual = VirtualHand(clock)
        backend = VirtualBackend(
            Spoilt(device(virtual), data), clock, virtual.faults, virtual.power_off
        )
        hand = Hand(
            lambda: driver(backend),
            now_ns=clock.now_ns,
            pause=lambda seconds: clock.spend(round(1e9 * seconds)),
        )
        try:
            hand.start()
            for _ in range(READS):
                _fits(hand)
                clock.spend(25_000_000)
        finally:
            hand.close()

    return feed


def _fits(hand: Hand) -> None:
    """A reading that holds together; a hand that has started says what is wrong, and raises
    nothing."""
    try:
        reading = hand.read()
    except HoldfastError as error:
        raise AssertionError(f"a hand that has started raised {error!r}") from error
    assert reading.field_ut.shape == (6, 3)
    assert np.isfinite(reading.field_ut[reading.valid]).all()
    assert [not why for why in reading.why] == reading.valid.tolist()


HEAD = b"Time,X1,Y1,Z1\n"
ROWS = b"".join(b"%.3f,1,2.5,-3e1\n" % (0.02 * k) for k in range(4))
RECORDED = HEAD.replace(b"\n", b",host_ns,device_us,sequence,valid1\n") + ROWS.replace(
    b"\n", b",1,2,3,1\n"
)
LOADS = b"Time,X1,Y1,Z1,Fx,Fy,Fz\n" + b"".join(
    b"%d,%d,2,%d,0,0,%d\n" % (k, k % 3, 100 * (k % 20 > 9), 3 * (k % 20 > 9))
    for k in range(80)
)
CARD = (
    b'title="a"\n[record]\nrate_hz=150\n[physics]\nstep_s=1e-3\n'
    b'[[trials]]\nobjects=["soft-ball"]\naction="pull"\n'
)
MORE_OF_A_CARD = (
    b"count=2\nhold_s={uniform=[2,3]}\ngrip_n={choice=[4,8]}\nspare={normal=[2,1]}\n"
    b"[objects.pear]\nmass_g=180\n[effects.brush]\ncount=5\n[effects.dipole]\n[effects.hall_noise]\n"
)
PHASES = json.dumps(
    {"phases": [{"t0_s": 0.0, "t1_s": 0.05, "label": "grasp", "provenance": "x"}]}
).encode()
CALIBRATION = json.dumps(
    {
        "format": 1,
        "kind": "calibration",
        "matrix_n_per_ut": [[[1, 0, 0], [0, 1, 0], [0, 0, 1e-3]]],
        "rest_ut": None,
        "reversed": [False],
        "source": "",
        "date": "",
        "load_unit": "N",
        "n": 9,
        "residual_n": [[None, 0.1, 0.2]],
    }
).encode()
BIAS = json.dumps(
    {
        "format": 1,
        "kind": "bias",
        "values": [0.0, 1.5, -2e3],
        "spread": [1, 1, 1],
        "n": 30,
        "unit": "uT",
        "reversed": [False],
    }
).encode()
GOLDEN = (
    b'{"votes":{"dtype":"int32","shape":[1,2],"data":"AQAAAAIAAAA="},'
    b'"settled":{"dtype":"bool","shape":[1],"data":"AQ=="}}'
)


def spoilings() -> tuple[bytes, ...]:
    """Scripts that spoil early and late, one answer in four, in every way."""
    rng = np.random.default_rng(0)
    made = [b""]
    for begins in (0, 5, 20, 35, 42, 52, 120, 200, 240, 300, 400, 430, 550):
        answers = np.where(rng.random(40) < 0.25, rng.integers(256, size=40), 0).astype(
            np.uint8
        )
        made.append(begins.to_bytes(2, "little") + answers.tobytes())
    return tuple(made)


def sealed() -> bytes:
    """The least that a seal holds on."""
    head = b"\x08\x08holdfast.sha256\x12\x40"
    return head + hashlib.sha256(head + b"0" * 64).hexdigest().encode()


def small_onnx() -> bytes:
    """A graph of one operator, a constant and a tree's columns, by the wire format alone."""
    tree = [
        part(1, b"nodes_treeids") + b"\x40\x00\x40\x81\x01\xa0\x01\x07",
        part(1, b"nodes_values") + b"\x3d\0\0\0\0\x3d\0\0\x80\x3f\xa0\x01\x06",
        part(1, b"nodes_modes")
        + part(9, b"LEAF")
        + part(9, b"BRANCH_LEQ")
        + b"\xa0\x01\x08",
        part(1, b"n_targets") + b"\x18\x02\xa0\x01\x02",
        part(1, b"post_transform") + part(4, b"NONE") + b"\xa0\x01\x03",
    ]
    node = (
        part(1, b"x")
        + part(2, b"y")
        + part(4, b"TreeEnsembleRegressor")
        + b"".join(part(5, one) for one in tree)
        + part(7, b"ai.onnx.ml")
    )
    tensor = b"\x08\x02\x10\x0b" + part(8, b"c0") + part(9, bytes(16))
    shape = part(1, part(2, b"B")) + part(1, b"\x08\x12")
    value = part(1, b"x") + part(2, part(1, b"\x08\x0b" + part(2, shape)))
    graph = (
        part(1, node)
        + part(2, b"g")
        + part(5, tensor)
        + part(11, value)
        + part(12, value)
    )
    opsets = part(8, part(1, b"") + b"\x10\x14")
    opsets += part(8, part(1, b"ai.onnx.ml") + b"\x10\x03")
    entry = part(14, part(1, b"key") + part(2, b"value"))
    return b"\x08\x0a" + part(2, b"holdfast") + part(7, graph) + opsets + entry


def part(number: int, data: bytes) -> bytes:
    """A field of protobuf: its number, its length, itself."""
    length, size = bytearray(), len(data)
    while size > 127:
        length.append(size & 127 | 128)
        size >>= 7
    return bytes([number << 3 | 2, *length, size]) + data


def packed(**shapes: tuple[int, ...]) -> bytes:
    """An archive of arrays of ones, and stamps that go up."""
    file = io.BytesIO()
    arrays: dict[str, Any] = {
        name: np.ones(shape, np.uint8) for name, shape in shapes.items()
    }
    np.savez_compressed(file, time_s=np.arange(2.0), **arrays)
    return file.getvalue()


def small_card() -> bytes:
    """The default model's card without what only people read."""
    content = json.loads(MODEL_CARD.read_text("utf-8"))
    for head in content["heads"].values():
        head.pop("calibration")
    return json.dumps(
        {
            key: value
            for key, value in content.items()
            if key not in ("file", "training")
        }
    ).encode()


STUDY_CARD = b"""first_step = 0
[objects.cup]
mass_g = 212
actions = ["pull"]
[actions.pull]
how = "pull"
[[steps]]
kind = "say"
minutes = 1
[[steps]]
objects = ["cup"]
[[steps.each]]
kind = "record"
minutes = 2
say = "{object} {how}"
"""

JOURNAL = b"""{"event": "opened", "run": 1, "t_s": 0.0, "at": "2026"}
{"event": "begun", "t_s": 0.5, "at": "2026", "part": 0, "kept": 1}
{"event": "answer", "t_s": 1, "at": "2026", "part": 0, "item": "a", "rating": 5}
{"event": "done", "t_s": 2, "at": "2026", "part": 0, "next": 1}
"""
PROTOCOL = b"""title = "x"
[[trials]]
objects = ["cup"]
action = "pull"
style = "author"
count = 3
[objects.cup]
mass_g = 12.5
"""
EVENTS = b"""{"t_s": 0.01, "mark": "load_onset", "provenance": "key"}
{"t0_s": 0.0, "t1_s": 0.02, "label": "risky_slip", "provenance": "camera", "gross_s": 0.01}
{"t0_s": 0.0, "t1_s": 0.02, "label": "grasp", "provenance": "scene"}
"""

TARGETS = {
    "trial": Target(
        trial,
        (HEAD + ROWS, RECORDED, b"\xef\xbb\xbf" + HEAD + ROWS.replace(b"2.5", b"nan")),
    ),
    "mended": Target(
        mended,
        (RECORDED, RECORDED + b"0.08,1,2.", RECORDED[:-1] + bytes(9), RECORDED[:7]),
    ),
    "meta": Target(meta, (b'{"unit": "uT", "mass_g": 20}', b"{}")),
    "truth": Target(truth, (PHASES,)),
    "scene": Target(scene, (CARD, CARD + MORE_OF_A_CARD)),
    "protocol": Target(protocol, (PROTOCOL,)),
    "study_card": Target(study_card, (STUDY_CARD,)),
    "study_journal": Target(study_journal, (JOURNAL,)),
    "events": Target(events, (EVENTS,)),
    "calibration": Target(calibration, (CALIBRATION,)),
    "bias": Target(bias, (BIAS,)),
    "loads": Target(loads, (LOADS,)),
    "model": Target(
        model, (sealed(), b"\x08\x08holdfast", b"holdfast.sha256\x12\x40" + b"0" * 64)
    ),
    "sealed_card": Target(sealed_card, (small_card(),)),
    "onnx_bytes": Target(
        onnx_bytes, (small_onnx(), small_onnx()[:-9], small_onnx() + b"\x08\x0a")
    ),
    "resealed_model": Target(
        resealed_model,
        (b"", b"\x00\x10\x00\x00A", b"\x000\x00\x03A\x80\x02\x00\x01\x03"),
        100,
    ),
    "arrays": Target(
        arrays,
        (
            packed(frames=(2, 3, 4), **dict.fromkeys(LENS, ())),
            packed(frames=(2, 3, 4)),
            b"PK",
        ),
    ),
    "table": Target(table, (b"a,b\n1,2\n3,4\n", b'"a\nb",c\r\n1,2\r\n')),
    "message": Target(
        message, (b"plain", b"\x1b[2J\xc2\x9b31m", b"ft232h", b"i2c-1?x", b"sim:apple")
    ),
    "golden": Target(golden, (GOLDEN,)),
    "fault": Target(fault, (b"nack:3@1.5+0.2", b"unplug@2+1")),
    "layout": Target(
        layout, (b"mux", b"1:35,22,0:35>50", b"moved@71", b"71/0:35,77/1:35>50")
    ),
    "source": Target(
        source,
        (
            b"virtual://ft232h?averages=32&fault=nack:3@1.5%2B0.2&layout=mux6&seed=1",
            b"virtual://ft232h?layout=mux@77&fault=noise@0%2B9",
            b"sim://nobody?seed=1&trial=2&rate_hz=50",
            b"replay://a.csv",
            b"a#0",
            b"i2c://1",
            b"usb://ft232h?number=2",
            b"udp://127.0.0.1:9000?network=1&stamps=sender&rate_hz=150&unit=uT",
            b"serial:///dev/ttyACM0?baud=115200",
            b"tcp://localhost:9000?listen=1",
            b"stdin://?paced=1",
        ),
        100,
    ),
    "sample_lines": Target(
        sample_lines,
        (
            b'j{"session":1,"sequence":2,"t_ms":3,"X1":1,"Y1":2,"Z1":-3.5}\n',
            b"cTime,X1,Y1,Z1,valid1\n0.1,1,2,3,1\n0.2,nan,,3,0\n",
            b'm{"t":5,"f":[1,2,null]}\nt;f.0;f.1;f.2\n1,5;2;3;4\n',
            b'k{"session":1,"sequence":2,"X1":1,"Y1":2,"Z1":3}\n',
        ),
    ),
    "commands": Target(
        commands,
        (
            b'{"session": 1, "sequence": 2, "opening": true}\n{"override": true}',
            b'{"session": 7, "sequence": 3, "opening": false, "override": false}',
        ),
    ),
    "link_line": Target(
        link_line,
        (
            b'{"session":1,"sequence":2,"target_n":9.4}\n{"session":1,"sequence":3}',
            LINK_KEY.sealed(b'{"session":1,"sequence":1}')[:-1],
            b'{"session":1,"sequence":1,"target_n":-Infinity,"a":[[1e999]]}',
            b"[" * 2000,
        ),
        300,
    ),
    "link_url": Target(
        link_url, (b"udp://127.0.0.1:9001?envelopes=2", b"unix:///run/a?mode=1"), 100
    ),
    "web_address": Target(web_address, (b"8000", b"[::1]:0", b"0.0.0.0:8000", b"a:b")),
    "web_request": Target(
        web_request,
        (
            b"hGET / HTTP/1.1\r\nHost: localhost:8000\r\n\r\n",
            b"tGET /token/events HTTP/1.0\r\n\r\n",
            b"tPOST /token/do/mark HTTP/1.1\r\nOrigin: http://a\r\nHost: a\r\n\r\n",
            b"hGET /save HTTP/1.0\r\nHost: localhost\r\n\r\n",
            b"hGET /\r\n",
        ),
        100,
    ),
    "ft232h": Target(bridge(VirtualFt232h, Ft232h), spoilings(), 40),
}
TARGETS |= {name: Target(*parts) for name, parts in IMPORT_TARGETS.items()}
