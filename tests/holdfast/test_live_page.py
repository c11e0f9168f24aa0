"""The live page's server: what it shows, to whom, and that no browser delays another."""

from __future__ import annotations

import socket
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest
from hazard_marks import CROWDED_PAGE, FOREIGN_BROWSER, PAGE_DELAYS, STALE_PAGE
from packages import loaded_by
from page_bench import ABOUT, PERIOD_NS, TOKEN, next_event, sample, served

from holdfast.core.errors import UsageError
from holdfast.live.page.run_page import listen, read_address
from holdfast.live.page.server import (
    FILES,
    KEPT_FRAMES,
    ROW_FIELDS,
    LiveStream,
    PageHandler,
)

ROOT = Path(__file__).resolve().parents[2]


# -- what is shown


def test_a_browser_gets_the_whole_picture_and_then_every_sample_once():
    with served() as page:
        page.frame({"said": "begun"}, *map(sample, range(3)))
        with page.begin("/events") as answer:
            name, whole = next_event(answer)
            page.frame(
                sample(3),
                sample(4, "risky_slip"),
            )
            _, frame = next_event(answer)
    rows = [
        dict(zip(ROW_FIELDS, row, strict=True)) for row in whole["rows"] + frame["rows"]
    ]
    assert name == "whole"
    assert whole["said"] == ["begun"]
    assert [row["t_s"] for row in rows] == [
        round(1e-9 * k * PERIOD_NS, 4) for k in range(5)
    ]
    assert [row["state"] for row in rows[3:]] == ["grasp", "risky_slip"]
    assert (rows[0]["grip"], rows[0]["load"]) == (2.0, 0.6)
    assert frame["sample"]["answer"]["state"] == "risky_slip"


@STALE_PAGE.mark
def test_a_target_that_does_not_leave_is_not_drawn():
    away = sample(1)
    away["sample"]["grip"]["leaves"] = False
    with served() as page, page.begin("/events") as answer:
        next_event(answer)
        page.frame(sample(0), away)
        _, frame = next_event(answer)
    rows = [dict(zip(ROW_FIELDS, row, strict=True)) for row in frame["rows"]]
    assert [row["target"] for row in rows] == [9.4, None]
    assert frame["sample"]["grip"]["leaves"] is False


def test_a_lost_finger_is_named_and_counts_for_no_force_and_an_unknown_state_has_no_p_risky():
    nan = float("nan")
    lost = sample(0, "unknown", x=[nan] * 3 + [0.0, 0.0, 1.0] * 5, v=[0, 1, 1, 1, 1, 1])
    lost["sample"]["why"] = ["nack", "", "", "", "", ""]
    with served() as page, page.begin("/events") as answer:
        next_event(answer)
        page.frame(lost)
        _, frame = next_event(answer)
    row = dict(zip(ROW_FIELDS, frame["rows"][0], strict=True))
    assert frame["sample"]["forces"][0] == [None, None, None]
    assert frame["sample"]["why"][0] == "nack"
    assert (row["grip"], row["state"], row["p_risky"]) == (2.5, "unknown", None)


@STALE_PAGE.mark
def test_a_loop_that_sends_nothing_is_silent_and_one_that_has_ended_says_so():
    with served() as page, page.begin("/events") as answer:
        assert next_event(answer)[1]["silent_s"] is None
        page.frame(sample(0), now_s=100.0)
        assert next_event(answer)[1]["silent_s"] == 0.0
        page.frame(now_s=103.5)
        assert next_event(answer)[1]["silent_s"] == 3.5
        page.frame({"end": "the run has ended"})
        assert next_event(answer)[1]["ended"] == "the run has ended"
        with pytest.raises(EOFError):
            next_event(answer)


def test_a_clock_that_goes_back_begins_the_picture_anew():
    with served() as page, page.begin("/events") as answer:
        next_event(answer)
        page.frame(*map(sample, range(500, 600)))
        next_event(answer)
        page.frame(sample(0), sample(1))
        _, frame = next_event(answer)
    assert frame["restarts"]
    assert [row[0] for row in frame["rows"]] == [0.0, 0.0067]


def test_a_browser_that_was_stalled_begins_anew_with_the_whole_picture():
    stream = LiveStream(ABOUT)
    frames = stream.frames()
    next(frames)
    for k in range(KEPT_FRAMES + 1):
        stream.take(sample(k), 0.0)
        stream.publish(0.0)
    assert next(frames).startswith(b"event: whole\n")
    stream.publish(0.0)
    assert next(frames).startswith(b"event: frame\n")


