"""A study with one person: its steps and keys, what is written, and how it goes on after an end."""

from __future__ import annotations

import json
import os
import pty
import shutil
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from command_line import Run, fails
from hazard_marks import ADVERSE_EVENT, CUT_OFF_STUDY, WITHDRAWAL
from recorder_bench import (
    meta_of,
    on_terminal,
    said,
    start,
    wait_for,
    wait_on_terminal_for,
)
from study_bench import TALK, TRIALS, Study

from holdfast.core.errors import LabelError, OutputError, UsageError
from holdfast.sessions.recorder.folder import program_lock
from holdfast.sessions.study import journal as journals
from holdfast.sessions.study.journal import (
    Event,
    Journal,
    Progress,
    progress_of,
    read_journal,
    withdraw,
)
from holdfast.sessions.study.run import Ending

WHOLE_TALK = "   "


@pytest.fixture
def talk(tmp_path: Path) -> Study:
    return Study(tmp_path)


@pytest.fixture
def scene(tmp_path: Path, card: Path) -> Study:
    """Two objects, each trial of the short scene that fits."""
    return Study(tmp_path, TRIALS, f"sim://{card}")


def progress(study: Study) -> Progress:
    """Where a journal leaves its study."""
    return progress_of(read_journal(study.home / "study.jsonl"))


class Kill(BaseException):
    """Ends the program where it is raised, as a power cut would."""


def run_killed(
    study: Study, ends: Callable[[Journal, Event], bool], typed: str
) -> None:
    """A run that is killed right after a line of the journal."""
    append = Journal.append

    def cut(journal: Journal, event: Event, **more: object) -> object:
        entry = append(journal, event, **more)
        if ends(journal, event):
            raise Kill
        return entry

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Journal, "append", cut)
        with pytest.raises(Kill):
            study.run(typed, pause_s=1.0)


# -- the steps


def test_a_study_goes_from_step_to_step_and_ends(talk: Study) -> None:
    assert talk.run(WHOLE_TALK, pause_s=1.0) == Ending.FINISHED
    assert talk.done() == [0, 1, 2]
    entries = talk.entries()
    assert (entries[0]["event"], entries[-1]["event"]) == ("opened", "finished")
    assert (talk.home / "protocol.toml").read_text() == TALK
    assert said(talk.messages, "step 1 of 2, Welcome")
    times = [entry["t_s"] for entry in entries]
    assert times == sorted(times)
    assert times[1:5] == [0.0, 1.0, 1.0, 2.0]
    assert all(entry["at"].endswith("Z") for entry in entries)

    assert talk.run("q") == Ending.FINISHED
    assert said(talk.messages, "every step of this person's study is done")
    assert talk.done() == [0, 1, 2]


def test_skip_repeat_and_note_are_entries_and_time_is_counted_by_part(
    talk: Study,
) -> None:
    talk.run("s" + "nlate bus\n" + "r" + " " + " q", pause_s=1.0)
    lines = [f"{entry['event']} {entry.get('part')}" for entry in talk.entries()]
    assert ", ".join(lines) == (
        "opened None, begun 0, skipped 0, begun 1, note 1, back 1, begun 0, done 0, "
        "begun 1, done 1, begun 2, quit 2"
    )
    assert talk.entries("note")[0]["text"] == "late bus"
    assert said(talk.messages, "no names")
    spent_s = progress(talk).spent_s
    assert spent_s == {0: 1.0 + 1.0, 1: 11.0 + 1.0, 2: 1.0}


# -- where it goes on


@CUT_OFF_STUDY.mark
def test_a_study_that_is_killed_after_any_line_goes_on_and_ends_the_same(
    tmp_path: Path,
) -> None:
    whole = Study(tmp_path / "whole")
    whole.run(WHOLE_TALK)
    wanted = progress(whole)
    for last in range(1, len(whole.entries()) + 1):

        def ends(journal: Journal, event: Event, last: int = last) -> bool:
            return len(journal.entries) == last

        study = Study(tmp_path / str(last))
        run_killed(study, ends, WHOLE_TALK)
        left = progress(study)
        typed = " " * (3 - min(left.part, 3))
        assert study.run(typed) == Ending.FINISHED, last
        found = progress(study)
        assert found.part == wanted.part, last
        assert found.runs == 2


