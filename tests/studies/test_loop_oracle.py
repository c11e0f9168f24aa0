"""The honest oracle: of several closures of one drive, the first that keeps the object counts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from loop_bench import MODEL, card_text, row

from benchmarks.loop_baselines import CLOSURES
from holdfast.edge_runtime.engine import ModelChoice
from holdfast.evaluation.jobs import Workers
from holdfast.simulation.loop.people import LoopOutcome
from holdfast.simulation.scenes.script_times import Times
from studies.shared_control.closed_loop import (
    BARE,
    ORACLE,
    LoopRequest,
    LoopRuns,
    LoopSet,
    scene_of,
)

KEPT_BY = {"fall": 2.0, "pull": np.inf}
"""Action -> the first closure that keeps the object."""


class Pretended(LoopRuns):
    """Outcomes by rule, not by physics; asked: every (closure, actions) that was run."""

    asked: list[tuple[float | None, list[str]]]

    def _run_places(self, places: Any, from_share: float, to_share: float) -> None:
        for (of, request), some in places.items():
            trials = scene_of(of)[1]
            actions = [trials[k].action for k in some]
            self.asked.append((request.setting, actions))
            made = {k: self._one(trials[k], request) for k in some}
            self._outcomes[of, request] |= made

    @staticmethod
    def _one(trial: Any, request: LoopRequest) -> LoopOutcome:
        times = Times.of(trial)
        first = KEPT_BY.get(trial.action, 0.0)
        closes = request.setting if request.name == ORACLE else 0.0
        assert closes is not None
        gone_s = np.inf if closes >= first else times.act + 0.1
        samples = round(2 * 100.0 * times.act)
        grip_n = np.full(samples, 1.0 + min(closes, 99.0), dtype=np.float32)
        p_risky = np.ones(samples, dtype=np.float32)
        return LoopOutcome(
            trial=trial,
            lost_s=gone_s,
            onset_s=times.act,
            slip_mm=0.0,
            peak_n=1.0,
            overrode_s=np.inf,
            begin_s=0.0,
            rate_hz=100.0,
            mu_hat=np.nan,
            grip_n=grip_n,
            own_n=grip_n,
            target_n=grip_n,
            p_risky=p_risky,
        )


@pytest.fixture
def pretended(tmp_path: Path) -> tuple[Pretended, LoopSet]:
    path = tmp_path / "mine.toml"
    path.write_text(card_text(row("fall"), row("pull"), row("pass")), encoding="utf-8")
    runs = Pretended(ModelChoice(str(MODEL)), Workers(1), lambda share: None)
    runs.asked = []
    return runs, LoopSet(str(path), None, 0)


def test_every_closure_is_tried_on_the_drops_of_the_bare_hand_and_on_no_other_trial(
    pretended: tuple[Pretended, LoopSet],
) -> None:
    runs, of = pretended
    runs.run([(of, LoopRequest(ORACLE))])
    assert runs.asked[0] == (None, ["fall", "pull", "pass"])
    assert runs.asked[1:] == [(closure, ["fall", "pull"]) for closure in CLOSURES]
    assert (1.1, 1.5, 2.0, 3.0, np.inf) == CLOSURES


def test_the_oracle_is_for_each_event_the_gentlest_closure_that_keeps_the_object(
    pretended: tuple[Pretended, LoopSet],
) -> None:
    runs, of = pretended
    runs.run([(of, LoopRequest(ORACLE)), (of, LoopRequest(BARE))])
    made = runs.figures(of, LoopRequest(ORACLE))
    assert (made.drops, made.preventable, made.saved) == (2, 2, 2)
    grips = [float(one.oracle.grip_n[0]) for one in runs.runs(of, LoopRequest(ORACLE))]
    assert grips == [3.0, 100.0, 1.0]
    assert runs.figures(of, LoopRequest(BARE)).saved == 0
