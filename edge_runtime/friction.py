"""placeholder"""

from __future__ import annotations


class FrictionMargin:
    def __init__(self, lanes, rate_hz):
        pass

    def step(self, sense):
        pass