@CUT_OFF_STUDY.mark
def test_a_line_that_was_torn_is_moved_aside_and_its_step_is_done_again(
    talk: Study,
) -> None:
    talk.run(" q")
    journal = talk.home / "study.jsonl"
    journal.write_bytes(journal.read_bytes()[:-25])
    assert talk.run("  ") == Ending.FINISHED
    assert (talk.home / "study.jsonl.torn").exists()
    assert talk.done() == [0, 1, 2]


@pytest.mark.parametrize(
    "line",
    [
        "[]",
        '{"event": "begun"}',
        '{"event": "done", "t_s": "x", "at": "2026"}',
    ],
)
def test_a_journal_that_cannot_be_read_is_named_with_its_file(
    talk: Study, line: str
) -> None:
    talk.run(" q")
    journal = talk.home / "study.jsonl"
    journal.write_text(journal.read_text() + line + "\n")
    with pytest.raises(LabelError, match=r"study\.jsonl"):
        talk.run(" ")


@CUT_OFF_STUDY.mark
def test_a_second_study_in_the_folder_is_refused_until_the_first_ends_even_by_a_kill(
    talk: Study,
) -> None:
    master, slave = pty.openpty()
    with on_terminal(slave, *program(talk), verb="study") as first:
        wait_on_terminal_for(master, "step 1 of 2, Welcome")
        # Another person, so the journal is free: the folder itself is taken.
        second = Study(talk.path.parent)
        second.args.person = "p02"
        second.home = second.out / "p02"
        with pytest.raises(OutputError, match="another recorder or study is using it"):
            second.run(WHOLE_TALK)
        assert not said(second.messages, "the hand answers")
        assert not second.home.exists()
        first.kill()
    os.close(master)
    assert second.run(WHOLE_TALK) == Ending.FINISHED


@CUT_OFF_STUDY.mark
def test_a_full_disk_ends_the_study_with_an_error_and_loses_no_earlier_line(
    talk: Study, monkeypatch: pytest.MonkeyPatch
) -> None:
    def half_a_line(handle: int, line: bytes) -> int:
        return os.pwrite(handle, line[:9], 0) * 0

    refused = r"study\.jsonl: cannot write \(No space left"
    with monkeypatch.context() as patched:
        patched.setattr(journals.os, "write", half_a_line)
        with pytest.raises(OutputError, match=refused):
            talk.run(" ")
    assert talk.run(WHOLE_TALK) == Ending.FINISHED


# -- trials


def test_a_recording_step_records_its_repetitions_with_the_recorder(
    scene: Study,
) -> None:
    assert scene.run(" " * 20) == Ending.FINISHED
    assert set(scene.states().values()) == {"kept"}
    assert list(scene.states()) == [
        f"{place}/trial_{n}"
        for place in ("hard-ball/fall", "soft-ball/pass", "soft-ball/pull")
        for n in (1, 2)
    ]
    meta = meta_of(scene.home / "hard-ball/fall/trial_2")
    assert meta["protocol"]["card"] == "protocol"
    assert meta["protocol"]["sha256"] == scene.protocol.sha256
    assert meta["person"] == "p01"
    assert said(scene.messages, "hand over: soft ball")
    assert said(scene.messages, "repetition 2 of 2: space begins it")


@ADVERSE_EVENT.mark
def test_an_adverse_event_stops_the_trial_at_once_and_is_written_before_it_is_described(
    scene: Study,
) -> None:
    typed = "  " + " " + "fell on a foot\n" + "9\n2\n" + "y\n" + " q"
    scene.run(typed, in_trials={30: "a"})
    event, detail = scene.entries("adverse", "adverse_detail")
    assert (event["part"], event["step"]) == (2, 3)
    assert (detail["text"], detail["severity"]) == ("fell on a foot", "moderate")
    assert scene.states() == {
        "soft-ball/pass/trial_1": "interrupted",
        "soft-ball/pass/trial_2": "kept",
    }
    meta = meta_of(scene.home / "soft-ball/pass/trial_1")
    assert meta["quality"]["samples"] == 30


