"""A bridge whose answers are cut off, filled with noise or errors: a hand on it never raises."""

from __future__ import annotations

import os
from collections.abc import Callable

import numpy as np
import pytest
import usb.core

from holdfast.core.errors import HoldfastError
from holdfast.drivers.ft232h import Ft232h
from holdfast.drivers.hand import Hand
from holdfast.drivers.layout import read_layout
from holdfast.drivers.tmag5273.registers import FACTORY_ADDRESSES
from holdfast.drivers.virtual.faults import VirtualClock
from holdfast.drivers.virtual.ft232h import VirtualFt232h
from holdfast.drivers.virtual.usb_backend import VirtualBackend
from holdfast.drivers.virtual.virtual_hand import VirtualHand

ERRNOS = (5, 13, 16, 19, 32, 75, 110)
READS = 6
SPOILT_ANSWERS = 40


class Spoiler:
    """Spoils a quarter of some answers of a bridge, and then lets it be honest again.

    first: how many answers are left alone before.
    """

    def __init__(self, first: int, seed: int) -> None:
        self._answers = 0
        self._spoilt = range(first, first + SPOILT_ANSWERS)
        self._rng = np.random.default_rng(seed)

    def between(self, answer: Callable[..., bytes]) -> Callable[..., bytes]:
        """The same call, spoilt; what it asks for last is a length."""
        return lambda *request: self._spoil(answer(*request), request[-1])

    def _spoil(self, answer: bytes, length: int) -> bytes:
        self._answers += 1
        if self._answers not in self._spoilt or self._rng.random() < 0.75:
            return answer
        how = self._rng.integers(4)
        if how == 0:
            return answer[: self._rng.integers(len(answer) + 1)]
        if how == 1:
            place = self._rng.integers(len(answer) + 1)
            noise = self._rng.bytes(int(self._rng.integers(1, 32)))
            return (answer[:place] + noise + answer[place + len(noise) :])[:length]
        if how == 2:
            return self._rng.bytes(int(self._rng.integers(length + 1)))
        number = int(self._rng.choice(ERRNOS))
        raise usb.core.USBError(os.strerror(number), number, number)


@pytest.mark.parametrize("first", [0, 5, 20, 42, 52, 120, 200, 300, 430, 550])
@pytest.mark.parametrize("seed", range(4))
def test_a_hand_on_a_bridge_with_spoilt_answers_starts_or_says_why_and_then_never_raises(
    monkeypatch: pytest.MonkeyPatch, first: int, seed: int
) -> None:
    clock = VirtualClock()
    virtual = VirtualHand(clock)
    bridge, spoiler = VirtualFt232h(virtual), Spoiler(first, seed)
    monkeypatch.setattr(bridge, "read", spoiler.between(bridge.read))
    backend = VirtualBackend(bridge)
    hand = Hand(
        lambda: Ft232h(backend),
        read_layout("mux", FACTORY_ADDRESSES),
        now_ns=clock.now_ns,
        pause=lambda seconds: clock.spend(round(1e9 * seconds)),
    )
    try:
        hand.start()
    except HoldfastError:
        hand.close()
        return
    for _ in range(READS):
        reading = hand.read()
        assert reading.values.shape == (18,)
        assert np.isfinite(reading.values[np.repeat(reading.valid, 3)]).all()
        assert [not why for why in reading.why] == reading.valid.tolist()
        clock.spend(25_000_000)
    hand.close()
