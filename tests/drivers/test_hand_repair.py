"""The hand on a bridge that fails by a script: what is counted, said and opened again, and when."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hand_bench import Bench, bad, started

from holdfast.core.errors import BusStuck, DeviceLost, TransferFailed
from holdfast.drivers.bus import Bus, Reply, Transfer
from holdfast.drivers.fingers import Reading, ScanReplies
from holdfast.drivers.hand import LiveHand
from holdfast.drivers.virtual.virtual_hand import REST_UT


class Scripted:
    """A bridge that is opened and scanned as `opens` and `scans` say; None, or no more: well."""

    def __init__(self, bench: Bench) -> None:
        self.bench, self.bus = bench, bench.open_bus()
        self.opens: list[Exception | None] = []
        self.scans: list[Exception | None] = []
        self.clears: list[Exception | None] = []
        self.opened_ns: list[int] = []
        self.name = "script"

    def open(self) -> Scripted:
        self.opened_ns.append(self.bench.clock.now_ns())
        self._next(self.opens)
        return self

    def scan(self, transfers: Sequence[Transfer]) -> list[Reply]:
        self._next(self.scans)
        return self.bus.scan(transfers)

    def clear(self) -> None:
        self._next(self.clears)

    def close(self) -> None:
        """It stays open below."""

    @staticmethod
    def _next(waiting: list[Exception | None]) -> None:
        if waiting and (error := waiting.pop(0)) is not None:
            raise error


@pytest.fixture
def scripted() -> Scripted:
    """A hand that was started and read, on a bridge that does as a script says from then on."""
    bench = Bench()
    script = Scripted(bench)
    bench.hand._open_bus = script.open
    bench.hand.start()
    assert bad(bench.read_for(0.1)) == []
    script.opened_ns.clear()
    return script


FAILS = TransferFailed("no answer in time", where="script")
GONE = DeviceLost("no longer on USB", where="script")


@pytest.mark.parametrize(
    ("scans", "words"),
    [
        ([FAILS], ["bridge", "", ""]),
        ([FAILS, FAILS], ["bridge", "bridge", "", ""]),
        ([FAILS, FAILS, FAILS], ["bridge", "bridge", "lost"]),
        ([FAILS, FAILS, None, FAILS, FAILS], ["bridge"] * 2 + [""] + ["bridge"] * 2),
        ([GONE], ["lost"]),
        ([BusStuck("SDA is low")], ["stuck", ""]),
    ],
)
def test_three_failures_in_a_row_or_a_lost_bridge_open_it_again_and_fewer_do_not(
    scripted: Scripted, scans: list[Exception | None], words: list[str]
) -> None:
    scripted.scans = list(scans)
    readings = [scripted.bench.read_for(1 / 150)[0] for _ in words]
    assert [one.why for one in readings] == [(word,) * 6 for word in words]
    for reading in readings:
        assert reading.valid.tolist() == [reading.why[0] == ""] * 6
        assert np.isnan(reading.field_ut).all() == (reading.why[0] != "")
    assert scripted.opened_ns == []
    scripted.bench.read_for(1 / 150)
    assert len(scripted.opened_ns) == (words[-1] == "lost")
    # the count begins anew
    scripted.scans = [FAILS, FAILS]
    assert [one.why[0] for one in scripted.bench.read_for(2 / 150)] == ["bridge"] * 2


def test_a_bridge_that_is_gone_is_looked_for_at_once_and_then_every_fifty_milliseconds(
    scripted: Scripted,
) -> None:
    bench, clock = scripted.bench, scripted.bench.clock
    began_ns = clock.now_ns()
    scripted.scans = [GONE]
    scripted.opens = [GONE] * 3
    for after_ns in (0, 0, 49_999_999, 50_000_000, 99_999_999, 100_000_000):
        clock.wait_until(began_ns + after_ns)
        assert bench.hand.read().why == ("lost",) * 6
    expected = [0, 50_000_000, 100_000_000]
    assert [at_ns - began_ns for at_ns in scripted.opened_ns] == expected
    assert bench.hand.about()["bridge"] is None
    clock.wait_until(began_ns + 150_000_000)
    bench.hand.read()
    assert bench.hand.about()["bridge"] == "script"
    said = [line for line in bench.messages if not line.startswith("finger")]
    assert said == ["script: no longer on USB", "script: back"]
    fingers = [line for line in bench.messages if line.startswith("finger 2")]
    assert fingers[0] == "finger 2: lost"


def test_a_hand_that_was_not_started_looks_for_its_bridge_at_its_first_reading() -> (
    None
):
    bench = Bench()
    opened_ns = []

    def gone() -> Bus:
        opened_ns.append(bench.clock.now_ns())
        raise GONE

    bench.hand._open_bus = gone
    assert bench.hand.read().why == ("lost",) * 6
    assert opened_ns == [0]


def test_what_is_wrong_with_a_bus_is_said_once_until_a_scan_goes_well(
    scripted: Scripted,
) -> None:
    stuck, other = BusStuck("SDA is low"), BusStuck("SCL is low")
    scripted.scans = [stuck, stuck, other, stuck, None, stuck]
    scripted.bench.read_for(6 / 150)
    said = [one for one in scripted.bench.messages if not one.startswith("finger")]
    assert said == ["SDA is low", "SCL is low", "SDA is low", "SDA is low"]


def test_clocks_that_do_not_free_the_bus_close_the_bridge(scripted: Scripted) -> None:
    scripted.scans, scripted.clears = [BusStuck("SDA is low")], [BusStuck("a short")]
    assert scripted.bench.hand.read().why == ("lost",) * 6
    assert scripted.bench.hand.about()["bridge"] is None
    assert "a short" in scripted.bench.messages


def test_a_hand_says_what_is_known_of_it_and_is_a_source_in_both_units() -> None:
    bench = started()
    about = bench.hand.about()
    sensors = about.pop("sensors")
    known = {"bridge": "ft232h", "firmware": None, "chip": "TMAG5273", "averages": 32}
    assert about == known
    assert isinstance(sensors, list)
    assert sensors[4] == {
        "finger": 5,
        "address": "0x35",
        "channel": 1,
        "mux": "0x70",
        "ready": True,
        "range_mt": [40.0, 40.0, 80.0],
        "version": 1,
        "serial": None,
    }
    plain, forced = LiveHand(bench.hand), LiveHand(bench.hand, lambda field: -field)
    assert (plain.unit, forced.unit, plain.n_channels) == ("uT", "N", 18)
    for source, sign in ((plain, 1.0), (forced, -1.0)):
        reading = source.read()
        assert reading.valid.all()
        normal = sign * reading.values.reshape(6, 3)[:, 2].mean()
        assert normal == pytest.approx(REST_UT[2], abs=40.0)
    assert plain.about() == bench.hand.about()


# -- times of repairs and of doubt, exactly


class Seen:
    """The bus of a bench; `transfers` are those of the last scans."""

    def __init__(self, bench: Bench) -> None:
        self.bus, self.name = bench.open_bus(), "seen"
        self.clear, self.close = self.bus.clear, self.bus.close
        self.transfers: list[Transfer] = []

    def scan(self, transfers: Sequence[Transfer]) -> list[Reply]:
        self.transfers += transfers
        return self.bus.scan(transfers)


@pytest.fixture
def seen() -> tuple[Bench, Seen]:
    bench = started()
    bench.hand.close()
    return bench, Seen(bench)


@pytest.mark.parametrize(("after_ns", "reads"), [(9_999_999_999, 2), (10**10, 0)])
def test_muxes_are_read_back_for_ten_seconds_after_a_doubtful_reply(
    seen: tuple[Bench, Seen], after_ns: int, reads: int
) -> None:
    bench, bus = seen
    fingers = bench.hand._driven
    reading = fingers.judge(0, ScanReplies([None] * 6, {2}))
    assert reading.why == ("missing", "missing", "mux", *["missing"] * 3)
    bench.clock.wait_until(bench.clock.now_ns() + after_ns)
    fingers.scan(bus)
    to_mux = [one for one in bus.transfers if one.address == 0x70]
    assert len([one for one in to_mux if not one.write]) == reads


@pytest.mark.parametrize(
    ("why", "brought_up"),
    [
        ({1: "reset", 2: "reset", 4: "stale"}, 4),
        ({1: "reset", 2: "reset"}, 2),
        ({0: "saturated", 3: "reset"}, None),
        ({0: "saturated"}, None),
        ({5: "nack"}, None),
        ({5: "reset"}, 5),
    ],
)
def test_the_finger_that_has_waited_longest_is_brought_up_fifty_milliseconds_later(
    seen: tuple[Bench, Seen], why: dict[int, str], brought_up: int | None
) -> None:
    bench, bus = seen
    fingers = bench.hand._driven
    # finger 3 is the only one that was tried less than 50 ms ago
    for state, at_ns in zip(fingers._states, (0, 30, 20, 41, 10, 40), strict=True):
        state.tried_ns = at_ns
    words = tuple(why.get(k, "") for k in range(6))
    nothing = np.full((6, 3), np.nan)
    reading = Reading(50_000_040, nothing, np.zeros(6, bool), words)
    fingers.repair(bus, reading)
    begun = [k for k, one in enumerate(fingers._states) if one.tried_ns > 41]
    assert begun == ([] if brought_up is None else [brought_up])
    assert bool(bus.transfers) == (brought_up is not None)


def test_a_start_waits_for_eight_conversions_of_a_chip_that_does_not_convert() -> None:
    bench = Bench(faults=("frozen:2@0+100",))
    pauses: list[float] = []
    pause = bench.hand._driven._pause

    def noted(pause_s: float) -> None:
        pauses.append(pause_s)
        pause(pause_s)

    bench.hand._driven._pause = noted
    bench.hand.start()
    assert [one for one in pauses if one > 1e-3] == [0.002425] * 9
    assert bench.hand.read().why[0] == ""
