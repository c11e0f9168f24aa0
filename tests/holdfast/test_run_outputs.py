"""`holdfast run --to`: one table of outputs, and what stands in the tables that a run writes."""

from __future__ import annotations

import csv
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from command_line import Run, fails
from live_bench import ROOT, RUN
from made_prediction import prediction

from holdfast.core.contract import RISKY_SLIP, SITUATIONS, GripCommand, Sample
from holdfast.core.errors import UsageError
from holdfast.live.output_table import OUTPUTS, output_url
from holdfast.live.outputs import AnswerFile

HEADER = ["time_s", "state", "p_risky", "act", "target_n"]


def rows_of(path: Path) -> list[list[str]]:
    with path.open(newline="") as lines:
        return list(csv.reader(lines))


# -- one table


def test_the_help_the_error_and_the_page_list_the_same_outputs(
    run: Run, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        run("run", "--help")
    shown = " ".join(capsys.readouterr().out.split())
    _, _, refused = run(*RUN[3:], "--to", "best")
    page = (ROOT / "docs/on-a-hand.md").read_text("utf-8")
    section = page.partition("## Where answers go\n")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| (`.*) \| (.*) \|$", section, re.MULTILINE)
    listed = [(typed.replace("`", ""), about) for typed, about in rows]
    assert listed[1:] == [(one.typed, one.about) for one in OUTPUTS]
    for one in OUTPUTS:
        assert f"{one.typed} ({one.about})" in shown
        assert one.typed in refused


def test_every_output_is_typed_as_its_table_says() -> None:
    for one in OUTPUTS:
        for typed in re.sub(r"\[.*\]", "", one.typed).split(" or "):
            assert output_url(typed).kind == one.kind


@pytest.mark.parametrize(
    "typed",
    [
        "csv:a.csv", "csv:a", "samples:", "samples://a.csv", "answers:", "answers:a.txt",
        "answers:a.jsonl", "jsonl:a.jsonl", "file://a.csv", "udp://", "a.txt", "",
    ],
)  # fmt: skip
def test_what_is_no_output_is_refused_and_not_taken_for_the_name_of_a_file(
    typed: str,
) -> None:
    with pytest.raises(UsageError, match=r"answers:FILE\.csv.*samples:FILE"):
        output_url(typed)


def test_a_csv_of_what_is_asked_with_both_names(run: Run, tmp_path: Path) -> None:
    typed = f"csv:{tmp_path / 'a.csv'}"
    says = "next: answers:FILE.csv: a table of time"
    fails(run, 2, "UsageError", *RUN[3:], "--to", typed, says=says)
    assert "; samples:FILE or FILE.csv: the prepared" in run(*RUN[3:], "--to", typed)[2]
    assert list(tmp_path.iterdir()) == []


def test_a_file_whose_name_has_a_colon_is_a_file() -> None:
    assert output_url("2026-11-28T10:15.csv") == ("samples", "2026-11-28T10:15.csv")


# -- what a run writes


def test_a_run_writes_each_answer_as_one_row_with_the_target_of_its_command(
    run: Run, tmp_path: Path
) -> None:
    source = "virtual://ft232h?scene=falling-bottle"
    table, lines = tmp_path / "table.csv", tmp_path / "lines.jsonl"
    words = ("--grip", "virtual", "--to", f"answers:{table}", "--to", lines)
    code, _, err = run("run", "--source", source, "--seconds", "4", *words)
    assert code == 0, err
    header, *rows = rows_of(table)
    answers = [json.loads(line) for line in lines.read_text("utf-8").splitlines()]
    assert header == HEADER
    assert [row[1:4] for row in rows] == [
        [one["state"], repr(one["p_risky"]), str(int(one["act"]))] for one in answers
    ]
    since_ns = [one["t_acquired_ns"] - answers[0]["t_acquired_ns"] for one in answers]
    assert [round(1e9 * float(row[0])) for row in rows] == since_ns
    targets = [float(row[4]) for row in rows if row[4]]
    # it runs in real time: on a machine that is too busy answers are late, the history has a gap,
    # and the hold is still young when the bottle falls
    if all(one["why"] not in ("late", "rate", "sensors") for one in answers):
        assert 0 < len(targets) < len(rows)
        assert min(targets) > 0.0


def test_a_cell_without_a_value_is_empty(tmp_path: Path) -> None:
    known, unknown = tmp_path / "known.csv", tmp_path / "unknown.csv"
    tighten = GripCommand(7, 0, "tighten", 12.5, 100.0, 0.0, "risk")
    hold = tighten._replace(mode="hold", target_n=None)
    for path, gaps in ((known, ()), (unknown, (SITUATIONS[RISKY_SLIP],))):
        file = AnswerFile(path, gaps)
        for k, command in enumerate((tighten, hold, None)):
            p_risky = (0.75, 0.25, math.nan)[k]
            answer = prediction(p_risky=p_risky, act=k == 0)
            sample = Sample(5 * 10**9 + k, np.zeros(18), np.ones(6, dtype=np.bool_), k)
            file.write(answer, sample, None, command)
        file.close()
    assert rows_of(known) == [
        HEADER,
        ["0.000000000", "grasp", "0.75", "1", "12.5"],
        ["0.000000001", "grasp", "0.25", "0", ""],
        ["0.000000002", "grasp", "", "0", ""],
    ]
    assert [row[2] for row in rows_of(unknown)[1:]] == [""] * 3


def test_samples_have_a_name_of_their_own_and_a_csv_goes_on_being_samples(
    run: Run, tmp_path: Path
) -> None:
    words = ("--to", f"samples:{tmp_path / 'named'}", "--to", tmp_path / "usual.csv")
    assert run(*RUN[3:], "--seconds", "0.2", *words)[0] == 0
    named = (tmp_path / "named").read_text("utf-8")
    assert named.startswith("Time,X1,Y1,Z1,")
    assert named == (tmp_path / "usual.csv").read_text("utf-8")
