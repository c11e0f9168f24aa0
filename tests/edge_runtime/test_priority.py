"""The thread that reads a hand has priority where the system allows it; no other thread has."""

from __future__ import annotations

import os
import subprocess
import sys
import threading

import pytest

from holdfast.live.running import real_time

FIRST = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
ASKS = "import os; print(os.sched_getscheduler(0))"


def policies() -> list[int]:
    """Of this thread, of a new thread, and of a new process."""
    values: list[int] = []
    thread = threading.Thread(target=lambda: values.append(os.sched_getscheduler(0)))
    thread.start()
    thread.join()
    child = subprocess.run(
        [sys.executable, "-c", ASKS], capture_output=True, text=True, check=True
    )
    return [os.sched_getscheduler(0), *values, int(child.stdout)]


@pytest.fixture
def allowed() -> None:
    with real_time() as yes:
        if not yes:
            pytest.skip("this user may not have real-time priority")


def test_the_reader_goes_first_and_what_it_starts_does_not(allowed):
    with real_time():
        mine, thread, child = policies()
    assert mine == FIRST
    assert thread == child == os.SCHED_OTHER


def test_the_priority_ends_with_the_reading_however_it_ends(allowed):
    before = os.sched_getscheduler(0)
    with pytest.raises(KeyError), real_time():
        raise KeyError
    assert os.sched_getscheduler(0) == before


def test_a_user_without_the_right_reads_on_and_is_warned_once():
    """A real process that may not: root that gave its rights up, or the user of the tests without
    them."""
    script = (
        "import os\n"
        "from holdfast.live.running import real_time_priority\n"
        "if os.geteuid() == 0:\n    os.setgid(65534); os.setuid(65534)\n"
        "with real_time_priority(print) as yes:\n    print(yes)\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    ).stdout
    if result == "True\n":
        pytest.skip("this user has real-time priority without root")
    line, allowed = result.splitlines()
    assert "holdfast doctor" in line
    assert allowed == "False"
