"""The examples in C and in the browser answer a recording as the live path in Python does."""

from __future__ import annotations

import ctypes
import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from c_form import SANITISED, STRICT, require_compiler
from small_model import for_the_hand, graph_of

from benchmarks.runtimes.c_programs import FLAGS, WASM, compiled
from examples.browser.setups import setup_numbers
from holdfast.core.contract import GripCommand, Json, Prediction, channel_names
from holdfast.drivers.replay import open_replay
from holdfast.edge_runtime.grip import AnswerRules
from holdfast.edge_runtime.grip_control import GripControl
from holdfast.edge_runtime.model import Model
from holdfast.edge_runtime.monitor import GripMonitor
from holdfast.edge_runtime.preparation import Tare
from holdfast.export.c.exporting import export_c
from holdfast.export.exporting import model_card, seal

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
LIVE = EXAMPLES / "c" / "live.c"
IN_NODE = """
const { readFileSync } = require("node:fs");
const { readTrial, runTrial } = require(process.argv[1]);
WebAssembly.instantiate(readFileSync(process.argv[2]), {}).then(({ instance }) => {
  const hand = instance.exports;
  const trial = readTrial(readFileSync(process.argv[3], "utf8"), hand.channels());
  for (const one of runTrial(hand, trial, null)) console.log(JSON.stringify(one));
});
"""
SAME_STORY = """
const { readFileSync } = require("node:fs");
WebAssembly.instantiate(readFileSync(process.argv[1]), {}).then(({ instance }) => {
  const hand = instance.exports;
  const bytes = (from, count) => Buffer.from(hand.memory.buffer, from, count).toString("hex");
  const numbers = JSON.parse(process.argv[2]);
  new Float64Array(hand.memory.buffer, hand.setup(), hand.setup_count()).set(numbers);
  hand.start(3);
  for (let k = 0; k < 600; ++k) {
    for (const [at, name, ...values] of JSON.parse(process.argv[3]))
      if (at === k) hand[name](...values);
    hand.advance(1);
    const seen = bytes(hand.seen(), 8 * hand.seen_count());
    console.log(seen + bytes(hand.answers(), hand.answers_bytes()));
  }
});
"""
"""Prints what the page sees of its world, and the answers, bit for bit."""
STORY: list[list[Any]] = [
    [240, "let_go", 0.3],
    [400, "pull_to", 0.01, 0.0, -0.1],
    [440, "release"],
    [470, "take_over"],
    [520, "open_hand"],
]
"""[sample, call, its numbers]."""
ROWS = 600


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("example")
    made = for_the_hand()
    (folder / "small.onnx").write_bytes(
        seal(graph_of(made), model_card(made), made.spec)
    )
    export_c(folder / "small.onnx", folder / "c")
    words = [
        require_compiler("gcc", *SANITISED),
        *STRICT,
        *SANITISED,
        "-I",
        "c",
        "-o",
        "live",
    ]
    done = subprocess.run([*words, str(LIVE), "c/holdfast.c", "-lm"], cwd=folder)
    assert done.returncode == 0
    return folder / "small.onnx"


def recording(path: Path) -> Path:
    """A hand at rest, then pressed and shaken; one sensor turned round, some samples lost.

    Flags are written as people write them: 0, 0.0 and False.
    """
    rng = np.random.default_rng(4)
    at = np.arange(ROWS)
    press = np.clip((at - 100) / 50.0, 0.0, 3.0)[:, None] * np.tile([0.3, 0.1, 1.0], 6)
    shake = np.where((at % 200 > 120)[:, None], 0.5, 0.01) * rng.normal(size=(ROWS, 18))
    values = press + shake + rng.normal(size=18)
    values[:, 6:9] = -(press[:, 6:9] + shake[:, 6:9]) - 1.0
    valid = np.ones((ROWS, 6), dtype=int)
    valid[250:252, 4] = valid[400:420, 2] = 0
    names = [
        "Time",
        *channel_names(6),
        "host_ns",
        "sequence",
        *(f"valid{k}" for k in range(1, 7)),
    ]
    table = np.column_stack([at / 150.0, values, 10 * at, at, valid])
    came = np.delete(table, [300, 301], axis=0)
    lines = [",".join(names)]
    for row in came:
        numbers = [f"{row[0]:.6f}", *(f"{value:.5f}" for value in row[1:19])]
        flags = [f"{flag:g}" for flag in row[19:]]
        flags[4], flags[6] = f"{row[23]:.1f}", str(row[25] != 0.0)
        lines.append(",".join([*numbers, *flags]))
    path.write_text("\n".join(lines) + "\n")
    return path