@PAGE_DELAYS.mark
def test_browsers_that_read_nothing_hold_up_no_other():
    with served() as page:
        stalled = [page.begin("/events") for _ in range(20)]
        with page.begin("/events") as answer:
            next_event(answer)
            for k in range(300):
                page.frame(sample(k), {"said": "x" * 20_000})
                assert next_event(answer)[1]["rows"][0][0] == round(
                    1e-9 * k * PERIOD_NS, 4
                )
        for one in stalled:
            one.close()


@CROWDED_PAGE.mark
@pytest.mark.parametrize("sent", [b"", b"GET / HT", b"GET / HTTP/1.1\r\nHost: loc"])
def test_a_browser_gets_in_beside_connections_that_never_send_a_whole_request(sent):
    with served() as page, ExitStack() as stack:
        for _ in range(100):
            one = socket.create_connection(("127.0.0.1", page.port))
            stack.enter_context(one).sendall(sent)
        assert [page.ask("/")[0] for _ in range(3)] == [200] * 3


@CROWDED_PAGE.mark
def test_a_connection_that_sends_nothing_ends(monkeypatch):
    monkeypatch.setattr(PageHandler, "timeout", 0.05)
    with served() as page, socket.create_connection(("127.0.0.1", page.port)) as one:
        one.settimeout(60.0)
        assert one.recv(1) == b""


# -- who may ask


@pytest.mark.parametrize("path", ["/", *(f"/{name}" for name in FILES if name)])
def test_the_page_and_its_parts_come_with_a_policy_that_lets_nothing_else_in(path):
    with served() as page:
        status, content, headers = page.ask(path)
    assert status == 200
    assert content
    policy = headers["Content-Security-Policy"]
    assert policy.startswith("default-src 'none'; script-src 'self'; style-src 'self'")
    assert "unsafe" not in policy
    assert headers["X-Content-Type-Options"] == "nosniff"


@FOREIGN_BROWSER.mark
@pytest.mark.parametrize("path", ["", "page.js", "events"])
@pytest.mark.parametrize(
    "prefix", ["", "wrong/", TOKEN[:-1] + "/", TOKEN.upper() + "/", TOKEN, "%00/"]
)
def test_without_the_token_every_path_is_refused_alike(path, prefix):
    with served() as page:
        status, content, _ = page.ask(f"/{prefix}{path}", token="")
    assert status == 403
    assert b"not allowed" in content


def test_with_the_token_the_page_and_its_parts_are_there():
    with served() as page:
        statuses = [page.ask(f"/{path}")[0] for path in ("", "page.js", "nothing")]
    assert statuses == [200, 200, 404]


@pytest.mark.parametrize(
    "path", ["/../page.js", "/..%2f..%2fREADME.md", "//etc/passwd", "/a/b"]
)
def test_no_other_file_is_served(path):
    with served() as page:
        assert page.ask(path)[0] == 404


# -- the address


def test_an_address_is_a_port_or_a_host_and_a_port():
    assert read_address("8000") == ("127.0.0.1", 8000)
    assert read_address("0.0.0.0:0") == ("0.0.0.0", 0)
    assert read_address("[fe80::1]:80") == ("fe80::1", 80)


@pytest.mark.parametrize(
    "text",
    [
        "",
        ":",
        ":80",
        "x",
        "65536",
        "-1",
        "1e3",
        "٣",
        "::1:80",
        "a:b",
        "h:80:x",
    ],
)
def test_what_is_no_address_is_refused_with_examples(text):
    with pytest.raises(UsageError, match=r"no address of a page.*web:8000"):
        read_address(text)


def test_a_port_that_is_taken_and_a_host_that_is_not_ours_are_refused():
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(UsageError, match="already in use"):
            listen(str(port), TOKEN)
    with pytest.raises(UsageError, match="cannot assign"):
        listen("192.0.2.1:0", TOKEN)
    with pytest.raises(UsageError, match="no-such-host"):
        listen("no-such-host.invalid:80", TOKEN)


def test_the_process_that_serves_the_page_loads_the_standard_library_only():
    loaded = loaded_by("import holdfast.live.page.server") - loaded_by("")
    assert loaded - sys.stdlib_module_names <= {"holdfast", "core", "live"}
