"""The measurement of the live page: its browsers stall in earnest, and its table fits its page."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from page_tables import filled

from benchmarks.live_page import Case, watched_run


def test_a_watched_run_counts_its_samples_its_gaps_and_what_its_browsers_got(
    tmp_path: Path,
):
    row = watched_run(Case("two stalled, one reading", stalled=2, reading=1), 1.0)
    assert 100 <= row.samples + row.overruns <= 151  # the first scans test the pace
    assert row.frames_per_s is not None
    assert row.frames_per_s > 0.0
    assert 0.0 < row.latency_p50_us <= row.latency_p999_us
    figures = {"rows": [asdict(row), asdict(row)]}
    written = filled("docs/live-page.md", {"live_page": figures}, tmp_path)
    assert f"| two stalled, one reading | {2 * row.samples} |" in written
