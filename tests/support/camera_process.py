"""depthai in a process that has loaded it once: requests come in on stdin, answers go to stdout.

Loading depthai takes a second of the processor, most of it in a thread that unpacks firmware. So
one process runs what several tests ask for; what crashes it fails one test, and the next test gets
a new process. What must see depthai's start, its environment or a limit runs in drawn_frames.py's
`process`.
"""

from __future__ import annotations

import faulthandler
import json
import os
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

ROOT = Path(__file__).resolve().parents[2]
LONGEST_S = 300


class CameraProcess:
    """The process, started by the first request and again after a crash."""

    def __init__(self, environment: dict[str, str]) -> None:
        self.environment = environment
        self.child: subprocess.Popen[str] | None = None

    def run(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Words of the command line, or "-c", a program and its words, as Python takes them."""
        if self.child is not None and self.child.poll() is not None:
            self._forget(self.child)
        if self.child is None:
            self.child = subprocess.Popen(
                [sys.executable, __file__],
                cwd=ROOT,
                env=self.environment | {"PYTHONPATH": str(ROOT)},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
        assert self.child.stdin is not None
        assert self.child.stdout is not None
        self.child.stdin.write(json.dumps(words) + "\n")
        self.child.stdin.flush()
        answer = self.child.stdout.readline()
        if not answer:
            code = self.child.wait()
            self._forget(self.child)
            return subprocess.CompletedProcess(words, code, "", "it crashed")
        return subprocess.CompletedProcess(words, *json.loads(answer))

    def _forget(self, child: subprocess.Popen[str]) -> None:
        """Close the pipes of a process that has ended."""
        for pipe in (child.stdin, child.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        self.child = None

    def end(self) -> None:
        """Let the process end, if there is one."""
        if self.child is not None:
            self.child.communicate()


@contextmanager
def captured(file: BinaryIO, *descriptors: int) -> Iterator[None]:
    """What is written to the descriptors meanwhile, by Python or by a library, goes to the file."""
    kept = [os.dup(one) for one in descriptors]
    for one in descriptors:
        os.dup2(file.fileno(), one)
    try:
        yield
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        for one, before in zip(descriptors, kept, strict=True):
            os.dup2(before, one)
            os.close(before)


def answered(words: list[str]) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of one request."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        with captured(out, 1), captured(err, 2):
            code = done(words)
        texts = []
        for file in (out, err):
            file.seek(0)
            texts.append(file.read().decode("utf-8", "replace"))
    return code, texts[0], texts[1]


def done(words: list[str]) -> int:
    """Run one request; a traceback goes to stderr, as Python writes it."""
    from holdfast.cli.main import main

    faulthandler.dump_traceback_later(LONGEST_S, exit=True)
    try:
        if words[0] != "-c":
            return main(words)
        sys.argv = ["-c", *words[2:]]
        names: dict[str, Any] = {"__name__": "__main__"}
        exec(words[1], names)
        return 0
    except Exception:
        traceback.print_exc()
        return 1
    finally:
        faulthandler.cancel_dump_traceback_later()


def serve() -> None:
    """Answer requests until stdin ends.

    Answers have a descriptor of their own: a thread of depthai may write to stdout after the
    request that began it has ended, and that line goes to stderr.
    """
    with os.fdopen(os.dup(1), "w") as answers:
        os.dup2(2, 1)
        for line in sys.stdin:
            answers.write(json.dumps(answered(json.loads(line))) + "\n")
            answers.flush()


if __name__ == "__main__":
    serve()
