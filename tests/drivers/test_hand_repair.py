"""The hand on a bridge that fails by a script: what is counted, said and opened again, and when."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hand_bench import Bench, bad, started

from holdfast.core.errors import BusStuck, DeviceLost, TransferFailed
from holdfast.drivers.bus import Reply, Transfer


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
        assert np.isnan(reading.values).all() == (reading.why[0] != "")
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


def test_clocks_that_do_not_free_the_bus_close_the_bridge(scripted: Scripted) -> None:
    scripted.scans, scripted.clears = [BusStuck("SDA is low")], [BusStuck("a short")]
    assert scripted.bench.hand.read().why == ("lost",) * 6
    assert scripted.bench.hand.about()["bridge"] is None
    assert "a short" in scripted.bench.messages


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
