"""Everything that is fixed when a step graph is built, as one object with a JSON form."""

from __future__ import annotations

import math
import warnings

import msgspec

from holdfast.core.contract import NORMAL_FLOOR, Json, Unit, is_rate
from holdfast.core.errors import ChannelError, RateError
from holdfast.core.hand_card import HandCard

BANDS_HZ = tuple(float(band) for band in range(10, 60, 5))
"""Nominal frequencies of the filter bank of Engeberg and Meek."""
HIGHEST_SHARE = 0.46
"""Closer to half the rate, prewarping makes a band ring: 25 Hz at 50.1 Hz for 32 s."""
WINDOW_S = 0.10
"""Length of the thesis' raw window."""
HISTORY_S = 0.50
"""Nothing older reaches a feature (the band-pass bank apart)."""
GAP_S = 0.020
"""A sensor lost for longer than this must settle again; a shorter gap is bridged."""

RANGE_LIMIT: dict[Unit, float] = {"N": 500.0, "uT": 1.0e5, "count": 1.0e6}
"""A reading at or above this is a fault: the supported sensors cannot read as much."""

NOISE_RMS: dict[Unit, float] = {"N": 0.02, "uT": 22.0, "count": 4.0}
"""RMS noise of one quiet channel: the noise floor of the bank is never below its response to it."""


class BandsLeftOut(UserWarning):
    """Some bands are too close to half the sampling rate, or above it, and left out."""


def bands_for(
    rate_hz: float, bands_hz: tuple[float, ...] = BANDS_HZ
) -> tuple[float, ...]:
    """The bands below 0.46 of a sampling rate. Raises RateError if there is none."""
    usable = tuple(band for band in bands_hz if band < HIGHEST_SHARE * rate_hz)
    if not usable:
        lowest = min(bands_hz)
        raise RateError(
            f"{rate_hz:.4g} Hz carries none of the bands",
            cause=f"the lowest band is {lowest:g} Hz "
            f"and needs more than {lowest / HIGHEST_SHARE:.4g} Hz",
            next_step="record faster",
        )

    return usable


def window_samples(rate_hz: float, window_s: float = WINDOW_S) -> int:
    """Samples in a window, both ends included, at least 2.

    >>> [window_samples(rate_hz) for rate_hz in (10, 50, 58.9, 100, 150, 300)]
    [2, 6, 6, 11, 16, 31]
    """
    # a product that is whole on paper can come out just below: 1e-9 keeps its last sample
    return max(2, math.floor(window_s * rate_hz + 1e-9) + 1)


class DetectorSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Thresholds of the causal detectors; one setting for all objects.

    band_ratio: fires above this multiple (over 1) of the channel's noise floor. floor_tau_s:
    time constant of the floor. floor_clip: the floor follows at most this multiple of itself.
    firing_rate: factor on the floor's speed while firing (above 0, so that lasting noise cannot
    hold an alarm). quiet_s: quiet before a critical point. friction, min_normal_n: of the friction
    cone, unit N only.

    Units: floor_tau_s and quiet_s in s, min_normal_n in N, all others are ratios.
    """

    band_ratio: float = 6.0
    floor_tau_s: float = 2.0
    floor_clip: float = 3.0
    firing_rate: float = 1.0 / 16.0
    quiet_s: float = 0.3
    friction: float = 0.8
    min_normal_n: float = 0.5


ON_SHARE, OFF_SHARE = 2.0 / 3.0, 0.4
"""Contact begins above, and ends below, these shares of the normal force of a touching finger."""
ZERO_S = 0.2
"""Time constant, in s, with which the zero follows what is small; noise must not move it."""
ZERO_SHARE_PER_S = 0.1
"""The zero of an empty hand follows by at most this share of it a second: 30 mN/s."""
MEAN_S, LEAST_MEAN = 0.04, 6
"""Time constant, in s, of the mean that contact is judged by, and its fewest samples."""
DIGITS = 9
"""Of the rule's numbers, which stand in the card for people to read."""
USUAL_SENSORS = 6
"""The shares are for so many sensors."""
CONTACT_UNITS: tuple[Unit, ...] = ("N",)
"""Units in which force decides "nothing" unless a spec says otherwise (docs/decisions.md)."""


class ContactRule(msgspec.Struct, frozen=True):
    """When a hand touches something, by force alone (`add_contact` in holdfast/step/guard.py).

    on, off: contact begins from `on` on and ends below `off`; both are lengths of the mean of all
    channels, in the unit of the model. mean_s: time constant of that mean. zero_s, zero_per_s: time
    constant with which the zero of a channel follows an empty hand, and its highest speed, unit/s.
    """

    on: float
    off: float
    mean_s: float
    zero_s: float
    zero_per_s: float


POOLED = "pooled_"
"""Begins the names of feature groups that are pooled over the sensors (pooled.py)."""


class StepSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The specification of a step graph: channels, rate, unit, features, guard and detectors.

    rate_hz: rate of all constants. groups: feature groups by name (holdfast/step/features.py).
    min_valid_sensors: fewer usable sensors than this make the state unknown; 0 for all, or for two
    thirds where all features are pooled. window_s: length of the raw window. hand: its card, with
    the sides of its sensors, or None. force_decides: force decides "nothing", not the learner; None
    for the default of the unit.
    """

    n_sensors: int
    rate_hz: float
    unit: Unit
    groups: tuple[str, ...]
    min_valid_sensors: int = 0
    bands_hz: tuple[float, ...] = BANDS_HZ
    window_s: float = WINDOW_S
    detectors: DetectorSpec = DetectorSpec()
    hand: HandCard | None = None
    force_decides: bool | None = None

    def __post_init__(self) -> None:
        if self.n_sensors < 1:
            raise ChannelError(
                f"{self.n_sensors} sensors", next_step="give at least one 3-axis sensor"
            )
        if self.hand is not None and self.hand.n_sensors != self.n_sensors:
            raise ChannelError(f"{self.n_sensors} sensors, another number on the card")
        if not is_rate(self.rate_hz):
            raise RateError(
                f"a rate of {self.rate_hz} Hz", next_step="check the time stamps"
            )

        silent = self.hand.unmeasured_names if self.hand else ()
        if silent and (self.unit == "uT" or not self.is_pooled):
            raise ChannelError(
                f"{', '.join(silent)}: not measured, by the hand card, and fixed features and "
                "fields in uT need all three axes of a sensor",
                where=self.hand.name if self.hand else "",
                next_step="train with --features pooled, on forces",
            )

        # the class is frozen, so what hangs on other fields is filled in this way
        fill_in = msgspec.structs.force_setattr
        if self.force_decides is None:
            fill_in(self, "force_decides", self.unit in CONTACT_UNITS)
        if not self.min_valid_sensors:
            needed = self.n_sensors
            if self.is_pooled:
                # measured with one and two dead sensors of six
                needed = -(-2 * self.n_sensors // 3)
            fill_in(self, "min_valid_sensors", needed)
        if not 1 <= self.min_valid_sensors <= self.n_sensors:
            raise ChannelError(
                f"min_valid_sensors={self.min_valid_sensors}",
                next_step=f"give 1 to {self.n_sensors}, or 0 for the default",
            )

    @property
    def n_channels(self) -> int:
        """Channels C = 3 x sensors."""
        return 3 * self.n_sensors

    @property
    def is_pooled(self) -> bool:
        """Whether all features are pooled, so that its learner fits any number of sensors."""
        return all(name.startswith(POOLED) for name in self.groups)

    @property
    def window_samples(self) -> int:
        """Samples in the raw window: max(2, floor(window_s x rate) + 1)."""
        return window_samples(self.rate_hz, self.window_s)

    @property
    def history_samples(self) -> int:
        """Past samples kept; nothing older than 0.5 s can reach a feature."""
        return max(self.window_samples - 1, math.floor(HISTORY_S * self.rate_hz + 1e-9))

    @property
    def settle_samples(self) -> int:
        """Good samples that a sensor must deliver before it is settled."""
        return self.history_samples + 1

    @property
    def gap_samples(self) -> int:
        """Longest run of lost samples that is bridged (20 ms)."""
        return math.floor(GAP_S * self.rate_hz + 1e-9)

    @property
    def floor_share(self) -> float:
        """Share of the distance that a noise floor moves at each sample."""
        return min(1.0, 1.0 / (self.detectors.floor_tau_s * self.rate_hz))

    @property
    def contact(self) -> ContactRule | None:
        """The rule by which force decides "nothing"; None where the learner does."""
        if not self.force_decides:
            return None
        floor = NORMAL_FLOOR[self.unit]
        # the length of noise grows with the root of the number of channels
        more = max(1.0, math.sqrt(self.n_sensors / USUAL_SENSORS))
        return ContactRule(
            on=round(ON_SHARE * floor * more, DIGITS),
            off=round(OFF_SHARE * floor * more, DIGITS),
            mean_s=max(MEAN_S, LEAST_MEAN / self.rate_hz),
            zero_s=ZERO_S,
            zero_per_s=round(ZERO_SHARE_PER_S * floor, DIGITS),
        )

    def lag(self, seconds: float) -> int:
        """A lag in samples: at least 1, at most the history."""
        return min(max(1, round(seconds * self.rate_hz)), self.history_samples)

    def usable_bands(self) -> tuple[float, ...]:
        """The bands of the bank at this rate. Raises RateError if there is none."""
        return bands_for(self.rate_hz, self.bands_hz)

    def lost_bands(self) -> tuple[float, ...]:
        """The bands left out at this rate, as in the model's metadata."""
        usable = self.usable_bands()
        return tuple(band for band in self.bands_hz if band not in usable)

    def warn_of_lost_bands(self) -> None:
        """Warn (BandsLeftOut) of bands left out at this rate; RateError if there is no band."""
        lost = ", ".join(f"{band:g}" for band in self.lost_bands())
        if lost:
            warnings.warn(
                f"bands left out at {self.rate_hz:.4g} Hz: {lost} Hz (too near half the rate, or "
                "above it; the others are used)",
                BandsLeftOut,
                stacklevel=2,
            )

    def to_json(self) -> Json:
        """As a JSON object, for the artifact and the metadata; without a hand card no "hand"."""
        fields: Json = msgspec.to_builtins(self)
        del fields["hand"]
        if self.hand is not None:
            fields["hand"] = self.hand.to_json()
        return fields

    @staticmethod
    def from_json(value: Json) -> StepSpec:
        """The inverse of `to_json`. Raises ValueError for keys or types that do not fit."""
        return msgspec.convert(value, StepSpec)
