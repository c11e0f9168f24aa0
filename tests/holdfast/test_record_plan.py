"""Who is recorded, where, and what comes next: pseudonyms, folders, cards, and words that do not go
together."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest
from recorder_bench import PROTOCOL, REST, meta_of, one_pull, recorded, said

from holdfast.cli.main import main
from holdfast.core.errors import (
    CardError,
    DataError,
    DataNotFound,
    OutputError,
    UnitError,
    UsageError,
)
from holdfast.data.datasets import trials
from holdfast.sessions.recorder.folder import recording_folder
from holdfast.sessions.recorder.plan import ACTIONS, Task, read_protocol, tasks_left
from holdfast.simulation import actions as simulated


@pytest.fixture
def two_objects(tmp_path: Path) -> Path:
    path = tmp_path / "two.toml"
    path.write_text(PROTOCOL)
    return path


NAMES = [
    "Anna Müller",
    "a@b.org",
    "",
    "p_01",
    "../p01",
    "nothing",
    "discarded",
    "p-",
    "x" * 25,
]


@pytest.mark.parametrize("name", NAMES)
def test_a_pseudonym_is_a_short_word_and_nothing_else(tmp_path, name):
    with pytest.raises(UsageError, match="pseudonym"):
        one_pull(tmp_path / "out", person=name)
    assert not (tmp_path / "out").exists()


def test_a_folder_that_is_no_recording_is_left_alone(tmp_path):
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos/summer.txt").write_text("sun")
    with pytest.raises(OutputError, match="not a recording folder"):
        one_pull(tmp_path / "photos")
    assert [path.name for path in (tmp_path / "photos").rglob("*")] == ["summer.txt"]
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="not a recording folder"):
        one_pull(tmp_path / "file")


def test_a_person_is_never_recorded_into_a_second_folder_within_the_recordings(
    tmp_path,
):
    one_pull(tmp_path / "out")
    for within in ("out/p02", "out/p01/soft-ball", "out/p01/new/newer"):
        with pytest.raises(OutputError, match=r"within a recording folder.*--out"):
            one_pull(tmp_path / within)
    assert [path.parent.name for path in tmp_path.rglob("tactile.csv")] == ["trial_1"]
    one_pull(tmp_path / "out2")


def test_two_recorders_do_not_share_a_folder(tmp_path):
    one_pull(tmp_path / "out")
    with recording_folder(tmp_path / "out", "N", "simulated"):
        with pytest.raises(OutputError, match="another recorder"):
            one_pull(tmp_path / "out")
        assert main(["check", "--repair", str(tmp_path / "out/p01")]) == 5, (
            "a file that is being written is not repaired"
        )
    assert main(["check", "--repair", str(tmp_path / "out/p01")]) == 0


def test_units_and_what_is_simulated_are_not_mixed_in_a_folder(tmp_path):
    one_pull(tmp_path / "out")
    with (
        pytest.raises(UnitError),
        recording_folder(tmp_path / "out", "uT", "simulated"),
    ):
        pass
    with pytest.raises(UnitError), recording_folder(tmp_path / "out", "N", "recorded"):
        pass


def test_a_bad_bias_is_refused_without_anyway(tmp_path):
    touched = f"{REST}?fault=nack:2@0%2B99"
    with pytest.raises(DataError, match=r"X2|rows"):
        one_pull(tmp_path / "out", source=touched)
    assert not list((tmp_path / "out").rglob("tactile.csv"))
    late = f"{REST}?fault=nack:2@0.4%2B0.3"
    with pytest.raises(DataError, match="the bias is not good"):
        one_pull(tmp_path / "out", source=late)
    messages = one_pull(tmp_path / "out", "--anyway", source=late)
    assert said(messages, "lost in X2")
    assert meta_of(tmp_path / "out/p01/soft-ball/pull/trial_1")["bias"]["good"] is False


def test_a_protocol_says_what_comes_next_and_each_person_has_an_order_of_their_own(
    two_objects,
):
    protocol = read_protocol(two_objects)
    first = protocol.ordered(1, "p01")
    other = protocol.ordered(1, "p02")
    assert first == protocol.ordered(1, "p01") != other
    assert Counter(first) == Counter(other) == Counter(protocol.tasks)
    assert len(first) == 8
    assert protocol.ordered(2, "p01") != first
    assert tasks_left(first, first[:3]) == first[3:]


def test_a_run_goes_on_where_the_last_one_stopped(tmp_path, two_objects):
    words = ("--protocol", two_objects, "--seconds", "0.5")
    recorded(tmp_path / "out", *words, "--trials", "3")
    messages = recorded(tmp_path / "out", *words)
    assert said(messages, "3 of these trials are recorded already")
    assert len(list((tmp_path / "out").rglob("tactile.csv"))) == 8
    assert (
        recorded(tmp_path / "out", *words)[-1]
        == "measuring the bias: leave the hand open, touch nothing for 1 s"
    )
    plan = read_protocol(two_objects).ordered(0, "p01")
    trials = (tmp_path / "out").rglob("trial_*/meta.json")
    by_start = sorted(trials, key=lambda path: path.stat().st_mtime_ns)
    metas = [meta_of(path.parent) for path in by_start]
    done = [Task(meta["object"], meta["action"], meta["style"]) for meta in metas]
    assert done == plan
    assert meta_of(tmp_path / "out/p01/my-cup") == {"mass_g": 212}


def test_actions_are_those_of_scenes_and_of_training():
    # A slip says nothing but that the object slipped; a scene says how.
    assert set(ACTIONS) - {"slip"} == set(simulated.ACTION_MODULES)
    assert set(ACTIONS) - {"nothing"} <= set(trials.FOLDERS)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[[trials", "not valid TOML"),
        ("", "trials is missing"),
        ("[[trials]]\naction = 'fly'\nobjects = ['a']", "action = 'fly'"),
        ("[[trials]]\naction = 'pull'", "objects = []"),
        ("[[trials]]\naction = 'nothing'\nobjects = ['a']", "objects = ['a']"),
        ("[[trials]]\naction = 'pull'\nobjects = ['../a']", "'../a'"),
        (
            "[[trials]]\naction = 'pull'\nobjects = ['a']\n[objects.a]\nmass_g = 0",
            "objects.a.mass_g = 0",
        ),
    ],
)
def test_a_card_that_cannot_be_is_refused_by_its_key(tmp_path, text, says):
    (tmp_path / "bad.toml").write_text(text)
    with pytest.raises(CardError, match=re.escape(says)):
        read_protocol(tmp_path / "bad.toml")
    with pytest.raises(DataNotFound):
        read_protocol(tmp_path / "absent.toml")
