"""The lab streaming layer by pylsl, which only this module imports.

Streams are found by name on the local network, and all machines there can receive what is sent.
liblsl's own file `lsl_api.cfg` restricts both, to this machine for instance (docs/formats.md).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import Any

from holdfast.core.contract import Unit, channel_names
from holdfast.core.errors import (
    DeviceLost,
    DeviceNotFound,
    LibraryMissing,
    needs_extra,
)
from holdfast.drivers.lsl import DECISION, LslAnswers, StreamFacts

try:
    with needs_extra("lsl"):
        import pylsl
        from pylsl.util import LostError
except RuntimeError:  # pylsl's own, where its wheel has no liblsl
    raise LibraryMissing(
        "no liblsl",
        where="pylsl",
        cause="the wheel of pylsl for this processor does not bring it (x86_64 only)",
        next_step="install liblsl, or name it in PYLSL_LIB (docs/formats.md)",
    ) from None

FIND_S = 5.0
KEPT_S = 2
"""An inlet keeps what is not read for so long."""
MOST_AT_ONCE = 4096


class LslInlet:
    """An opened stream. Raises DeviceNotFound where none has this name."""

    def __init__(self, name: str) -> None:
        found = pylsl.resolve_byprop("name", name, 1, FIND_S)
        if not found:
            raise DeviceNotFound(
                "no such stream on the network",
                where=f"lsl://{name}",
                cause="it is not sent yet, has another name, or a firewall blocks it",
                next_step="start the sender first; LabRecorder lists streams by name",
            )

        self._inlet: Any = pylsl.StreamInlet(
            found[0], KEPT_S, 1
        )  # 1: no sample waits for others
        try:
            self.facts = _facts(self._inlet.info(FIND_S))
            self._inlet.open_stream(FIND_S)
            self._inlet.time_correction(FIND_S)
        except (TimeoutError, LostError) as error:
            raise DeviceNotFound(
                f"the stream does not open ({type(error).__name__})",
                where=f"lsl://{name}",
                cause="its sender just ended, or a firewall blocks its data",
                next_step="start the sender again",
            ) from None

    def pull(self, timeout_s: float) -> list[tuple[float, list[float]]]:
        """(stamp in s on this machine's LSL clock, values) of all samples that came, oldest first.

        Waits at most timeout_s for the first. Raises DeviceLost where the stream cannot come back.
        """
        try:
            first, stamp = self._inlet.pull_sample(timeout_s)
            if first is None:
                return []
            # the first call waited; this one takes what else has come
            rows, stamps = self._inlet.pull_chunk(0.0, MOST_AT_ONCE)
            correction_s = self._inlet.time_correction(FIND_S)
        except (TimeoutError, LostError):
            raise DeviceLost(
                "the stream ended", where=self.facts.name, cause="its sender ended"
            ) from None

        pairs = zip([stamp, *stamps], [first, *rows], strict=True)
        return [(correction_s + at_s, values) for at_s, values in pairs]

    def clock_s(self) -> float:
        """Now, on this machine's LSL clock."""
        return float(pylsl.local_clock())

    def close(self) -> None:
        """Stop receiving."""
        self._inlet.close_stream()


class LslOutlet:
    """A stream of doubles that threads of liblsl send."""

    def __init__(
        self,
        name: str,
        kind: str,
        rate_hz: float,
        labels: Sequence[str],
        units: Sequence[str],
    ) -> None:
        # By its source_id a receiver finds the stream again after a restart.
        source_id = f"holdfast-{name}"
        info: Any = pylsl.StreamInfo(
            name, kind, len(labels), rate_hz, pylsl.cf_double64, source_id
        )
        info.set_channel_labels(list(labels))
        info.set_channel_units(list(units))
        self._outlet: Any = pylsl.StreamOutlet(info, 1)

    def push(self, values: list[float], stamp_s: float) -> None:
        """Send a sample, stamped on this machine's LSL clock. Never waits."""
        self._outlet.push_sample(values, stamp_s)


def open_answers(
    name: str,
    n_sensors: int,
    unit: Unit,
    rate_hz: float,
    now_ns: Callable[[], int],
    not_learned: Collection[str] = (),
) -> LslAnswers:
    """The streams NAME (values) and NAME-decision.

    now_ns: the clock of the samples' stamps. not_learned: what the model cannot tell.
    """
    labels = channel_names(n_sensors)
    units = [unit] * len(labels)
    samples = LslOutlet(name, "Tactile", rate_hz, labels, units)
    no_units = [""] * len(DECISION)
    decisions = LslOutlet(f"{name}-decision", "Decision", rate_hz, DECISION, no_units)
    offset_ns = now_ns() - round(1e9 * pylsl.local_clock())
    return LslAnswers(samples, decisions, offset_ns, not_learned)


def _facts(info: Any) -> StreamFacts:
    # a sender may leave labels and units out, all of them or single ones
    none = [""] * info.channel_count()
    labels = info.get_channel_labels() or none
    units = info.get_channel_units() or none
    return StreamFacts(
        info.name(),
        info.channel_format() == pylsl.cf_string,
        info.nominal_srate(),
        tuple(label or "" for label in labels),
        tuple(unit or "" for unit in units),
    )