@ADVERSE_EVENT.mark
def test_after_an_adverse_event_the_study_ends_unless_the_operator_goes_on(
    scene: Study,
) -> None:
    assert scene.run("a" + "faint\n3\nn\n") == Ending.QUIT
    assert scene.entries("adverse_detail")[0]["severity"] == "severe"
    assert scene.run("a") == Ending.QUIT, (
        "the terminal is gone before anything is described"
    )
    assert len(scene.entries("adverse")) == 2


@CUT_OFF_STUDY.mark
@pytest.mark.parametrize("line", ["adverse", "adverse_detail"])
def test_an_adverse_event_that_a_kill_cut_off_is_asked_about_again(
    talk: Study, line: str
) -> None:
    run_killed(talk, lambda _, event: event == line, "afell\n2\n")
    # described, and the study does not go on; the next run asks nothing more
    talk.run("slipped\n3\nn\n")
    details = talk.entries("adverse_detail")
    assert (details[-1]["text"], details[-1]["severity"]) == ("slipped", "severe")
    assert talk.entries()[-1]["event"] == "quit"
    asked = len(details)
    talk.run("q")
    assert len(talk.entries("adverse_detail")) == asked
    assert len(talk.entries("adverse")) == 1


def test_a_trial_that_is_killed_is_marked_and_recorded_again(scene: Study) -> None:
    def cut(trial: object, measured: object, now_ns: int) -> None:
        if trial.quality.times_ns[40:]:  # type: ignore[attr-defined]
            raise Kill

    with pytest.raises(Kill):
        scene.run("   ", show=cut)
    trial = scene.home / "soft-ball/pass/trial_1"
    meta = meta_of(trial)
    (trial / "meta.json").write_text(json.dumps(meta | {"state": "recording"}))
    with (trial / "tactile.csv").open("ab") as torn:
        torn.write(b"0.8,0.1,")
    scene.run("  " + " q")
    assert said(scene.messages, "marked as interrupted")
    states = scene.states()
    assert states.pop("soft-ball/pass/trial_1") == "interrupted"
    assert list(states.values()) == ["kept", "kept"]
    assert scene.done() == [0, 1, 2]


# -- withdrawal


@WITHDRAWAL.mark
def test_withdrawing_deletes_everything_of_the_person_and_says_each_file(
    scene: Study,
) -> None:
    scene.run("  " + "  " + "nsecret\n" + " q")
    other = shutil.copytree(scene.home, scene.out / "p02")
    files = [path for path in scene.home.rglob("*") if path.is_file()]
    withdraw(scene.out, "p01", scene.messages.append)
    assert not scene.home.exists()
    assert other.is_dir()
    for path in files:
        assert said(scene.messages, f"deleted {path.relative_to(scene.out)}")
    assert said(scene.messages, "copies and backups")
    text = (scene.out / "withdrawn.jsonl").read_text()
    begun, done = map(json.loads, text.splitlines())
    assert (begun["state"], done["state"], done["person"]) == ("begun", "done", "p01")
    names = sorted(str(path.relative_to(scene.out)) for path in files)
    assert (begun["files"], done["files"]) == (names, []), "what is left at its end"
    assert "secret" not in text
    with pytest.raises(UsageError, match=r"has withdrawn.*new"):
        scene.run(" ")


@WITHDRAWAL.mark
def test_a_file_that_cannot_be_deleted_is_named_and_the_rest_is_deleted(
    talk: Study, monkeypatch: pytest.MonkeyPatch
) -> None:
    talk.run(" q")
    (talk.home / "stuck.txt").write_text("x")
    unlink = os.unlink

    def refused(path: str, **at: int) -> None:
        if Path(path).name == "stuck.txt":
            raise PermissionError(1, "Operation not permitted")
        unlink(path, **at)

    with monkeypatch.context() as patched:
        patched.setattr(os, "unlink", refused)
        with pytest.raises(
            OutputError, match=r"stuck\.txt: cannot be deleted; 1 left of 3 files"
        ):
            withdraw(talk.out, "p01", talk.messages.append)
    assert said(talk.messages, "not deleted: p01/stuck.txt")
    assert [path.name for path in talk.home.iterdir()] == ["stuck.txt"]
    with pytest.raises(UsageError, match=r"has withdrawn.*--withdraw"):
        talk.run(" ")
    withdraw(talk.out, "p01", talk.messages.append)
    assert not talk.home.exists()
    with pytest.raises(
        UsageError, match=r"has withdrawn; next: give a pseudonym that is new"
    ):
        talk.run(" ")


