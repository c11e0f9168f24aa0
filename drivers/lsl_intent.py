"""The wearer's own command from the lab streaming layer: envelopes 0 to 1, or words as text.

Stamps of the sender are put on the run's clock, by the correction that LSL measures.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from holdfast.drivers.lsl import Inlet
from holdfast.edge_runtime.errors import DeviceLost
from holdfast.edge_runtime.intent import Intent, ItemReader, intent_of


class LslIntent:
    """An inlet as a stream of items. A text stream has words in its first channel."""

    def __init__(
        self, inlet: Inlet, now_ns: Callable[[], int], say: Callable[[str], object]
    ) -> None:
        facts = inlet.facts
        self._inlet, self._now_ns, self._say, self._is_text = inlet, now_ns, say, facts.is_text
        self.n_envelopes = 0 if facts.is_text else len(facts.labels)
        self._offset_ns = now_ns() - round(1e9 * inlet.clock_s())
        self._reader, self._ended = ItemReader(say), False

    def came(self) -> list[Intent]:
        """What came; the newest stamp is not in the future."""
        items = [self._item(stamp_s, values) for stamp_s, values in self._pulled()]
        return [one for one in items if one is not None]

    def forget(self) -> None:
        """Drop what came before now."""
        self._pulled()

    def _pulled(self) -> list[tuple[float, Any]]:
        try:
            return list(self._inlet.pull(0.0))
        except DeviceLost:
            if not self._ended:
                self._say(f"intent: lsl://{self._inlet.facts.name} ended")
            self._ended = True
            return []

    def _item(self, stamp_s: float, values: Sequence[Any]) -> Intent | None:
        t_ns = min(round(1e9 * stamp_s) + self._offset_ns, self._now_ns())
        wants, envelope = (values[0], ()) if self._is_text else ("", values)
        return self._reader.item(
            lambda: intent_of(wants, envelope, t_ns, self.n_envelopes), str(values)
        )
