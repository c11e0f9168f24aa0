"""Names of the methods as reports show them; figures.json keeps its stored names."""

from __future__ import annotations

DEPLOYED, CHOSEN = "ours, as deployed", "ours, confidence chosen"
BAND, CONE, SHEAR_RATE = "band-pass bank", "friction cone", "one line of code"
RAW, ORACLE = "raw-window forest", "perfect intent"
"""The stored names: keys of figures.json."""
_SHOWN = {
    DEPLOYED: "this model, as deployed",
    CHOSEN: "this model, chosen confidence",
    SHEAR_RATE: "shear-rate threshold",
    ORACLE: "oracle",
}
BASELINES = {
    BAND: "a shear signal exceeds its own noise floor in one of ten bands (setting: ratio)",
    CONE: "shear / normal force of a finger leaves the friction cone (setting: coefficient)",
    SHEAR_RATE: "summed shear changes within two samples by more than a threshold (setting: N)",
    RAW: "the thesis' forest: 100 untuned trees on the last 0.10 s (setting: confidence)",
    ORACLE: "an upper bound: knows the person's intent, acts one sample after load onset",
}
"""How each baseline decides, and what its setting is."""


def shown(name: str) -> str:
    """A stored name as people read it.

    >>> shown("one line of code"), shown("friction cone")
    ('shear-rate threshold', 'friction cone')
    """
    return _SHOWN.get(name, name)


def is_this_model(name: str) -> bool:
    """Whether a stored name is the evaluated model and no baseline."""
    return name in (DEPLOYED, CHOSEN)