def of_python(model: Path, trial: Path) -> list[tuple[Prediction, GripCommand]]:
    """The live path on the same lines: bias from the first rows, monitor, grip controller."""
    opened = Model(model)
    card = opened.card
    rules = AnswerRules.of(card.decision)
    monitor = GripMonitor(opened, None)
    control = GripControl("holdfast", card.rate_hz, rules=rules)
    tare, answers = Tare(card.preparation, card.n_channels), []
    for sample in open_replay(trial):
        values, valid = tare.prepare(sample.values, sample.valid)
        prediction = monitor.feed(replace(sample, values=values, valid=valid))
        answers.append((prediction, control.step(prediction, values, valid)))
    return answers


def require_same(got: dict[int, Json], model: Path, trial: Path) -> None:
    """Raise AssertionError where an example's answers are not those of the live path."""
    wanted = {
        prediction.sequence: (prediction, command)
        for prediction, command in of_python(model, trial)
    }
    assert len(got) == ROWS - 2
    for row, one in got.items():
        prediction, command = wanted[row]
        assert (one["state"], one["act"], one["mode"]) == (
            prediction.state,
            prediction.act,
            command.mode,
        ), row
        assert abs(one["p_risky"] - prediction.p_risky) <= 2e-6
        assert abs(one["target_n"] - (command.target_n or 0.0)) <= 1e-3
    assert {one["state"] for one in got.values()} >= {"unknown", "nothing", "grasp"}
    assert {one["mode"] for one in got.values()} > {"hold"}


def test_the_example_answers_a_recording_as_the_live_path_does(
    model: Path, tmp_path: Path
):
    trial = recording(tmp_path / "trial_1.csv")
    with trial.open() as lines:
        done = subprocess.run(
            [model.parent / "live"], stdin=lines, capture_output=True, text=True
        )
    assert (done.returncode, done.stderr) == (0, "")
    got = {
        round(150 * one["t_s"]): one
        for one in map(json.loads, done.stdout.splitlines())
    }
    require_same(got, model, trial)


def times_of(n: int, rate_hz: float, back_at: int | None = None) -> list[float]:
    """Times at a rate; from sample `back_at` on 1 s earlier."""
    return [k / rate_hz - (back_at is not None and k >= back_at) for k in range(n)]


NOT_FOR_IT = {
    "50 Hz": (times_of(200, 50.0), "rate"),
    "75 Hz": (times_of(200, 75.0), "rate"),
    "300 Hz": (times_of(200, 300.0), "rate"),
    "time that runs back": (times_of(400, 150.0, back_at=300), "does not rise"),
    "time that is nan": ([*times_of(100, 150.0), float("nan")], "does not rise"),
}


@pytest.mark.parametrize("what", NOT_FOR_IT)
def test_the_example_refuses_another_rate_and_a_time_that_runs_back(model: Path, what):
    times, says = NOT_FOR_IT[what]
    lines = [f"{t:.6f}," + ",".join(["0.01"] * 18) for t in times]
    text = "\n".join(["Time", *lines, ""])
    done = subprocess.run(
        [model.parent / "live"], input=text, capture_output=True, text=True
    )
    assert done.returncode == 2
    assert says in done.stderr
    states = {json.loads(line)["state"] for line in done.stdout.splitlines()}
    assert states <= {"unknown"} or says != "rate"


