"""docs/gripper.md does what it says: logs of another program become a gripper that is commanded."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import Run

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
                code, out, err = run(*shlex.split(line)[1:])
                codes.append(code)
                found[shlex.split(line)[1]] = out + err
        else:
            in_a_shell(text)

    # The first import only proposes a map.
    assert codes == [0, 2, 0, 0, 0, 0]
    assert "30 trials, 2 sensors, in N" in found["import"]
    assert "held out by object: 3 objects" in found["check"]
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