@WITHDRAWAL.mark
def test_a_person_is_deleted_by_the_pseudonym_and_not_while_their_study_runs(
    talk: Study,
) -> None:
    talk.run(" q")
    reading, writing = os.pipe()
    os.write(writing, b"p01\np02\np01\n")
    words = (talk.path, "--out", talk.out, "--person", "p01", "--withdraw")
    with program_lock(talk.out), start(*words, verb="study", stdin=reading) as run:
        _, err = run.communicate(timeout=300)
    assert (run.returncode, "another recorder or study" in err) == (5, True)
    with start(*words, verb="study", stdin=reading) as run:
        _, err = run.communicate(timeout=300)
    assert (run.returncode, "nothing is deleted" in err) == (1, True)
    assert talk.done() == [0]
    with start(*words, verb="study", stdin=reading) as run:
        _, err = run.communicate(timeout=300)
    assert (run.returncode, talk.home.exists()) == (0, False)
    assert "p01 has withdrawn" in err
    os.close(reading)
    os.close(writing)


# -- the program


@CUT_OFF_STUDY.mark
def test_a_program_that_is_killed_goes_on_in_the_step_it_was_in(talk: Study) -> None:
    reading, writing = os.pipe()
    with start(*program(talk), verb="study", stdin=reading) as run:
        os.write(writing, b" ")
        wait_for(run, "step 1 of 2, Questions")
        run.kill()
        run.communicate(timeout=300)
    with start(*program(talk), verb="study", stdin=reading) as run:
        wait_for(run, "step 1 of 2, Questions")
        os.write(writing, b"q")
        run.communicate(timeout=300)
    assert run.returncode == 0
    os.close(reading)
    os.close(writing)


def test_ctrl_c_ends_a_study_with_130_and_it_goes_on_later(talk: Study) -> None:
    reading, writing = os.pipe()
    with start(*program(talk), verb="study", stdin=reading) as run:
        wait_for(run, "step 1 of 2, Welcome")
        run.send_signal(signal.SIGINT)
        run.communicate(timeout=300)
    assert run.returncode == 130
    assert talk.entries()[-1]["event"] == "quit"
    os.close(reading)
    os.close(writing)


def program(study: Study) -> list[object]:
    """What the program is given for that study."""
    words = "--source virtual://ft232h --person p01"
    return [study.path, "--out", study.out, *words.split()]


@CUT_OFF_STUDY.mark
def test_a_terminal_that_goes_away_leaves_a_study_that_goes_on(talk: Study) -> None:
    master, slave = pty.openpty()
    with on_terminal(slave, *program(talk), verb="study") as run:
        wait_on_terminal_for(master, "step 1 of 2, Welcome")
        os.write(master, b" ")
        wait_on_terminal_for(master, "step 1 of 2, Questions")
        os.close(master)
        assert run.wait(timeout=300) == 0
    assert talk.entries()[-1]["event"] == "quit"
    assert talk.run("  ") == Ending.FINISHED


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("--out o --person p01", "--source is missing"),
        ("--out o --person p01 --source sim://p1 --camera oak", "--tag-mm"),
        ("--out o --person p01 --source sim://p1", "no key can be pressed"),
    ],
)
def test_words_that_do_not_go_together_are_refused_before_anything_opens(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: str, says: str
) -> None:
    monkeypatch.chdir(tmp_path)
    given = ("study", "thesis", *words.split())
    with open(os.devnull) as at_its_end:
        monkeypatch.setattr(sys, "stdin", at_its_end)
        fails(run, 2, "UsageError", *given, says=says)
    assert list(tmp_path.iterdir()) == []
