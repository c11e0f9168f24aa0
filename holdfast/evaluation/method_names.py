"""Names of the evaluated methods: as figures.json stores them, and as people read them."""

from __future__ import annotations

DEPLOYED, CHOSEN = "ours, as deployed", "ours, confidence chosen"
BAND, CONE, SHEAR_RATE = "band-pass bank", "friction cone", "one line of code"
RAW, ORACLE = "raw-window forest", "perfect intent"
DISPLAY_NAMES = {
    DEPLOYED: "this model, as deployed",
    CHOSEN: "this model, chosen confidence",
    SHEAR_RATE: "shear-rate threshold",
    ORACLE: "oracle",
}
"""Stored name -> the name that people read, where they differ."""
LAWS = {
    BAND: "a shear signal exceeds its own noise floor in one of ten bands (setting: ratio)",
    CONE: "shear / normal force of a finger leaves the friction cone (setting: coefficient)",
    SHEAR_RATE: "summed shear changes within two samples by more than a threshold (setting: N)",
    RAW: "the thesis' forest: 100 untuned trees on the last 0.10 s (setting: confidence)",
    ORACLE: "an upper bound: knows the person's intent, acts one sample after load onset",
}
"""How each baseline decides, and what its setting is."""


def display_name(stored: str) -> str:
    """A stored name as people read it.

    >>> display_name("one line of code"), display_name("friction cone")
    ('shear-rate threshold', 'friction cone')
    """
    return DISPLAY_NAMES.get(stored, stored)


def is_this_model(stored: str) -> bool:
    """Whether a stored name is the evaluated model and no baseline."""
    return stored in (DEPLOYED, CHOSEN)
