"""Every number, word and switch of every text format, replaced by hostile ones: taken or refused.

Fuzzing seldom writes 1e-300 or 2^63. Here each value of each example in turn becomes each of
HOSTILE, and what reads it answers with an error of ours, or works.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from itertools import islice

import pytest
from fuzz_targets import TARGETS, Target, folder, refused, written
from hazard_marks import AMBIGUOUS
from small_model import artifact, spec

from holdfast.cli.settings import read_settings
from holdfast.core.hand_card import read_hand_card
from holdfast.edge_runtime.intent import read_intent
from holdfast.export.artifact import INDEX, read_artifact, write_artifact
from holdfast.live.cues import SHIPPED, read_cues

HOSTILE = (
    "0",
    "-1",
    "1e-300",
    "-1e300",
    "1e300",
    "1e999",
    "9223372036854775807",
    "9223372036854775808",
    "-9223372036854775809",
    "1" + 400 * "0",
    "true",
    '""',
    '"/dev/zero"',
    '"../../etc/passwd"',
    "[]",
    "[[[1]]]",
    "{}",
)
JSON_ONLY = ("null", "NaN", "-Infinity", '{"a": 1, "a": 2}')
TOML_ONLY = ("nan", "-inf", "1979-05-27")
VALUE = re.compile(
    r'"(?:[^"\\]|\\.)*"(?!\s*:)|\b(?:true|false|null)\b|-?\b\d[\d.]*(?:e[-+]?\d+)?'
)
"""A value of JSON or TOML: a text that is no key, a switch, or a number."""


def hand_card(data: bytes) -> None:
    read_hand_card(written("hand.toml", data))


def cue_table(data: bytes) -> None:
    read_cues(written("cues.toml", data))


def settings(data: bytes) -> None:
    read_settings(["run", "--config", str(written("holdfast.toml", data))])


def intent_file(data: bytes) -> None:
    read_intent(written("trial.intent.csv", data))


def artifact_index(data: bytes) -> None:
    place = folder() / "artifact"
    (place / INDEX).write_bytes(data)
    read_artifact(place)


def index() -> bytes:
    return write_artifact(folder() / "artifact", artifact(spec())).read_bytes()


HAND = b"""title = "Two pads"
[[contacts]]
name = "a"
side = "thumb"
along_mm = 0
[[contacts]]
name = "b"
side = "finger"
along_mm = -1.5
across_mm = 2
stiffness = 1.0
sensed = true
"""
READERS = {
    name: TARGETS[name]
    for name in (
        "meta",
        "truth",
        "scene",
        "protocol",
        "study_card",
        "study_journal",
        "events",
        "calibration",
        "bias",
        "sealed_card",
        "golden",
        "commands",
    )
} | {
    "hand_card": Target(hand_card, (HAND,)),
    "cue_table": Target(cue_table, (SHIPPED.read_bytes(),)),
    "settings": Target(settings, (b'model = "m.onnx"\n[sinks]\nlog = "a"\n',)),
    "intent_file": Target(
        intent_file, (b"Time,host_ns,wants,envelope1\n0.5,12,close,0.25\n",)
    ),
    "artifact": Target(artifact_index, ()),
}
TOML = ("scene", "protocol", "study_card", "hand_card", "cue_table")


THINNED = {"artifact": 48, "events": 4, "cue_table": 4, "study_journal": 3, "scene": 2}
"""Of these, which take milliseconds to read, every n-th."""


def spoilt(text: str, words: tuple[str, ...]) -> Iterator[str]:
    """The text with each of its values in turn replaced by each of the words."""
    for found in VALUE.finditer(text):
        for word in words:
            yield text[: found.start()] + word + text[found.end() :]


@AMBIGUOUS.mark
@pytest.mark.parametrize("name", READERS)
def test_a_hostile_value_is_taken_or_refused_with_an_error_of_ours(name: str) -> None:
    target = READERS[name]
    words = HOSTILE + (TOML_ONLY if name in TOML else JSON_ONLY)
    broken = []
    for seed in target.seeds or (index(),):
        texts = spoilt(seed.decode("utf-8-sig"), words)
        for text in islice(texts, 0, None, THINNED.get(name, 1)):
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                try:
                    refused(target, text.encode())
                except Exception as error:
                    broken.append(f"{error!r:.120}: {text[-300:]}")
    assert broken == []
