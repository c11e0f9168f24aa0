"""A bridge whose answers are cut off, filled with noise or errors: a hand on it never raises."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import pytest
import usb.core

from holdfast.core.errors import HoldfastError
from holdfast.drivers.ft232h import Ft232h
from holdfast.drivers.hand import Hand
from holdfast.drivers.virtual.clock import VirtualClock
from holdfast.drivers.virtual.ft232h import VirtualFt232h
from holdfast.drivers.virtual.usb_backend import VirtualBackend
from holdfast.drivers.virtual.usb_device import Device
from holdfast.drivers.virtual.virtual_hand import VirtualHand

ERRNOS = (5, 13, 16, 19, 32, 75, 110)
READS = 6
SPOILT_ANSWERS = 40


class SpoiltBridge(Device):
    """An emulated bridge that spoils a quarter of some answers, and then is honest again.

    first: how many answers are left alone before.
    """

    def __init__(self, device: Any, first: int, seed: int) -> None:
        self._device = device
        self._answers = 0
        self._spoilt = range(first, first + SPOILT_ANSWERS)
        self._rng = np.random.default_rng(seed)
        self.device_descriptor = device.device_descriptor
        self.configuration = device.configuration

    def control_out(
        self, request_type: int, request: int, value: int, index: int, data: bytes
    ) -> None:
        self._device.control_out(request_type, request, value, index, data)

    def control_in(
        self, request_type: int, request: int, value: int, index: int, length: int
    ) -> bytes:
        answer = self._device.control_in(request_type, request, value, index, length)
        return self._spoil(answer, length)

    def write(self, endpoint: int, data: bytes) -> None:
        self._device.write(endpoint, data)

    def read(self, endpoint: int, length: int) -> bytes:
        return self._spoil(self._device.read(endpoint, length), length)

    def reset(self) -> None:
        self._device.reset()

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
    first: int, seed: int
) -> None:
    clock = VirtualClock()
    virtual = VirtualHand(clock)
    bridge = SpoiltBridge(VirtualFt232h(virtual), first, seed)
    backend = VirtualBackend(bridge, clock, virtual.faults, virtual.power_off)
    hand = Hand(
        lambda: Ft232h(backend),
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
        assert reading.field_ut.shape == (6, 3)
        assert np.isfinite(reading.field_ut[reading.valid]).all()
        assert [not why for why in reading.why] == reading.valid.tolist()
        clock.spend(25_000_000)
    hand.close()
