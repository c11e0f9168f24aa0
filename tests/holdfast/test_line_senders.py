"""The example senders of lines, piped into a run."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
from command_line import fails
from live_bench import TINY

from holdfast.core.hand_lines import LineRefused
from holdfast.drivers.lines import SampleReader

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"
RUN = [sys.executable, "-m", "holdfast", "run", str(TINY), "--source"]
MS = 1_000_000


def example(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def c_sender(tmp_path_factory: pytest.TempPathFactory) -> str:
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler (cc) for examples/line_sender.c")
    made = str(tmp_path_factory.mktemp("sender") / "line_sender")
    strict = ["-std=c99", "-D_POSIX_C_SOURCE=200809L", "-Wall", "-Wextra", "-Werror"]
    source = str(EXAMPLES / "line_sender.c")
    subprocess.run([compiler, *strict, "-o", made, source], check=True)
    return made


def answers_of(sender: list[str], url: str, *options: str) -> tuple[list[dict], str]:
    """What a run prints on lines that a program sends into its standard input."""
    with subprocess.Popen(sender, stdout=subprocess.PIPE, cwd=ROOT) as lines:
        assert lines.stdout is not None
        with lines.stdout:
            run = subprocess.run(
                [*RUN, url, *options],
                stdin=lines.stdout,
                capture_output=True,
                text=True,
                cwd=ROOT,
                check=False,
            )
        lines.kill()
    assert run.returncode == 0, run.stderr
    return [json.loads(line) for line in run.stdout.splitlines()], run.stderr


def test_the_sender_in_c_is_answered_until_its_end(c_sender: str) -> None:
    answers, said = answers_of([c_sender, "600"], "stdin://?rate_hz=150")
    assert "stdin: its lines ended" in said
    assert "6 sensors in N at 150 Hz" in said
    assert len(answers) > 0
    assert all(one["state"] in ("unknown", "nothing") for one in answers)


def test_the_sender_in_c_ends_a_line_with_its_row(c_sender: str) -> None:
    """A line end that came with the next row made every sample a period late."""
    with subprocess.Popen([c_sender], stdout=subprocess.PIPE) as sender:
        assert sender.stdout is not None
        came = [os.read(sender.stdout.fileno(), 1 << 16) for _ in range(4)]
        sender.kill()
    assert all(one.endswith(b"\n") for one in came)


def test_the_sender_in_python_is_answered(tmp_path: Path) -> None:
    sender = [sys.executable, str(EXAMPLES / "line_sender.py")]
    answers, said = answers_of(sender, "stdin://?rate_hz=150", "--seconds", "1")
    assert "stdin: 6 sensors in N" in said
    assert answers


def test_the_node_of_ros_2_prints_lines_that_are_samples() -> None:
    """rclpy is not needed for its lines; the node itself runs where ROS 2 is."""
    line = example("ros2_lines").line
    reader = SampleReader()
    newest = [(0, (0.1, 0.2, 3.0)), None, (-60 * MS, (0.1, 0.2, 3.0))]
    sample = reader.take(line(0, 5 * MS, newest).encode(), 0)
    assert sample is not None
    assert sample.valid.tolist() == [True, False, False]
    assert sample.values[:3].tolist() == [0.1, 0.2, 3.0]
    with pytest.raises(LineRefused, match="stamped like the line before"):
        reader.take(line(1, 5 * MS, newest).encode(), 0)


def test_the_board_sends_rows_below_a_header_of_our_names() -> None:
    """What the sketch prints, by its own text: there is no compiler for it here."""
    sketch = (EXAMPLES / "line_sender" / "line_sender.ino").read_text("utf-8")
    (header,) = re.findall(r'Serial\.println\("([^"]+)"\)', sketch)
    reader = SampleReader(unit="count")
    assert reader.take(header.encode() + b"\r", 0) is None
    sample = reader.take(b"512,498,533,510,500,490\r", 0)
    assert sample is not None
    assert sample.valid.all()


def test_a_study_and_keys_do_not_come_from_the_standard_input_that_is_the_source(
    run, tmp_path: Path
) -> None:
    words = ["record", "--source", "-", "--out", tmp_path / "a", "--person", "p01"]
    words += ["--object", "cup", "--action", "pull"]
    fails(run, 2, "UsageError", *words, says="is the source")
