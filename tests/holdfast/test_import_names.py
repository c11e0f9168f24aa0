"""`holdfast import`: whose trial a log is, what happens in it, and when."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import Run, imported
from foreign_logs import Made, axes, made, write_log, write_text

from holdfast.interop.names import names_of_paths
from holdfast.interop.proposal import Answers

SLIP = ("--action", "slip")


def names(folder: Path) -> list[str]:
    """The trials of a set, below it."""
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("trial_*.csv"))


def begins(folder: Path) -> list[float]:
    """When it slips in the trials of a set, s."""
    truths = sorted(folder.rglob("*.truth.json"))
    phases = [
        phase for truth in truths for phase in json.loads(truth.read_text())["phases"]
    ]
    return [phase["t0_s"] for phase in phases if phase["label"] == "risky_slip"]


def with_label(folder: Path, name: str, heading: str, words: tuple[str, str]) -> None:
    """A log with a column of labels: a word while it is held or open, and one for the slip."""
    one = made(len(name))
    texts = one.words(words[0], words[0], words[1])
    columns = ["t", *axes(5), heading]
    write_log(folder / f"{name}.csv", one, names=columns, texts=texts)


# -- files of fingers


FINGERS = {
    "a number behind": ("{finger}_{trial}", ("thumb", "index")),
    "glued": ("Trial{trial}{finger}", ("Thumb", "Index")),
    "a folder": ("{finger}/cup_{trial}", ("thumb", "index")),
}


@pytest.mark.parametrize("form", FINGERS)
def test_a_file_of_a_finger_and_a_trial_is_joined_by_its_trial(
    run: Run, tmp_path: Path, form: str
) -> None:
    path, fingers = FINGERS[form]
    for trial in (1, 2):
        for k, finger in enumerate(fingers):
            name = path.format(finger=finger, trial=trial)
            write_log(
                tmp_path / f"logs/slip/{name}.csv", made(10 * trial + k, sensors=1)
            )
    out = imported(run, tmp_path)
    assert "2 trials: 2 slip" in out
    assert "sensors    2, by the axes in their names: " + fingers[0] in out


def test_a_finger_with_more_rows_stands_in_its_place(run: Run, tmp_path: Path) -> None:
    for finger, rows in (("thumb", 490), ("index", 500)):
        one = made(1, sensors=1)
        part = Made(one.t_s[:rows], one.values[:rows])
        write_log(tmp_path / f"logs/slip/{finger}.csv", part)
    out = imported(run, tmp_path)
    assert "thumb.s1_x, thumb.s1_y, thumb.s1_z to index.s1_x" in out


@pytest.mark.parametrize(
    "words", [("s01", "s02"), ("trial_one", "trial_two"), ("rep1", "rep2")]
)
def test_people_and_trials_of_one_sensor_are_no_fingers(
    run: Run, tmp_path: Path, words: tuple[str, str]
) -> None:
    for k, word in enumerate(words):
        write_log(tmp_path / f"logs/{word}/cup_slip.csv", made(k, sensors=1))
    assert "2 trials: 2 slip" in imported(run, tmp_path)


@pytest.mark.parametrize("words", [("F1", "F2"), ("COM3", "COM4")])
def test_numbered_files_of_one_sensor_are_asked_with_the_option_of_fingers(
    run: Run, tmp_path: Path, words: tuple[str, str]
) -> None:
    for trial in (1, 2):
        for k, word in enumerate(words):
            name = f"logs/{word}_cup_slip_{trial}.csv"
            write_log(tmp_path / name, made(10 * trial + k, sensors=1))
    each = ",".join(words)
    assert f"are {each} fingers of one trial?" in imported(run, tmp_path, code=2)
    assert "2 trials: 2 slip" in imported(run, tmp_path, "--fingers", each)


def test_left_and_right_of_one_sensor_are_asked(run: Run, tmp_path: Path) -> None:
    for k, word in enumerate(("left", "right")):
        write_log(tmp_path / f"logs/cup_slip_{word}.csv", made(k, sensors=1))
    out = imported(run, tmp_path, code=2)
    assert "are left,right fingers of one trial?" in out
    assert "2 trials: 2 slip" in imported(run, tmp_path, "--object", "left,right")


@pytest.mark.parametrize("given", [(), ("--fingers", "thumb,index")])
def test_a_finger_without_a_file_is_named(
    run: Run, tmp_path: Path, given: tuple[str, ...]
) -> None:
    for k, name in enumerate(("cup_1/thumb", "cup_1/index", "cup_2/index")):
        write_log(tmp_path / f"logs/slip/{name}.csv", made(k, sensors=1))
    out = imported(run, tmp_path, *given, code=3)
    assert "slip/cup_2 has not one file for each of thumb, index" in out


@pytest.mark.parametrize("words", ["foo,bar", "thumb,index"])
def test_a_file_of_no_finger_is_named(run: Run, tmp_path: Path, words: str) -> None:
    for k, name in enumerate(("thumb", "index", "middle")):
        write_log(tmp_path / f"logs/slip/{name}.csv", made(k, sensors=1))
    out = imported(run, tmp_path, "--fingers", words, code=3)
    assert "has not one file for each of" in out


def test_fingers_that_were_recorded_one_after_the_other_are_no_trial(
    run: Run, tmp_path: Path
) -> None:
    for k, finger in enumerate(("thumb", "index")):
        one = made(k, sensors=1)
        later = Made(one.t_s + 1e3 + 100.0 * k, one.values)
        write_log(tmp_path / f"logs/slip/{finger}.csv", later)
    out = imported(run, tmp_path, code=3)
    assert "thumb, index of slip were not recorded at the same time" in out


# -- people, objects and actions


def test_names_of_any_script_stay_apart(run: Run, tmp_path: Path) -> None:
    for k, person in enumerate(("Jörg", "Jürg", "张伟", "李娜")):
        write_log(tmp_path / f"logs/log{k}.csv", made(k))
        fact = json.dumps({"subject": person, "object": "mug"})
        (tmp_path / f"logs/log{k}.json").write_text(fact, "utf-8")
    assert "people     Jörg, Jürg, 张伟, 李娜" in imported(run, tmp_path, *SLIP)
    assert len(names(tmp_path / "set")) == 4
    code, out, err = run("check", tmp_path / "set")
    assert (code, "4 people" in out) == (0, True), err


def test_what_is_said_of_a_person_or_an_object_is_no_name(
    run: Run, tmp_path: Path
) -> None:
    write_log(tmp_path / "logs/log1.csv", made(1))
    about = {
        "subject_age": 31,
        "subject": "anna",
        "object_mass_g": 200,
        "object_name": "mug",
    }
    (tmp_path / "logs/log1.json").write_text(json.dumps(about))
    out = imported(run, tmp_path, *SLIP)
    assert names(tmp_path / "set") == ["anna/mug/slip/trial_1.csv"]
    assert "not used   subject_age, object_mass_g" in out


def test_a_name_that_one_log_lacks_is_told_and_the_others_keep_theirs(
    run: Run, tmp_path: Path
) -> None:
    for k, about in enumerate(({"subject": "a"}, {"subject": "b", "object": "mug"})):
        write_log(tmp_path / f"logs/log{k}.csv", made(k))
        (tmp_path / f"logs/log{k}.json").write_text(json.dumps(about))
    assert "log0: no column object" in imported(run, tmp_path, *SLIP)
    assert names(tmp_path / "set") == [
        "a/object/slip/trial_1.csv",
        "b/mug/slip/trial_1.csv",
    ]


@pytest.mark.parametrize(
    ("paths", "pattern"),
    [
        (["penny_cup_slip", "spencer_cup_slip"], "*_{object}_{action}"),
        (["slip_up_1", "slip_down_1"], "{action}_*_{trial}"),
        (["cup_slip_1", "nothing_1"], "{object}_{action}_{trial} | {action}_{trial}"),
        (["with_slip_1", "without_slip_1"], "{action}_{trial}"),
        (["open_data/cup_slip"], "open_data/{object}_{action}"),
        (["slip_detection_data/cup_1"], "slip_detection_data/{object}_{trial}"),
        (["p1/tape_slip_1", "p2/foam_slip_1"], "{person}/{object}_{action}_{trial}"),
    ],
)
def test_paths_say_what_their_whole_words_say(paths: list[str], pattern: str) -> None:
    assert names_of_paths(paths, Answers()).path == pattern


def test_a_log_of_the_open_hand_may_be_called_in_another_form(
    run: Run, tmp_path: Path
) -> None:
    write_log(tmp_path / "logs/cup_slip_1.csv", made(1))
    still = made(2)
    write_log(
        tmp_path / "logs/nothing_1.csv",
        still,
        still.values * 0.01,
        names=["t", *axes(5, "s{k}_{axis}")],
    )
    imported(run, tmp_path, "--unit", "N")
    assert names(tmp_path / "set") == ["cup/slip/trial_1.csv", "nothing/trial_1.csv"]


@pytest.mark.parametrize(
    "words",
    [
        ("with_slip", "without_slip"),
        ("gross_slip", "no_slip"),
        ("drop", "no_drop"),
        ("slip", "non_slip"),
    ],
)
def test_a_slip_that_is_none_is_a_hold(
    run: Run, tmp_path: Path, words: tuple[str, str]
) -> None:
    for k, word in enumerate(words):
        write_log(tmp_path / f"logs/{word}/cup_1.csv", made(k))
    imported(run, tmp_path)
    expected = ["cup/hold/trial_1.csv", "cup/slip/trial_1.csv"]
    assert names(tmp_path / "set") == expected


def test_a_word_that_may_be_a_slip_or_none_is_asked_and_answered(
    run: Run, tmp_path: Path
) -> None:
    for k, word in enumerate(("normal", "anti-slip")):
        write_log(tmp_path / f"logs/{word}/cup_1.csv", made(k))
    assert "what happens in these trials?" in imported(run, tmp_path, code=2)
    out = imported(run, tmp_path, "--action", "normal=slip,anti-slip=hold")
    assert "2 trials: 1 hold, 1 slip" in out


def test_a_word_that_is_answered_and_stands_nowhere_is_told(
    run: Run, tmp_path: Path
) -> None:
    write_log(tmp_path / "logs/cup_slip_1.csv", made(1))
    out = imported(run, tmp_path, "--action", "slip=slip,torn=pull", code=2)
    assert "'torn' stands nowhere in these logs" in out


def test_a_label_with_a_sign_of_equality_is_answered(run: Run, tmp_path: Path) -> None:
    with_label(tmp_path / "logs", "cup_1", "label", ("slip=false", "slip=true"))
    imported(run, tmp_path, "--action", "slip=false=,slip=true=slip")
    assert begins(tmp_path / "set") == [3.0]


@pytest.mark.parametrize("answer", ["rutsch", "noslip=bla"])
def test_an_answer_that_is_no_action_is_refused(
    run: Run, tmp_path: Path, answer: str
) -> None:
    write_log(tmp_path / "logs/a.csv", made(1))
    out = imported(run, tmp_path, "--action", answer, code=2)
    assert "error: UsageError: --action" in out
    assert "one of pass, put-down" in out


def test_a_word_that_means_nothing_happens_is_answered_so(
    run: Run, tmp_path: Path
) -> None:
    write_log(tmp_path / "logs/release_slip_1.csv", made(1))
    assert "which of release, slip happens?" in imported(run, tmp_path, code=2)
    assert "1 trial: 1 slip" in imported(run, tmp_path, "--action", "release=")


def test_what_a_column_says_of_a_trial_is_told_beside_what_its_path_says(
    run: Run, tmp_path: Path
) -> None:
    one = made(1)
    rows = np.column_stack([one.t_s, one.values, np.full(len(one.t_s), 9)])
    write_text(tmp_path / "logs/cup_slip_1.csv", ["t", *axes(5), "item_id"], rows)
    assert "names      object: cup; taken is column item_id: 9" in imported(
        run, tmp_path
    )
    assert names(tmp_path / "set") == ["9/slip/trial_1.csv"]


@pytest.mark.parametrize("heading", ["trial_phase", "recording", "run_speed"])
def test_a_column_whose_values_come_again_is_no_number_of_a_trial(
    run: Run, tmp_path: Path, heading: str
) -> None:
    one = made(1)
    rows = np.column_stack([one.t_s, one.values, (one.t_s > 1.0) & (one.t_s < 4.0)])
    write_text(tmp_path / "logs/cup_slip_1.csv", ["t", *axes(5), heading], rows)
    out = imported(run, tmp_path, "--action", "slip,0=,1=")
    assert "1 trial: 1 slip" in out


def test_an_outcome_of_codes_is_asked_by_its_column_and_answered(
    run: Run, tmp_path: Path
) -> None:
    for k in (0, 1):
        one = made(k)
        rows = np.column_stack([one.t_s, one.values, np.full(len(one.t_s), k)])
        write_text(tmp_path / f"logs/cup_{k}.csv", ["t", *axes(5), "success"], rows)
    assert "what is '0', '1' in column success?" in imported(run, tmp_path, code=2)
    out = imported(run, tmp_path, "--action", "0=slip,1=hold")
    assert "2 trials: 1 slip, 1 hold" in out
    assert "cup/slip/trial_1.csv" in names(tmp_path / "set")


# -- labels


def test_codes_of_labels_are_no_words_of_paths(run: Run, tmp_path: Path) -> None:
    for k, slips in ((1, True), (2, False)):
        one = made(k)
        codes = np.array(one.words("0", "1", "2" if slips else "1"), float)
        rows = np.column_stack([one.t_s, one.values, codes])
        write_text(tmp_path / f"logs/cup_{k}.csv", ["t", *axes(5), "phase"], rows)
    out = imported(run, tmp_path, "--action", "0=nothing,1=hold,2=slip")
    assert "2 trials: 1 slip, 1 hold" in out
    assert begins(tmp_path / "set") == [3.0]


@pytest.mark.parametrize("words", [("slip_0", "slip_1"), ("slip: 0", "slip: 1")])
def test_words_that_differ_in_a_zero_are_asked(
    run: Run, tmp_path: Path, words: tuple[str, str]
) -> None:
    with_label(tmp_path / "logs", "cup_1", "label", words)
    assert f"what is {words[0]!r}, {words[1]!r}" in imported(run, tmp_path, code=2)


def test_two_columns_of_labels_that_differ_are_asked_and_chosen(
    run: Run, tmp_path: Path
) -> None:
    one = made(1)
    seen = (one.t_s >= 3.2) & (one.t_s < 3.7)
    true = (one.t_s >= 3.0) & (one.t_s < 3.5)
    rows = np.column_stack([one.t_s, one.values, seen, true])
    write_text(tmp_path / "logs/cup_1.csv", ["t", *axes(5), "slip_flag", "slip"], rows)
    out = imported(run, tmp_path, code=2)
    assert "slip_flag, slip say when it slips, and differ: which is true?" in out
    imported(run, tmp_path, "--labels", "slip")
    assert begins(tmp_path / "set") == [3.0]


def test_labels_that_say_no_slip_of_a_trial_that_is_called_so_are_doubted(
    run: Run, tmp_path: Path
) -> None:
    with_label(tmp_path / "logs", "cup_slip_1", "gripper", ("open", "closed"))
    out = imported(run, tmp_path, "--action", "closed=hold")
    assert "DOUBTFUL: its name says slip, its labels say no slip" in out


def test_a_hand_that_is_open_and_called_a_grasp_is_doubted(
    run: Run, tmp_path: Path
) -> None:
    with_label(tmp_path / "logs", "cup_1", "state", ("stable", "slip"))
    out = imported(run, tmp_path)
    assert "is called grasp from its first row on, and presses only later" in out


@pytest.mark.parametrize("topic", ["words", "codes"])
def test_labels_in_rows_of_their_own_hold_to_the_next(
    run: Run, tmp_path: Path, topic: str
) -> None:
    one = made(1)
    rows = [
        (t, [f"{v:g}" for v in values] + [""])
        for t, values in zip(one.t_s, one.values, strict=True)
    ]
    marks = {"words": ("grasp", "slip", "grasp"), "codes": ("0", "1", "0")}[topic]
    for t_s, mark in zip((0.001, 2.995, 3.495), marks, strict=True):
        rows.append((t_s, [""] * 15 + [mark]))
    lines = [",".join([f"{t:.3f}", *cells]) for t, cells in sorted(rows)]
    head = ",".join(["t", *axes(5), "slip"])
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs/cup_1.csv").write_text("\n".join([head, *lines]) + "\n")
    imported(run, tmp_path)
    assert begins(tmp_path / "set") == [3.0]


# -- tables of events


def write_events(tmp_path: Path, text: str, first_s: float = 0.0) -> None:
    """Two logs, from a stamp on, and a table of events beside each."""
    for k in (1, 2):
        one = made(k)
        write_log(
            tmp_path / f"logs/trial_{k}_force.csv", Made(one.t_s + first_s, one.values)
        )
        (tmp_path / f"logs/trial_{k}_events.csv").write_text(text)


TABLES = {
    "an end in another unit": "start_s,end_ms,label\n1,3000,grasp\n3,3500,slip\n",
    "a length in another unit": "onset_s,duration_ms,label\n1,2000,grasp\n3,500,slip\n",
    "samples before seconds": "sample,onset,duration,label\n1000,1,2,grasp\n3000,3,0.5,slip\n",
    "times of all that happens": "grasp_time,slip_time,release_time\n1,3,4\n",
    "begin and end of all": "grasp_start,grasp_end,slip_start,slip_end\n1,4,3,3.5\n",
    "samples": "onset_samples,duration_samples,label\n100,200,grasp\n300,50,slip\n",
}


@pytest.mark.parametrize("form", TABLES)
def test_a_table_of_events_is_read_by_what_its_headings_say(
    run: Run, tmp_path: Path, form: str
) -> None:
    write_events(tmp_path, TABLES[form])
    imported(run, tmp_path)
    assert begins(tmp_path / "set") == [3.0, 3.0]


def test_times_that_fit_from_the_begin_and_by_the_clock_are_asked(
    run: Run, tmp_path: Path
) -> None:
    write_events(
        tmp_path, "onset,label\n3.1,grasp\n4.5,slip\n4.8,nothing\n", first_s=2.0
    )
    out = imported(run, tmp_path, code=2)
    assert (
        "lies in the logs in s, both from their begin and from 0 of their clock" in out
    )


def test_two_columns_of_times_are_asked(run: Run, tmp_path: Path) -> None:
    write_events(tmp_path, "video_time_s,log_time_s,label\n1.5,1,grasp\n3.5,3,slip\n")
    out = imported(run, tmp_path, code=2)
    assert "video_time_s, log_time_s of *events*.csv may be when it begins" in out


def test_events_in_minutes_are_no_table_of_ours(run: Run, tmp_path: Path) -> None:
    write_events(tmp_path, "start_min,end_min,label\n0.05,0.058,slip\n")
    out = imported(run, tmp_path, code=2)
    assert "not used   *events*.csv (columns start_min, end_min, label)" in out


def test_a_number_of_a_trial_that_is_that_of_two_logs_is_asked(
    run: Run, tmp_path: Path
) -> None:
    for k, person in enumerate(("s1", "s2")):
        write_log(tmp_path / f"logs/{person}/trial_1.csv", made(k))
    (tmp_path / "logs/events.csv").write_text("trial,start,end,label\n1,3,3.5,slip\n")
    out = imported(run, tmp_path, code=2)
    assert "trial '1' of events.csv is s1/trial_1, s2/trial_1" in out


def test_a_table_in_each_folder_is_of_the_logs_there(run: Run, tmp_path: Path) -> None:
    for folder, numbers in (("s1", (1, 2)), ("s2", (2, 1))):
        for k in (1, 2):
            write_log(tmp_path / f"logs/{folder}/trial_{k}.csv", made(len(folder) + k))
        slips = "".join(f"{n},{2 + n / 2},4,slip\n" for n in numbers)
        (tmp_path / f"logs/{folder}/events.csv").write_text(
            f"trial,start,end,label\n{slips}"
        )
    imported(run, tmp_path)
    assert begins(tmp_path / "set") == [2.5, 3.0, 2.5, 3.0]
    imported(run, tmp_path, "--map", tmp_path / "set/import.toml", out="again")
    assert begins(tmp_path / "again") == [2.5, 3.0, 2.5, 3.0]


def test_two_tables_that_say_when_it_slips_are_asked(run: Run, tmp_path: Path) -> None:
    write_events(tmp_path, "start,end,label\n1,3,grasp\n3,3.5,slip\n")
    all_of_them = (
        "trial,start,end,label\ntrial_1_force,1,4,grasp\ntrial_2_force,4,4.5,slip\n"
    )
    (tmp_path / "logs/all.csv").write_text(all_of_them)
    out = imported(run, tmp_path, code=2)
    assert "all.csv, *events*.csv say when it slips, and differ" in out
    imported(run, tmp_path, "--labels", "*events*.csv")
    assert begins(tmp_path / "set") == [3.0, 3.0]


# -- JSON beside a log


FACTS = {
    "the length of the recording": {"drop_time_s": 3.0, "duration_s": 5.0},
    "the length of the object": {"drop_time_s": 3.0, "object_length_mm": 90},
    "a stamp first": {"timestamp": 1.7e9, "start_time": 0.0, "drop_time_s": 3.0},
    "its rate first": {"sample_rate_hz": 100, "drop_time_s": 3.0},
    "other times": {"grasp_time": 1.0, "slip_time": 3.0, "release_time": 4.0},
}


@pytest.mark.parametrize("form", FACTS)
def test_of_the_facts_of_a_trial_the_time_of_the_slip_is_taken(
    run: Run, tmp_path: Path, form: str
) -> None:
    write_log(tmp_path / "logs/a.csv", made(1))
    (tmp_path / "logs/a.json").write_text(json.dumps(FACTS[form]))
    assert "1 trial: 1 slip" in imported(run, tmp_path)
    (phase,) = [path for path in (tmp_path / "set").rglob("*.truth.json")]
    slip = json.loads(phase.read_text())["phases"][-1]
    # it lasts to the end of the contact, at 4 s
    assert (slip["t0_s"], slip["t1_s"]) == (3.0, pytest.approx(4.0, abs=0.1))


@pytest.mark.parametrize(
    "none", [{}, {"drop_time_s": 0}, {"drop_time_s": -1}, {"drop_time_s": None}]
)
def test_a_trial_without_a_time_of_the_drop_is_one_in_which_nothing_falls(
    run: Run, tmp_path: Path, none: dict[str, object]
) -> None:
    for k, about in ((1, {"drop_time_s": 3.0}), (2, none)):
        write_log(tmp_path / f"logs/log{k}.csv", made(k))
        (tmp_path / f"logs/log{k}.json").write_text(
            json.dumps({"object": "mug", **about})
        )
    assert "2 trials: 1 slip, 1 hold" in imported(run, tmp_path)


def test_an_object_beside_no_log_is_named(run: Run, tmp_path: Path) -> None:
    write_log(tmp_path / "logs/a.csv", made(1))
    write_log(tmp_path / "logs/b.csv", made(2))
    about = json.dumps({"name": "a study", "year": 2026})
    (tmp_path / "logs/dataset_description.json").write_text(about)
    assert "not used   dataset_description.json" in imported(run, tmp_path, *SLIP)


# -- readings


def test_the_same_readings_in_two_logs_are_named(run: Run, tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_log(tmp_path / f"logs/{name}.csv", made(1))
    out = imported(run, tmp_path, *SLIP)
    assert "b: the same readings as a: keep one of them" in out


def test_readings_that_stay_for_an_uneven_number_of_rows_are_named(
    run: Run, tmp_path: Path
) -> None:
    one = made(1)
    steps = np.random.default_rng(0).integers(2, 5, len(one.t_s))
    rows = np.repeat(np.cumsum(steps) - steps[0], steps)[: len(one.t_s)]
    write_log(tmp_path / "logs/a.csv", one, one.values[np.minimum(rows, 499)])
    assert "slower than the log" in imported(run, tmp_path, *SLIP)
