"""The command line, end to end: every bad input is one line, one exit code, and nothing
half-written."""

from __future__ import annotations

import io
import json
import os
import pickle
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import skops.io
from command_line import Run, fails
from own_data import write_phases
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer
from small_model import Trap

from holdfast.cli.command import Parser, finish
from holdfast.cli.main import START, VERBS, functions_of, main
from holdfast.core.errors import ArtifactError, OutputError
from holdfast.data.fixture import write_fixture
from holdfast.step.artifact import read_artifact, write_artifact

if TYPE_CHECKING:
    from conftest import Built

ROOT = Path(__file__).resolve().parents[2]
TRIAL = "empty-bottle/pull/trial_1.csv"


def everything_in(folder: Path) -> dict[str, bytes | None]:
    """Every file and folder below, with what is in it."""
    return {
        str(p.relative_to(folder)): p.read_bytes() if p.is_file() else None
        for p in sorted(folder.rglob("*"))
    }


# -- the parser


def loaded_by(*commands: tuple[str, ...]) -> list[tuple[str, str, set[str]]]:
    """Of each of some commands in one process: it, what it prints, and all modules loaded by then.

    What the first loads is there for the others too: the first with a module has loaded it.
    """
    program = (
        "import contextlib, io, json, sys\n"
        "from holdfast.cli.main import main\n"
        "for words in json.loads(sys.argv[1]):\n"
        "    with contextlib.redirect_stdout(io.StringIO()) as printed:\n"
        "        with contextlib.suppress(SystemExit):\n"
        "            assert main(words) == 0\n"
        "    print(json.dumps([printed.getvalue(), sorted(sys.modules)]))\n"
    )
    command = [sys.executable, "-c", program, json.dumps(commands)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    found = []
    for words, line in zip(commands, done.stdout.splitlines(), strict=True):
        printed, names = json.loads(line)
        modules = {name.removeprefix("holdfast.").split(".")[0] for name in names}
        found.append((" ".join(words), printed, modules))
    return found


OFTEN = (
    "check",
    "simulate",
    "train",
    "export",
    "adapt",
    "evaluate",
    "record",
    "study",
    "watch",
    "replay",
)


def test_what_holdfast_alone_says_to_try_are_commands_with_their_options() -> None:
    tried = re.findall(r"^  holdfast (\w+) (.+?)  ", START, re.MULTILINE)
    assert len(tried) == 3
    for verb, words in tried:
        parser = Parser(prog=verb)
        functions_of(verb)[0](parser)
        parser.parse_args(words.split())


def test_help_loads_no_package_that_takes_time() -> None:
    slow = {
        "numpy",
        "onnxruntime",
        "scipy",
        "sklearn",
        "pandas",
        "onnx",
        "skops",
        "matplotlib",
        "rich",
    }
    commands = [("--help",), ("--version",), *((verb, "--help") for verb in OFTEN)]
    for words, printed, modules in loaded_by(*commands):
        assert "holdfast" in printed, words
        assert modules & slow == set(), words


USAGE = {
    "fly": "unknown command 'fly'; choose from",
    "doctor --quickly": "--quickly",
    "train --rate many": "'many'",
    "replay": "MODEL",
    "evaluate m.onnx": "--data",
    "export a b": "b",
    "train --seed=-1": "whole number from 0 to",
    "run --seconds inf": "is not a number from",
}
"""What is typed, and what the error names."""


@pytest.mark.parametrize("typed", USAGE)
def test_a_usage_error_is_one_line_that_names_the_word(run: Run, typed: str) -> None:
    fails(run, 2, "UsageError", *typed.split(), says=USAGE[typed])
    assert "--help" in run(*typed.split())[2]


# -- bad recordings


HEADER = "Time," + ",".join(f"{axis}{k}" for k in range(1, 7) for axis in "XYZ")


def csv_of(
    times_s: list[float] | None = None, header: str = HEADER, cells: str = ",0.1" * 18
) -> str:
    times_s = [k / 50 for k in range(60)] if times_s is None else times_s
    return "\n".join([header, *(f"{t:.3f}{cells}" for t in times_s)]) + "\n"


STEPS = [k / 50 for k in range(60)]
BAD_TRIALS = {
    "a missing column": (
        csv_of(header=HEADER.removesuffix(",Z6"), cells=",0.1" * 17),
        "ColumnError",
        "Z6",
    ),
    "text in a number": (
        csv_of().replace("0.200,0.1", "0.200,soft"),
        "NotANumber",
        "'soft'",
    ),
    "time that runs backwards": (
        csv_of([*STEPS[:20], STEPS[18], *STEPS[20:]]),
        "TimeError",
        "backwards",
    ),
    "nothing in it": ("", "EmptyRecording", "empty"),
}


@pytest.mark.parametrize("fault", BAD_TRIALS)
def test_a_trial_with_this_fault_is_refused_by_replay_and_by_training(
    run: Run, four_situations: Built, tmp_path: Path, fault: str
) -> None:
    text, kind, says = BAD_TRIALS[fault]
    bad = tmp_path / "set" / "soft-ball" / "pull" / "trial_1.csv"
    bad.parent.mkdir(parents=True)
    bad.write_text(text)
    before = everything_in(tmp_path)
    for words in (
        ("replay", four_situations.model, bad),
        ("train", "--data", tmp_path / "set", "--out", tmp_path / "out"),
    ):
        fails(run, 3, kind, *words, says=says)
    assert everything_in(tmp_path) == before


ABSENT = {
    "replay MODEL HERE/trial.csv": "no such file",
    "replay MODEL HERE": "tactile.csv",
    "replay MODEL SET#no/such/trial": "no/such/trial",
    "train --data HERE --out HERE/out": "no known data set",
    "evaluate MODEL --data human_slip_uskin": "HOLDFAST_DATA",
}
"""A command, and what its error names."""


@pytest.mark.parametrize("typed", ABSENT)
def test_a_trial_or_a_set_that_is_absent_is_reported_as_absent(
    run: Run,
    four_situations: Built,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    typed: str,
) -> None:
    monkeypatch.setenv("HOLDFAST_DATA", str(tmp_path / "elsewhere"))
    words = typed.replace("MODEL", str(four_situations.model))
    words = words.replace("SET", str(four_situations.fixture))
    words = words.replace("HERE", str(tmp_path))
    fails(run, 3, "DataNotFound", *words.split(), says=ABSENT[typed])
    assert not any(tmp_path.iterdir())


# -- sets that cannot be learned from


def test_a_set_that_cannot_be_learned_from_is_refused_with_what_it_lacks(
    run: Run, tmp_path: Path
) -> None:
    slow, pulls_alone = tmp_path / "slow", tmp_path / "set"
    write_fixture(slow, trials_per_cell=1, rate_hz=15.0)
    write_phases(pulls_alone / "mug/pull/trial_1.csv", "risky_slip")
    for data, kind, says in (
        (slow, "RateError", "none of the bands"),
        (pulls_alone, "ClassMissing", "windows of risky_slip alone"),
    ):
        out = tmp_path / "out"
        words = ("train", "--data", data, "--out", out)
        fails(run, 3, kind, *words, says=says)
        assert not out.exists()


# -- a model and a source that do not fit


def test_a_model_made_for_other_channels_another_unit_or_another_rate_refuses_the_source(
    run: Run, four_situations: Built, tmp_path: Path
) -> None:
    model, trial = four_situations.model, tmp_path / "trial_1.csv"
    trial.write_text("Time,X1,Y1,Z1\n" + "".join(f"{t:.3f},1,2,3\n" for t in STEPS))
    fails(
        run,
        3,
        "ChannelError",
        "replay",
        model,
        trial,
        says=f"{trial}: the source has 3 channels, the model needs 18",
    )
    trial.write_text(csv_of([k / 70 for k in range(60)]))
    fails(run, 3, "RateError", "replay", model, trial, says="the model needs 50 Hz")
    trial.write_text(csv_of())
    assert run("replay", model, trial)[0] == 0
    (tmp_path / "meta.json").write_text('{"unit": "uT"}')
    fails(run, 3, "UnitError", "replay", model, trial, says="the model needs N")


@pytest.mark.parametrize(
    ("rate_hz", "code"), [(45.1, 0), (54.9, 0), (44.8, 3), (55.2, 3)]
)
def test_a_rate_within_a_tenth_is_accepted(
    run: Run, four_situations: Built, tmp_path: Path, rate_hz: float, code: int
) -> None:
    trial = tmp_path / "trial_1.csv"
    rows = [f"{k / rate_hz:.6f}{',0.1' * 18}" for k in range(60)]
    trial.write_text("\n".join([HEADER, *rows]) + "\n")
    assert run("replay", four_situations.model, trial)[0] == code


# -- files that are no model


BAD_MODELS: dict[str, tuple[Callable[[bytes], bytes], str]] = {
    "tampered with": (
        lambda data: data[:2000] + bytes([data[2000] ^ 1]) + data[2001:],
        "BrokenSeal",
    ),
    "a pickle": (lambda _: pickle.dumps({"forest": 1}), "NotAModel"),
}


@pytest.mark.parametrize("fault", BAD_MODELS)
def test_a_model_file_with_this_fault_is_refused(
    run: Run, four_situations: Built, tmp_path: Path, fault: str
) -> None:
    make, kind = BAD_MODELS[fault]
    bad = tmp_path / "holdfast.onnx"
    bad.write_bytes(make(four_situations.model.read_bytes()))
    fails(run, 4, kind, "replay", bad, four_situations.fixture / TRIAL, says=str(bad))
    assert [path.name for path in tmp_path.iterdir()] == ["holdfast.onnx"]


# -- artifacts


def pickled_inside(folder: Path) -> None:
    """A skops file with a foreign function in it."""
    somebodys = make_pipeline(
        FunctionTransformer(os.path.basename), LogisticRegression()
    )
    skops.io.dump(somebodys, folder / "situation.skops")


def truncate(name: str, share: float) -> Callable[[Path], None]:
    def cut(folder: Path) -> None:
        whole = (folder / name).read_bytes()
        (folder / name).write_bytes(whole[: int(share * len(whole))])

    return cut


def replaced(name: str, data: bytes) -> Callable[[Path], None]:
    def replace(folder: Path) -> None:
        (folder / name).write_bytes(data)

    return replace


def index(**changed: Any) -> Callable[[Path], None]:
    """artifact.json with other values; None: without the key."""

    def change(folder: Path) -> None:
        entries = {**json.loads((folder / "artifact.json").read_text()), **changed}
        kept = {key: value for key, value in entries.items() if value is not None}
        (folder / "artifact.json").write_text(json.dumps(kept))

    return change


def pickled_rows(folder: Path) -> None:
    np.savez(folder / "rows.npz", rows=np.array([Trap()], dtype=object))


BAD_ARTIFACTS: dict[str, Callable[[Path], None]] = {
    "no index": lambda folder: (folder / "artifact.json").unlink(),
    "an index that is no JSON": replaced("artifact.json", b'{"format": 1,'),
    "a spec without a rate": index(spec={"n_sensors": 6}),
    "a forest of a foreign type": pickled_inside,
    "a pickle for a forest": replaced("situation.skops", pickle.dumps(Trap())),
    "half a forest": truncate("situation.skops", 0.5),
    "rows that are a pickle": pickled_rows,
}


@pytest.mark.parametrize("fault", BAD_ARTIFACTS)
def test_an_artifact_with_this_fault_is_refused_and_nothing_is_written(
    run: Run, four_situations: Built, tmp_path: Path, fault: str
) -> None:
    artifact = shutil.copytree(four_situations.artifact, tmp_path / "artifact")
    (artifact / "holdfast.onnx").unlink()
    BAD_ARTIFACTS[fault](artifact)
    before = everything_in(tmp_path)
    fails(run, 4, "ArtifactError", "export", artifact, says=str(artifact))
    if fault == "a forest of a foreign type":
        says = "posixpath.basename"
        fails(run, 4, "ArtifactError", "export", artifact, says=says)
    assert everything_in(tmp_path) == before


def test_an_artifact_that_could_not_be_finished_is_not_taken_for_the_one_before(
    four_situations: Built, eight_classes: Built, tmp_path: Path
) -> None:
    artifact = shutil.copytree(eight_classes.artifact, tmp_path / "artifact")
    (
        artifact / "p_risky_250ms.skops"
    ).mkdir()  # a folder where the second head's file belongs
    with pytest.raises(OutputError):
        write_artifact(artifact, read_artifact(four_situations.artifact))
    with pytest.raises(ArtifactError):
        read_artifact(artifact)


# -- places that cannot be written


def test_a_file_where_a_folder_belongs_is_an_output_error(
    run: Run, four_situations: Built, tmp_path: Path
) -> None:
    """Also for root, whom no permission stops."""
    blocked = tmp_path / "blocked"
    blocked.write_text("a file")
    artifact, data = four_situations.artifact, four_situations.fixture
    figures = blocked / "figures.json"
    for words in (
        ("export", artifact, "--out", blocked / "holdfast.onnx"),
        ("evaluate", four_situations.model, "--data", data, "--json", figures),
        ("train", "--out", blocked / "out"),
    ):
        fails(run, 5, "OutputError", *words, says="blocked")
    with pytest.raises(OutputError):
        write_artifact(blocked / "out", read_artifact(artifact))
    assert everything_in(tmp_path) == {"blocked": b"a file"}


# -- the scripts of CI


# -- the doctor


def test_the_doctor_runs_where_no_package_is_installed_at_all(tmp_path: Path) -> None:
    """-S: without the site's packages, numpy and onnxruntime among them."""
    environment = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "HOLDFAST_DATA": str(tmp_path),
    }
    command = [sys.executable, "-S", "-m", "holdfast", "doctor", "--json"]
    done = subprocess.run(
        command,
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    found = {line["what"]: line for line in json.loads(done.stdout)["findings"]}
    assert found["live path"]["status"] == "missing"
    assert "numpy" in found["live path"]["found"]
    assert found["live path"]["next_step"] == "pip install holdfast"
    assert "train" in found["extras"]["found"]
    assert found["onnxruntime"]["status"] == "missing"


def test_windows_at_which_the_hand_would_say_unknown_count_as_misses(
    run: Run, eight_classes: Built, tmp_path: Path
) -> None:
    shutil.copytree(eight_classes.fixture, tmp_path / "blind")
    for trial in (tmp_path / "blind").rglob("*.csv"):
        head, *lines = trial.read_text().splitlines()
        trial.write_text(
            "\n".join([f"{head},valid1", *(f"{line},0" for line in lines)]) + "\n"
        )
    code, out, _ = run(
        "evaluate",
        eight_classes.model,
        "--data",
        tmp_path / "blind",
        "--json",
        tmp_path / "f.json",
    )
    figures = json.loads((tmp_path / "f.json").read_text())
    assert (code, figures["situations"]["macro_f1"]) == (0, 0.0)
    assert f"unknown at {figures['unknown_windows']} windows" in out


def test_an_empty_path_is_a_usage_error_and_not_the_folder_we_are_in(run: Run) -> None:
    fails(run, 2, "UsageError", "train", "--out", "", says="the path is empty")


# -- names that are no UTF-8, and a locale that cannot show a name

NAMES = {
    "check": "NAME",
    "convert": "NAME --to mcap --out NAME/out",
    "import": "NAME --out NAME/out --yes",
    "evaluate": "NAME/m.onnx --data NAME",
    "train": "--data NAME/none --out NAME/out",
    "export": "NAME --out NAME/m.onnx",
    "simulate": "NAME/card.toml --out NAME/out",
    "doctor": "NAME/m.onnx",
    "scan": "i2c://NAME",
    "bias": "--source NAME/none --out NAME/bias.json",
    "calibrate": "NAME/loads.csv --out NAME/hand.json",
    "bench": "latency NAME/m.onnx --out NAME/out",
    "board": "NAME",
    "study": "NAME/study.toml --list",
    "adapt": "NAME/m.onnx --undo --out NAME/base.onnx",
    "watch": "--onset NAME",
    "run": "NAME/m.onnx --source virtual://ft232h",
    "replay": "NAME/m.onnx NAME/trial.csv",
    "record": "--source NAME/none --person p01 --object cup --action pull --out NAME/out --at-once",
}


@pytest.mark.parametrize("verb", VERBS)
@pytest.mark.parametrize("name", [b"caf\xe9", "café".encode(), b"\xff\xfe\x1b[2J"])
def test_a_name_that_a_locale_cannot_show_gives_one_line_in_every_verb(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, verb: str, name: bytes
) -> None:
    folder = tmp_path / os.fsdecode(name)
    folder.mkdir()
    for file in ("m.onnx", "loads.csv", "card.toml", "study.toml", "trial.csv"):
        (folder / file).write_bytes(b"of no use \xff")
    words = [word.replace("NAME", str(folder)) for word in NAMES[verb].split()]
    # as where LC_ALL=C, without the coercion to UTF-8
    shown = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    told = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    with monkeypatch.context() as patched, open(os.devnull) as nothing:
        patched.setattr(sys, "stdin", nothing)
        patched.setattr(sys, "stdout", shown)
        patched.setattr(sys, "stderr", told)
        code = main([verb, *words])
    texts = []
    for stream in (shown, told):
        stream.seek(0)
        texts.append(stream.read())
    errors = [line for line in texts[1].splitlines() if "error: " in line]
    # these two tell what is wrong on stdout
    assert (code > 0, len(errors)) == (True, verb not in ("check", "doctor")), texts
    assert "Traceback" not in texts[1]
    assert "another place to write" not in texts[1]


@pytest.mark.parametrize(
    ("error", "kind", "step"),
    [
        (
            PermissionError(13, "Permission denied", "a.csv"),
            "DataError",
            "check the path",
        ),
        (
            IsADirectoryError(21, "Is a directory", b"a.csv"),
            "DataError",
            "check the path",
        ),
        (OSError(36, "File name too long", "a.csv"), "DataError", "check the path"),
        (
            OSError(28, "No space left on device", "a.csv"),
            "OutputError",
            "another place",
        ),
        (OSError(5, "Input/output error"), "OutputError", "another place"),
    ],
)
def test_an_error_of_reading_gives_no_advice_on_writing(
    capsys: pytest.CaptureFixture[str], error: OSError, kind: str, step: str
) -> None:
    def fails_to_read(argv: object) -> int:
        raise error

    assert finish(fails_to_read, []) == {"DataError": 3, "OutputError": 5}[kind]
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"error: {kind}: ")
    assert step in line
