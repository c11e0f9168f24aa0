"""Figures of plain lifts: when alarms begin, what squeezes, and rates over people."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from holdfast.core.contract import GRASP, NOTHING, RISKY_SLIP
from holdfast.data.recording import Recording
from holdfast.data.timeline import Phase
from holdfast.edge_runtime.decision import DecisionRules
from holdfast.evaluation.model_outputs import ModelOutputs
from studies.people.figures import lifts_of, parts_of, summary

RATE_HZ = 150.0
RULES = DecisionRules(act_samples=1, min_risky_permille=740, evidence_ms=20)
ROWS = 900
CONTACT = Phase(300, 600, GRASP)
"""Two seconds."""


def answered(person: str, alarms: list[int], load_n: float = 0.2) -> ModelOutputs:
    """Six seconds with one contact, 4 N a side; at single rows more load, and a sure risky slip."""
    samples = np.zeros((ROWS, 6))
    samples[300:600] = [0.0, load_n, 4.0, 0.0, load_n, 4.0]
    recording = Recording(
        trial_id=person,
        group=person,
        samples=samples,
        valid=np.ones((ROWS, 2), np.bool_),
        rate_hz=RATE_HZ,
        unit="N",
        object_name="texture",
        action="lift",
        phases=(Phase(150, 300, NOTHING), CONTACT, Phase(600, 750, NOTHING)),
        person=person,
    )
    situation = np.full(ROWS, NOTHING)
    situation[300:600] = GRASP
    permille = np.zeros(ROWS, np.int64)
    p = np.zeros((ROWS, 4), np.float32)
    for row in alarms:
        situation[row] = RISKY_SLIP
        permille[row] = 1000
        samples[row, 1::3] *= 2.0
        p[row, RISKY_SLIP] = 1.0
    return ModelOutputs(recording, situation, permille, p, situation)


def test_an_alarm_counts_where_it_begins() -> None:
    # 0.2 s of contact end at row 330, the last 0.15 s begin at row 578
    of = lifts_of([answered("a", [310, 400, 590, 700])], RULES, 740)
    (lift,) = of.lifts
    assert (lift.alarms_begin, lift.alarms_hold, lift.alarms_end) == (1, 1, 1)
    # the one after the contact counts for the recording alone
    assert of.recordings[0].alarms == 4
    assert of.recordings[0].minutes == pytest.approx(0.1)


def test_rows_that_are_left_out_are_no_minute_and_bring_no_alarm() -> None:
    one = answered("a", [310, 700])
    cut = replace(one, recording=replace(one.recording, left_out=((650, 900),)))
    of = lifts_of([cut], RULES, 740)
    assert of.recordings[0].alarms == 1
    assert of.recordings[0].minutes == pytest.approx(650 / 150 / 60)


def test_a_lift_is_squeezed_where_the_target_is_above_the_recorded_grip() -> None:
    quiet = lifts_of([answered("a", [])], RULES, 740).lifts[0]
    slipping = lifts_of([answered("a", list(range(400, 500)))], RULES, 740).lifts[0]
    assert quiet.over_n < 1.0 < slipping.over_n
    # with all probabilities 0 both are the same hand
    assert slipping.over_without_model_n == quiet.over_without_model_n


def test_rates_are_sums_over_people_and_intervals_draw_people() -> None:
    of = lifts_of([answered("a", [400, 500]), answered("b", [])], RULES, 740)
    figures = summary(of)
    assert figures["people"] == figures["lifts"] == 2
    assert figures["alarms_a_minute_of_recording"]["value"] == pytest.approx(2 / 0.2)
    assert figures["alarms_a_minute_of_recording"]["ci"] == (0.0, pytest.approx(20.0))
    assert figures["lifts_with_an_alarm"]["value"] == 0.5
    assert figures["alarms_a_minute_in_the_hold"]["value"] == pytest.approx(10.0)
    assert parts_of(of, lambda lift: lift.person)["b"]["lifts_with_an_alarm"] == 0.0
