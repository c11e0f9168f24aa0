"""The report: our table beside the thesis' figures."""

from __future__ import annotations

import html
from pathlib import Path

from holdfast.evaluation.formats import number
from holdfast.evaluation.page import Row, table, write_page
from studies.thesis_preliminary.cases import CASES
from studies.thesis_preliminary.figures import (
    CaseFigures,
    PreliminaryStudy,
    Repeated,
    StudiedSet,
)
from studies.thesis_preliminary.picture import accuracies
from studies.thesis_preliminary.points import KINDS
from studies.thesis_preliminary.published import (
    ACCURACY_PERCENT,
    LEARNERS,
    SHAPES,
    SOURCE,
)

BARE = (LEARNERS[1], LEARNERS[2], LEARNERS[0])
"""Learners on distances, on variances and on the order of values."""
BARE_HEADS = tuple(f"{name}: from 2 to 2, bare" for name in BARE)
LIMITS = "docs/evaluation.md"
"""Says what limits the comparison, and what the late marks and the bare ratios mean."""


def write_preliminary_report(path: Path, figures: PreliminaryStudy) -> Path:
    """Write the page; OutputError where that cannot be done."""
    sections = [_summary(figures), _table(figures), _late(figures), _made(figures)]
    return write_page(path, "Holdfast, preliminary study", sections)


def summary(figures: PreliminaryStudy) -> list[str]:
    """One line a case: accuracy in % of the random forest, published and ours."""
    lines = ["random forest, accuracy in %, published | ours"]
    for case in CASES:
        published = (
            f"{ACCURACY_PERCENT[case.published][0]:.2f}" if case.published else "-"
        )
        ours = ", ".join(
            f"{one.data} {_score(_forest(one, case.name))}" for one in figures.sets
        )
        lines.append(f"case {case.name}: {published} | {ours}")
    return lines


def _forest(one: StudiedSet, case: str) -> Repeated:
    return one.cases[case].learners[LEARNERS[0]].accuracy


def _score(score: Repeated) -> str:
    return f"{100.0 * score.mean:.1f} ± {100.0 * score.sd:.1f}"


def _summary(figures: PreliminaryStudy) -> str:
    boxes = "".join(
        f"<div><b>{'thesis ' if one is None else ''}{_first(one)}</b>"
        f"{'published' if one is None else html.escape(one.data + ': ' + one.kind)}</div>"
        for one in (None, *figures.sets)
    )
    return f"""<h1>The thesis' preliminary study, repeated: do seven samples show a risky slip?</h1>
<p class=note>Accuracy in %, random forest, case 1 (raw samples around a critical point, safe or
risky; chance 50 %). {figures.repetitions} repetitions, mean ± standard deviation.</p>
<div class=answer>{boxes}</div>
{accuracies(figures.sets)}"""


def _first(one: StudiedSet | None) -> str:
    return (
        f"{ACCURACY_PERCENT['1'][0]:.2f}" if one is None else _score(_forest(one, "1"))
    )


def _table(figures: PreliminaryStudy) -> str:
    head = "".join(f"<th>{name.replace(' ', '<br>')}" for name in LEARNERS)
    rows = [
        line
        for case in CASES
        for line in _case_rows(case.name, case.published, case.what, figures.sets)
    ]
    for one in figures.sets:
        rows.append(
            _row("warning", f"case 1, {one.data}, windows split at random", one.leaky)
        )
    return f"""<h2>The table</h2>
<p>Accuracy in %, and under it balanced accuracy. Published: {SOURCE}, mean of 5 iterations.
Simulated and real: five repetitions, equal classes, groups held out. "Window" is samples by
columns. "Chance" and "largest" are in %: one over the number of classes, and the share of the
largest class in the tests.</p>
<div class=wide><table><tr><th>case and data{head}<th>window<th>windows<th>chance<th>largest
{"".join(rows)}</table></div>"""


def _case_rows(
    name: str, published: str | None, what: str, sets: list[StudiedSet]
) -> list[str]:
    head = f"<tr><td colspan={len(LEARNERS) + 5}><br><b>case {name}</b>: {html.escape(what)}"
    ours = [
        _row("ours", f"{one.data}, {one.kind.split(',')[0]}", one.cases[name])
        for one in sets
    ]
    if published is None:
        return [head, *ours]
    return [head, _published_row(published), *ours]


def _published_row(published: str) -> str:
    cells = "".join(
        f"<td>{'-' if value is None else f'{value:.2f}'}"
        for value in ACCURACY_PERCENT[published]
    )
    shape = " x ".join(map(str, SHAPES[published]))
    return f"<tr><td>the thesis, published{cells}<td>{shape}<td><td><td>"


def _row(kind: str, name: str, case: CaseFigures) -> str:
    cells = "".join(
        f"<td>{_score(score.accuracy)}<br><small>{_score(score.balanced_accuracy)}</small>"
        for score in case.learners.values()
    )
    chance, largest = case.chance, case.largest_class.mean
    return (
        f"<tr class={kind}><td>{html.escape(name)}{cells}<td>{' x '.join(map(str, case.shape))}"
        f"<td>{case.windows}<td>{100.0 * chance:.0f}<td>{100.0 * largest:.0f}"
    )


def _late(figures: PreliminaryStudy) -> str:
    heads = (
        "set",
        "risky windows of cases 4 and 5 that end after the event began, %",
        *BARE_HEADS,
    )
    rows = [
        Row([html.escape(one.data), _percent(one.late), *_bare(one)])
        for one in figures.sets
    ]
    return f"""<h2>Late marks and bare ratios</h2>
<p>The event is the load's onset in the scene, and a rotation of 5 degrees in the recordings. "From
2 to 2, bare": accuracy in % with and without a floor under the normal force. {LIMITS} says what
follows, and what else limits the comparison.</p>
{table(heads, rows)}"""


def _percent(share: float | None) -> str:
    return number(None if share is None else 100.0 * share, 0)


def _bare(one: StudiedSet) -> list[str]:
    """Accuracy of each learner of BARE with a floor under the normal force, and without."""
    kept, bare = (one.cases[name].learners for name in ("2", "2, bare"))
    return [f"{_score(kept[n].accuracy)} to {_score(bare[n].accuracy)}" for n in BARE]


def _made(figures: PreliminaryStudy) -> str:
    lines = "".join(f"<li>{html.escape(_set_line(one))}</li>" for one in figures.sets)
    versions = ", ".join(
        f"{name} {number}" for name, number in figures.versions.items()
    )
    return f"""<h2>How this was made</h2><ul>{lines}
<li>Learners at scikit-learn's defaults, untuned; nearest neighbours and the network on standardised
features; gradient boosting is the histogram kind. Test: one of four folds of groups.</li>
<li><code>python -m studies preliminary</code>, seed {figures.seed},
{figures.seconds:.0f} s;
{html.escape(versions)}.</li></ul>"""


def _set_line(one: StudiedSet) -> str:
    points = ", ".join(f"{one.points[kind]} {kind}" for kind in KINDS)
    return (
        f"{one.data} ({one.kind}): {one.trials} trials, {one.groups} groups, "
        f"{one.sensors} sensors, {one.rate_hz:.1f} Hz; "
        f"critical points: {points}. {one.caveat}"
    )
