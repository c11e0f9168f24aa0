"""What the sections of a report share: the kind of the data, headings."""

from __future__ import annotations

import html

from holdfast.evaluation.figures import Evaluation


def kind_of(of: Evaluation) -> str:
    """The kind of the data (simulated, recorded), which stands beside every number."""
    return ", ".join(dict.fromkeys(one.card.kind for one in of.sets.values()))


def heading(of: Evaluation, title: str) -> str:
    """A section's heading with the kind of its data."""
    return f"<h2>{title} <em class=note>({html.escape(kind_of(of))})</em></h2>"
