"""Self-checks of a model file on the machine that will run it.

Each check is a statement that must hold, with a figure. The input is made by formula (golden.py),
never from a recording. All checks together take some fifteen thousand steps, a few seconds on a
small board.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from holdfast.edge_runtime.check_result import CheckResult
from holdfast.edge_runtime.errors import HoldfastError
from holdfast.edge_runtime.golden import golden_answers, golden_from_json
from holdfast.edge_runtime.graph_checks import (
    check_corrupted_samples,
    check_large_offset,
    check_one_against_many,
    check_reset,
    check_silence_and_memory,
    check_votes,
)
from holdfast.edge_runtime.model_file import GOLDEN_KEY
from holdfast.edge_runtime.monitor import Model
from holdfast.edge_runtime.monitor_checks import (
    check_clock,
    check_decision,
    check_unbelievable,
    check_unknown,
)


def self_checks(path: str | Path) -> Iterator[CheckResult]:
    """All checks of a model file, each as soon as it is done.

    A file that cannot be opened fails the first check, and no other check follows.
    """
    try:
        model = Model(path)
    except HoldfastError as error:
        yield CheckResult("seal, card and golden rows", False, f"{type(error).__name__}: {error}")
        return
    yield _golden(model)
    for check in CHECKS:
        try:
            yield from check(model)
        # a check that raises has failed, and the others still run
        except Exception as error:
            yield CheckResult(
                check.__name__.strip("_").removeprefix("check_").replace("_", " "),
                False,
                f"{type(error).__name__}: {error}",
            )


def _golden(model: Model) -> CheckResult:
    """Opening the file has compared the golden rows already; this reports how close they are."""
    card = model.card
    stored = golden_from_json(model.session.get_modelmeta().custom_metadata_map[GOLDEN_KEY])
    answers = golden_answers(model.session, card.n_channels, card.unit, card.settle_samples)
    worst = max(
        float(np.abs(answers[name].astype(float) - stored[name].astype(float)).max())
        for name in stored
    )
    rows = len(next(iter(stored.values())))
    return CheckResult(
        "seal, card and golden rows",
        True,
        f"{rows} rows of {len(stored)} outputs, off by {worst:.1e}",
    )


CHECKS: tuple[Callable[[Model], Iterator[CheckResult]], ...] = (
    check_one_against_many,
    check_corrupted_samples,
    check_silence_and_memory,
    check_reset,
    check_votes,
    check_unknown,
    check_unbelievable,
    check_decision,
    check_large_offset,
    check_clock,
)
