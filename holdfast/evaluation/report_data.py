"""Sections of a report on its data: real recordings, the sets, their limits, how it was made."""

from __future__ import annotations

import html

from holdfast.core.contract import SITUATIONS
from holdfast.evaluation.camera import onsets_in_words
from holdfast.evaluation.figures import Evaluation
from holdfast.evaluation.formats import number
from holdfast.evaluation.page import Row, shown, table
from holdfast.evaluation.real_sets import (
    HUMAN,
    EfleshFigures,
    RealFigures,
    RealSetsMissing,
)
from holdfast.evaluation.report_methods import method_tables
from holdfast.evaluation.scored_set import SetCard
from holdfast.training.figures import LevelF1, over

SIMULATED = (
    "Simulated: objects, hands, people (styles are ranges of parameters, not people), sensors, and "
    "so every force; the truth beside each trial is the state of the simulation."
)
LIMITS = (
    "A simulated fingertip is not a real one: these figures do not show how the file does on a "
    "hand it was not trained on. Train and evaluate on your own recordings before it moves "
    "anything.",
    "Grips fail far more often in these sets than in life; false alarms an hour are those of a "
    "hand that grasps something every few seconds.",
    "An alarm holds until the load falls. So one false alarm costs the rest of its grasp, and an "
    "event in it is missed (already on).",
    "Delays are in sample time: from load onset by the truth to the sample of the decision. "
    "docs/hand.md says what a bus and a processor add.",
    "Intervals over styles are over three ranges of parameters at most. Intervals over trials do "
    "not cover what no scene varies.",
)


def real_section(real: RealFigures | RealSetsMissing | None) -> str:
    """The figures of real recordings, or how to get them."""
    if real is None:
        return ""
    if isinstance(real, RealSetsMissing):
        next_step, why = html.escape(real.next_step), html.escape(real.why or "")
        return f"<h2>Real recordings</h2><p>{next_step}. {why}</p>"
    (one,) = real.human.sets.values()
    card, states = one.card, one.states
    calibrated = states.calibration
    ece, ece_risky = (
        (calibrated.ece, calibrated.ece_risky) if calibrated else (None, None)
    )
    parts = {f"{HUMAN}, unseen people": (one.rows, one.mcnemar)}
    return f"""<h2>Real recordings <em class=note>({html.escape(card.kind)})</em></h2>
<p>{card.recordings} trials of {card.groups} people on whom this file (of <code>make real</code>, at
{card.rate_hz:.1f} Hz) was not trained, {html.escape(real.note)}. The baselines are matched on the
very same trials, which flatters them. A risky event is a rotation of the object that passes 15
degrees ("gross slip"); its onset is where it passes 5, later than the load's. A "voluntary action"
here is a rotation that turns back before 15 degrees; no intention is known.
{html.escape(card.caveat)} The forces are not known, so there is no closing hand.</p>
{method_tables(parts)}
<p>Changes of state a second {number(states.changes_per_s)} (truth
{number(states.true_changes_per_s)}); calibration error {number(ece, 3)}, of risky
{number(ece_risky, 3)}; macro F1 over four situations per sample
{_macro_f1(states.confusion["four"])}, at windows
{_macro_f1(one.windows.heads.situations)}.</p>
{_eflesh(real.eflesh)}"""


def _macro_f1(of: LevelF1) -> str:
    return f"{number(of.macro_f1, 3)} {over(of.f1)}".rstrip()


def _eflesh(figures: EfleshFigures | None) -> str:
    if figures is None:
        return ""
    rows = "".join(
        f"{name}: {_ms(one.p50)} ms ({_ms(one.p5)} to {_ms(one.p95)}) after the field departs, "
        f"{figures.held_trials_with_an_alarm[name]} held trials with an alarm; "
        for name, one in figures.delay_s.items()
    )
    return f"""<h3>eflesh_slip</h3><p>From <code>make real</code>, blocks held out,
{figures.n_trials} trials: {rows} {html.escape(figures.caveat)}</p>"""


def _ms(seconds: float | None) -> str:
    return number(None if seconds is None else 1e3 * seconds, 0)


def data_section(of: Evaluation) -> str:
    """The sets, what is simulated, and the limits of all figures."""
    heads = (
        "set",
        "description and card",
        "kind and rate",
        "recordings",
        "minutes",
        "risky events",
        "seed",
        "recordings trained on",
    )
    rows = [
        Row([html.escape(name), *_card_cells(one.card)])
        for name, one in of.sets.items()
    ]
    cards = {name: one.card for name, one in of.sets.items()}
    effects = "; ".join(
        f"{html.escape(name)}: {html.escape(', '.join(card.made_from.get('effects') or ['none']))}"
        for name, card in cards.items()
    )
    caveats = " ".join(dict.fromkeys(card.caveat for card in cards.values()))
    onsets = " ".join(
        f"{html.escape(name)}: {html.escape(words)}."
        for name, card in cards.items()
        if (words := onsets_in_words(card.onsets_by))
    )
    limits = "".join(f"<li>{html.escape(one)}</li>" for one in LIMITS)
    return f"""<h2>The data, what is simulated and what is real, and limits</h2>
{table(heads, rows)}
<p class=note>Effects: {effects}. {html.escape(caveats)} {onsets}</p>
<p>{html.escape(SIMULATED)} Real: what stands under "Real recordings", the published figures of the
hand, and the thesis' words.</p>
<ul>{limits}</ul>"""


def _card_cells(card: SetCard) -> list[str]:
    title, sha = (
        str(card.made_from.get(name, "")) for name in ("title", "card_sha256")
    )
    look = "display:block;text-align:left;white-space:normal"
    return [
        f"<span style='{look}'>{html.escape(title)} {html.escape(sha[:12])}</span>",
        f"{html.escape(card.kind)}, {card.rate_hz:g} Hz",
        f"{card.recordings}",
        f"{card.minutes:.1f}",
        f"{card.events}",
        f"{card.made_from.get('seed', '')}",
        f"{card.trained_on_recordings}",
    ]


def how_made(of: Evaluation) -> str:
    """Command, seed, rules and thresholds."""
    thresholds = of.thresholds
    rules = ", ".join(
        f"{name} {value}" for name, value in thresholds.rules.to_json().items()
    )
    least = "; ".join(
        f"{html.escape(shown(name))}: {permille} of 1000"
        for name, permille in thresholds.confidences.items()
    )
    return f"""<h2>How this was made</h2>
<p><code>holdfast evaluate</code>, seed {of.seed}; decision rules of the card:
{html.escape(rules)}; least confidence: {least}. Votes for {len(of.model.votes_for)} classes, of
{", ".join(SITUATIONS)}.</p>"""
