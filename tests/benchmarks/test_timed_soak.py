"""The live loop in real time on an emulated chip: `timed` loses no more samples than today's.

HOLDFAST_SOAK_S=60 makes it a minute; `pytest -s` prints the counts of both ways.
"""

from __future__ import annotations

import os
import sys

import pytest

from benchmarks.timed_soak import TURN_S, measure

SOAK_S = float(os.environ.get("HOLDFAST_SOAK_S", "3600"))


@pytest.mark.soak
def test_scans_queued_ahead_lose_no_more_samples_than_the_host_s_own_in_real_time():
    today, timed = measure(SOAK_S, min(TURN_S, SOAK_S / 4))["rows"]
    for row in (today, timed):
        sys.stdout.write(
            f"{row['way']}: {row['samples']} samples, {row['overruns']} lost\n"
        )
        assert row["samples"] > 100
    assert timed["overruns"] <= today["overruns"] + 16, "one queue more may be chance"
