"""The README shows what its commands print."""

from __future__ import annotations

import re
from argparse import Namespace
from pathlib import Path

import pytest
from page_tables import filled

from examples.demo import demo, demo_trials

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.filterwarnings("ignore::holdfast.step.spec.BandsLeftOut")
def test_the_readme_shows_the_real_output_of_the_demo(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert demo.run(Namespace(out=Path("build/demo"))) == 0
    shown = re.search(
        r"<!-- demo:.*?-->\n```text\n(.*?)```",
        (ROOT / "README.md").read_text(),
        re.DOTALL,
    )
    assert shown is not None
    assert shown[1] == capsys.readouterr().out
    report = Path("build/demo/report.html").read_text("utf-8")
    drawn = re.findall(r"<h3>\S+/(\S+)/trial_1 \(simulated\)", report)
    assert sorted(drawn) == sorted(demo_trials.SHOWN)
    assert report.count("<svg") == 2 + len(demo_trials.SHOWN)


def test_the_page_of_features_is_written_from_the_groups(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "how-it-works.md").read_text("utf-8")
    assert filled("docs/how-it-works.md", {}, tmp_path) == text
