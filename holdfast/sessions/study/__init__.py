"""A study with people: the steps of a study protocol, one participant at a time.

    OUT/<person>/study.jsonl         what happened, in order; a run goes on where the last one ended
    OUT/<person>/protocol.toml       the protocol as it was when the person began
    OUT/<person>/report.html, .json  the report of this person
    OUT/withdrawn.jsonl              who withdrew, when, and which files were deleted

The trials are those of the recorder, in its layout and by its code (holdfast/sessions/recorder).
"""

from pathlib import Path

from holdfast.core.schema import card_names

PROTOCOLS = Path(__file__).with_name("protocols")
"""Folder of the study protocols that ship."""


def shipped_protocols() -> list[str]:
    """Names of the study protocols that ship, sorted."""
    return card_names(PROTOCOLS)
