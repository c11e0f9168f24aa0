"""docs/gripper.md does what it says: logs of another program become a gripper that is commanded."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_line import Run
from long_steps import long_steps

from holdfast.training.datasets.eflesh_slip import BLOCK_TRIALS, SIX_MAGNETOMETERS
from holdfast.training.datasets.public_files import channels_of

PAGE = Path(__file__).resolve().parents[2] / "docs/gripper.md"
BLOCK = re.compile(r"```(sh|python)\n(.*?)```", re.DOTALL)
OURS = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"


def in_a_shell(text: str) -> str:
    """What a block prints on stderr, where a person reads of a run."""
    environment = {**os.environ, "PATH": OURS}
    words = ["sh", "-e", "-c", text]
    done = subprocess.run(
        words, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stderr


@pytest.mark.filterwarnings("ignore")
def test_the_page_runs_from_logs_of_another_program_to_a_gripper_that_holds(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    found: dict[str, str] = {}
    codes: list[int] = []
    for kind, text in BLOCK.findall(PAGE.read_text("utf-8")):
        if kind == "python":
            exec(text, {})
        elif text.startswith("holdfast run"):
            found["run"] = found.get("run", "") + in_a_shell(text)
        elif text.startswith("holdfast"):
            for line in text.splitlines():
                # the page claims no time of a slip to the millisecond
                with long_steps():
                    code, out, err = run(*shlex.split(line)[1:])
                codes.append(code)
                found[shlex.split(line)[1]] = out + err
        else:
            in_a_shell(text)

    # The first import only proposes a map.
    assert codes == [0, 2, 0, 0, 0, 0]
    assert "sensors    2, by the map" in found["import"]
    assert "32 trials: 16 hold, 16 slip" in found["import"]
    assert "held out by object: 4 objects" in found["check"]
    assert "held out by object: macro F1" in found["train"]
    headline = "<h1>Held out by object: macro F1"
    assert headline in Path("build/gripper/report.html").read_text("utf-8")
    card = json.loads(Path("build/gripper/gripper.json").read_text("utf-8"))
    assert card["training"]["kind"] == "simulated"
    assert found["run"].count("hand: gripper, 2 sensors") == 2
    answers = Path("build/gripper/answers.jsonl").read_text("utf-8").splitlines()
    states = {json.loads(line)["state"] for line in answers}
    assert {"nothing", "grasp"} <= states
    assert "scene: the object is in the hand" in found["run"]


def pads_as_logs(npz: Path, folder: Path, every: int) -> Path:
    """Real trials of a two-pad gripper as another program's logs; returns one that slips."""
    folder.mkdir()
    with np.load(npz) as arrays:
        fields_ut = arrays["X"][:, :, channels_of(SIX_MAGNETOMETERS)]
        tugged = arrays["y"]
    names = [f"pad {p} m{k} {a} [uT]" for p in "AB" for k in (1, 2, 3) for a in "xyz"]
    head = ";".join(["clock (ms)", *names])
    slips = []
    for number in range(0, len(tugged), every):
        action = "slip" if tugged[number] else "hold"
        path = folder / f"block-{number // BLOCK_TRIALS}_{action}_{number}.csv"
        field_ut = fields_ut[number]
        rows = np.column_stack([10.0 * np.arange(len(field_ut)) + 7e5, field_ut])
        np.savetxt(path, rows, "%.3f", ";", header=head, comments="")
        path.write_text(path.read_text("utf-8").replace(".", ","), "utf-8")
        slips += [path] if tugged[number] else []
    return slips[0]


@pytest.mark.filterwarnings("ignore")
def test_real_logs_of_two_pads_become_a_judged_model_and_a_live_run(
    run: Run,
    real_set: Callable[[str], Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    slip = pads_as_logs(real_set("eflesh_slip") / "eflesh_slip.npz", Path("logs"), 4)
    assert run("import", "logs", "--out", "set")[0] == 2
    proposed = Path("set-map.toml")
    card = 'hand = "eflesh-gripper"\n'
    proposed.write_text(card + proposed.read_text("utf-8"), "utf-8")
    code, out, err = run("import", "logs", "--out", "set", "--map", proposed)
    assert code == 0, out + err
    assert "sensors    6, by the map" in out
    assert "unit       uT, by the map" in out
    assert run("check", "set")[0] == 0
    words = "train --data set --out model --report r.html --size tiny --learner forest"
    code, out, err = run(*words.split())
    assert code == 0, err
    assert "held out by object: macro F1 over grasp, risky slip alone" in out
    page = Path("r.html").read_text("utf-8")
    assert "<h1>Held out by object: macro F1" in page
    assert "thumb" not in page
    assert run("export", "model", "--out", "pads.onnx")[0] == 0
    source = shlex.quote("stdin://?map=set-map.toml")
    line = f"holdfast run pads.onnx --to a.jsonl --source {source} < {slip}"
    said = in_a_shell(line)
    assert "hand: eflesh-gripper, 6 sensors" in said
    assert '"state":"risky_slip"' in Path("a.jsonl").read_text("utf-8")
