"""holdfast.c, holdfast.h and holdfast_selftest.c of a graph, as text."""

from __future__ import annotations

from dataclasses import dataclass

from holdfast.export.c.compiled import Compiled
from holdfast.export.c.graph import Graph
from holdfast.export.c.hand import constants
from holdfast.export.c.selftest import selftest_source
from holdfast.export.c.templates import snippets, template
from holdfast.export.c.words import words_of

HAND_FILES = ("friction.c", "controller.c", "supervisor.c", "grip.c")


@dataclass(frozen=True)
class CSource:
    """The text of every file by its name, and the memory of one hand, in bytes."""

    files: dict[str, str]
    state_bytes: int
    table_bytes: int
    stack_bytes: int


def c_source(graph: Graph) -> CSource:
    """Compile a graph. Raises NotCompilable."""
    compiled = Compiled(graph)
    words = words_of(graph, compiled)
    files = {
        "holdfast.c": _source(compiled, words),
        "holdfast.h": template("header.h", words),
        "holdfast_selftest.c": selftest_source(graph, words),
    }
    return CSource(
        files, compiled.state_bytes, compiled.tables.n_bytes, compiled.stack_bytes
    )


def _source(compiled: Compiled, words: dict[str, object]) -> str:
    parameters = (
        "double *state, const double *sample, const uint8_t *valid, float *features"
    )
    steps, body = compiled.sense
    answers, answer_body = compiled.answer
    generated = [
        compiled.tables.text(),
        steps,
        f"static void hf_sense({parameters}, holdfast_out *out) {{\n{body}\n}}\n",
        answers,
        f"void holdfast_answer(const float *features, holdfast_out *out) {{\n{answer_body}\n}}\n",
    ]
    hand = [constants(), *(template(name, words) for name in HAND_FILES)]
    parts = [
        *generated,
        template("step.c", words),
        template("decision.c", words),
        *hand,
    ]
    return "\n".join(
        [template("begin.c", words), snippets(f"{steps}\n{answers}"), *parts]
    )
