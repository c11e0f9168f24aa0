"""`python -m studies robustness`: learners on chosen columns, one confidence, and the table."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from long_steps import long_steps
from page_tables import filled

from holdfast.core.errors import HoldfastError
from holdfast.core.reading import Json
from holdfast.edge_runtime.model import Model
from holdfast.simulation.folder import write_set
from holdfast.simulation.scene import Scene
from holdfast.simulation.scene_file import read_scene_file
from holdfast.training.plan import CLOCK_FREE_GROUPS, POOLED_GROUPS, pooled_plan
from studies import robustness as robust
from studies.distortions.table import by_name
from studies.robustness import (
    ASK_SEED,
    CHOOSE_SEED,
    TRAIN_SEED,
    Asked,
    Choice,
    Sizes,
    choices,
)
from tools import harness
from tools.harness import SimulatedSet

SMALL = Sizes(train=10, choose=4, ask=4, turns=1, calls=2)


def test_each_family_is_left_out_once_and_every_disturbance_is_of_the_study() -> None:
    without = {choice.groups for choice in choices()}
    for group in POOLED_GROUPS:
        assert tuple(one for one in POOLED_GROUPS if one != group) in without
    names = [choice.name for choice in choices()]
    assert len(set(names)) == len(names)
    assert set(robust.DISTURBED) <= set(by_name())
    assert all(100 <= seed < 200 for seed in (TRAIN_SEED, CHOOSE_SEED, ASK_SEED))
    assert len({TRAIN_SEED, CHOOSE_SEED, ASK_SEED}) == 3


def test_the_confidence_is_the_least_at_which_few_voluntary_actions_are_called(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Called:
        def __init__(self, share: float) -> None:
            self.called = {str(k): k < 100 * share for k in range(100)}

    class Same(Asked):
        def outputs(self, name: str) -> list[object]:  # type: ignore[override]
            return []

        def became(self, outputs: object, permille: int) -> Called:  # type: ignore[override]
            return Called((1000 - permille) / 1000)

    asked = Same(None, 1, 1)  # type: ignore[arg-type]
    assert robust.confidence_of(asked) == 920


@pytest.fixture(scope="module")
def measured(
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[Path, Json]:
    """Two choices on a few trials."""
    out = tmp_path_factory.mktemp("robust")
    chosen = [
        Choice("fixed", CLOCK_FREE_GROUPS, copies=False),
        Choice("pooled", ("pooled_state", "pooled_shear")),
    ]
    plan = pooled_plan("tiny")
    network = replace(plan.network, hidden=(3,), members=1, epochs=1)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(robust, "PLAN", replace(plan, network=network))
        # in this process, which has its libraries loaded
        patched.setattr(harness, "AT_ONCE", 1)
        with long_steps():
            # in the place of the card wide, whose texture asks for short steps
            card = read_scene_file("p1", rate_hz=robust.RATE_HZ)
            write_set(Scene(card, 1), out / f"wide-{SMALL.train}", SMALL.train)
            return out, robust.robust(out, SMALL, lambda line: None, chosen)


def test_sets_are_simulated_in_processes_and_one_that_fails_is_named(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    card = tmp_path / "still.toml"
    card.write_text('[[trials]]\naction = "nothing"\nlasts_s = 2\n', "utf-8")
    sets = [SimulatedSet("still", str(card), 1), SimulatedSet("none", "nowhere", 1)]
    with pytest.raises(HoldfastError, match="holdfast simulate nowhere --trials 1"):
        harness.simulate_sets(sets, tmp_path)
    assert (tmp_path / "still" / "meta.json").is_file()
    assert "error: " in capfd.readouterr().err


def test_a_choice_is_a_file_that_answers_and_is_timed(
    measured: tuple[Path, Json], tmp_path: Path
) -> None:
    out, figures = measured
    rows = figures["rows"]
    assert [row["name"] for row in rows] == ["fixed", "pooled"]
    assert rows[0]["over_first"] == 1.0
    assert all(set(row["sets"]) == {"unchanged", *robust.DISTURBED} for row in rows)
    own, with_copies = figures["windows"]
    assert with_copies >= 2 * own
    # fixed features need every sensor; of a dead one on, all they can say is unknown
    dead = [row["sets"]["dead-1-invalid"]["unknown"] for row in rows]
    assert dead[0] > dead[1]
    needs = [Model(out / f"{k}.onnx").card.min_valid_sensors for k in (1, 2)]
    assert needs == [6, 4]
    page = filled("docs/what-accuracy-costs.md", {"robust": figures}, tmp_path)
    assert "| pooled | " in page
