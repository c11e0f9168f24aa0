"""The parts of a study, one after another or side by side, announced as they go by."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TypeVar

from holdfast.evaluation.jobs import Job, Workers
from holdfast.training.progress import Say

Result = TypeVar("Result")


def done(
    parts: Mapping[str, Job[Result]], workers: Workers, say: Say
) -> Iterator[Result]:
    """The results in the order of the parts. say: what begins, or side by side what is done."""
    if workers.here:
        for name, part in parts.items():
            say(name)
            yield part()
        return
    say(f"{len(parts)} parts side by side")
    for name, result in zip(parts, workers.run(list(parts.values())), strict=True):
        say(f"{name}: done")
        yield result