@pytest.mark.parametrize("sensors", [7, 13])
def test_the_example_refuses_a_hand_of_more_sensors(model: Path, sensors: int) -> None:
    text = "".join(f"{k / 150:.6f}" + ",0.01" * 3 * sensors + "\n" for k in range(9))
    done = subprocess.run(
        [model.parent / "live"], input=text, capture_output=True, text=True
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert "numbers; this model has 6 sensors" in done.stderr


NOT_RUN_IN_NODE = """
const { runTrial } = require(process.argv[1]);
const memory = new WebAssembly.Memory({ initial: 1 });
const refused = () => { throw new Error("the hand was asked"); };
const hand = { memory, channels: () => 3, samples: () => 0, valids: () => 64, begin: refused };
hand.rate_hz = () => 150;
const times = JSON.parse(process.argv[2]);
const rows = times.map(() => [0, 0, 0]);
try { runTrial(hand, { times, rows, valid: times.map(() => [1]) }, null); }
catch (error) { console.log(error.message); }
"""


@pytest.mark.parametrize("what", [one for one in NOT_FOR_IT if "nan" not in one])
def test_the_trial_page_refuses_another_rate_and_a_time_that_runs_back(what):
    if shutil.which("node") is None:
        pytest.skip("no node for examples/browser/trial.js")
    times, says = NOT_FOR_IT[what]
    script = str(EXAMPLES / "browser/trial.js")
    words = ["node", "-e", NOT_RUN_IN_NODE, script, json.dumps(times)]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    wanted = "samples a second" if says == "rate" else says
    assert wanted in done.stdout


READ_IN_NODE = """
const { readTrial } = require(process.argv[1]);
try { console.log(JSON.stringify(readTrial(process.argv[2], 6).valid)); }
catch (error) { console.log(error.message); }
"""


def test_the_trial_page_reads_flags_as_people_write_them_and_refuses_more_sensors():
    if shutil.which("node") is None:
        pytest.skip("no node for examples/browser/trial.js")

    def read(*lines: str) -> str:
        script = str(EXAMPLES / "browser/trial.js")
        words = ["node", "-e", READ_IN_NODE, script, "\n".join(lines)]
        return subprocess.run(words, capture_output=True, text=True).stdout.strip()

    names = ",".join(["Time", *channel_names(2), "valid1", " valid2"])
    flags = ["1,0", "1,0.0", "True,False", "1, false", "1,"]
    lines = [f"{k / 150},0,0,1,0,0,1,{flag}" for k, flag in enumerate(flags)]
    found = [[bool(flag) for flag in row] for row in json.loads(read(names, *lines))]
    assert found == [[True, False]] * 5
    more = ",".join(["Time", *channel_names(3)])
    rows = [f"{k}" + ",1" * 9 for k in range(2)]
    assert "more sensors than the model's 2" in read(more, *rows)


@pytest.fixture(scope="module")
def wasm(model: Path) -> Path:
    if not WASM.is_installed:
        pytest.skip(f"the browser's example needs {', '.join(WASM.programs)}")
    main = EXAMPLES / "browser/try.c"
    return compiled(WASM, model.parent / "c", main, model.parent / "hand.wasm")


def test_the_hand_in_the_browser_answers_as_the_live_path_does(
    model: Path, wasm: Path, tmp_path: Path
):
    trial = recording(tmp_path / "trial_1.csv")
    words = [
        "node",
        "-e",
        IN_NODE,
        str(EXAMPLES / "browser/trial.js"),
        str(wasm),
        str(trial),
    ]
    done = subprocess.run(words, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    got = {}
    for one in map(json.loads, done.stdout.splitlines()):
        names = {"state": one["situation"].replace(" ", "_"), "act": one["acts"]}
        numbers = {
            "p_risky": one["risky"],
            "target_n": one["target"],
            "mode": one["mode"],
        }
        got[round(150 * one["t"])] = names | numbers
    require_same(got, model, trial)


def story_in_c(library: ctypes.CDLL, setup: list[float]) -> list[str]:
    """What SAME_STORY prints, by the same sources compiled for this machine."""
    for name in ("setup", "seen", "answers"):
        getattr(library, name).restype = ctypes.c_void_p
    numbers = (ctypes.c_double * len(setup))(*setup)
    ctypes.memmove(library.setup(), numbers, ctypes.sizeof(numbers))
    library.start(ctypes.c_double(3))
    lines = []
    for k in range(600):
        for at, name, *values in STORY:
            if at == k:
                getattr(library, name)(*map(ctypes.c_double, values))
        assert library.advance(1) == 0
        seen = ctypes.string_at(library.seen(), 8 * library.seen_count())
        answers = ctypes.string_at(library.answers(), library.answers_bytes())
        lines.append((seen + answers).hex())
    return lines


def test_the_pages_world_has_the_same_bits_in_webassembly_and_on_this_machine(
    model: Path, wasm: Path
):
    made = model.parent / "try.so"
    # -Bsymbolic: the C library has a `step` of its own.
    shared = ["-shared", "-fPIC", "-Wl,-Bsymbolic", "-I", "c", "-o", str(made)]
    words = [require_compiler(), *FLAGS, *shared]
    sources = ["c/holdfast.c", str(EXAMPLES / "browser/try.c"), "-lm"]
    done = subprocess.run([*words, *sources], cwd=model.parent)
    assert done.returncode == 0
    setup = [*setup_numbers("full-bottle"), 8.0]
    words = ["node", "-e", SAME_STORY, str(wasm)]
    story = [*words, json.dumps(setup), json.dumps(STORY)]
    printed = subprocess.run(story, capture_output=True, text=True, check=True).stdout
    wanted = story_in_c(ctypes.CDLL(str(made)), setup)
    assert printed.splitlines() == wanted
    assert len(set(wanted)) == 600
