"""The report of one evaluation: the answer, trials as they went by, tables beside what hurts, what
it does not say."""

from __future__ import annotations

import html
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from edge_runtime.contract import SITUATIONS
from evaluation import pictures as draw
from evaluation.baselines import INTENT
from evaluation.camera import onsets_in_words
from evaluation.closing_hand import CLOSING_S, LAG_S, MOST_N, STROKE_MM
from evaluation.evaluate import DEPLOYED, Evidence
from evaluation.outcomes import COLUMNS, STYLES, THESIS
from evaluation.page import key, write_page
from evaluation.style import SITUATION_COLOURS

HEADS = (
    "risky events",
    "found",
    "false alarms a minute",
    "an hour",
    "act after load onset, ms",
    "lead left, ms",
    "lead used",
    "before gross slip",
    "safe acts called",
    "drops prevented",
    "McNemar p",
)
SIMULATED = (
    "Simulated: the objects, the hands, the people (styles are ranges of parameters, not people), the sensors and so "
    "every force; the truth beside each trial is the simulation's own state."
)
CLOSE = """<style>table.close th{white-space:normal} table.close .note{font-size:.7rem}
table.close td{vertical-align:top}
table.close th,table.close td{padding:.3rem} table.close td:first-child{min-width:7rem} .answer{gap:2rem}</style>"""
"""Wide tables: heads may break, intervals stand in small below their values."""
LIMITS = (
    "A simulated fingertip is no fingertip: nothing here says how the file does on a hand it never met. Train and "
    "evaluate on your own recordings before it moves anything.",
    "Grips fail far oftener in these sets than in life; false alarms an hour are those of a hand that grasps something "
    "every few seconds.",
    "An alarm holds until the load falls, so one false alarm costs the rest of its grasp, and an event in it is missed "
    "(already on).",
    "Delays are in sample time: from the truth's load onset to the sample at which the decision was made. What a bus and "
    "a processor add is in docs/hand.md.",
    "Intervals over styles are over three ranges of parameters at most; over trials they do not cover what no scene varies.",
)


def write_event_report(path: Path, evidence: Evidence) -> Path:
    """Write the report; OutputError where that cannot be done."""
    sections = (
        _answer,
        _timelines,
        _tables,
        _distributions,
        _camera,
        _safe_and_specific,
        _closing,
        _states,
        _outcomes,
        _real,
        _data,
        _made,
    )
    texts = [text for section in sections if (text := section(evidence))]
    return write_page(path, "Holdfast, evaluation", [CLOSE, *texts])


def kind_of(evidence: Evidence) -> str:
    """What stands beside every number."""
    kinds = dict.fromkeys(one["data"]["kind"] for one in evidence.figures["sets"].values())
    return ", ".join(kinds)


def _head(evidence: Evidence, title: str) -> str:
    return f"<h2>{title} <em class=note>({html.escape(kind_of(evidence))})</em></h2>"


def _headline(evidence: Evidence) -> str:
    return str(evidence.figures["thresholds"]["headline"])


def _answer(evidence: Evidence) -> str:
    figures, name = evidence.figures, _headline(evidence)
    row, kind = figures["all"]["rows"][name], html.escape(kind_of(evidence))
    deployed = figures["all"]["rows"][DEPLOYED]
    safe = row["safe_acts_called"]
    boxes = (
        (
            _share(row["recall"]),
            f"of {row['events']} risky events found",
            _range(row["recall_ci"], percent=True),
        ),
        (_number(row["false_per_min"]), "false alarms a minute", _range(row["false_per_min_ci"])),
        (
            _share(safe["share"]),
            f"of {safe['n']} safe acts called risky",
            _range(safe["share_ci"], percent=True),
        ),
        (_ms(row["delay_ms"], "p50"), "ms from load onset to act", "median"),
    )
    shown = "".join(
        f"<div><b>{value}</b>{label}<br><span class=note>{' &middot; '.join(filter(None, (below, kind)))}</span></div>"
        for value, label, below in boxes
    )
    trained = figures["model"]["trained_on"] or "nobody says what"
    as_deployed = (
        ""
        if name == DEPLOYED
        else (
            f" As deployed (no threshold of its own) it finds {_share(deployed['recall'])} at "
            f"{_number(deployed['false_per_min'])} false alarms a minute."
        )
    )
    return f"""<h1>Does it tell a failing grip from a willing hand? Whole streams, every number {kind}</h1>
<p><strong>{_first_sentence(row)} {_second_sentence(row)}</strong></p>
<div class=answer>{shown}</div>
<p>Threshold: {html.escape(figures["thresholds"]["how"])}.{as_deployed}{_beaten(figures, name)}</p>
<p class=note>Model {figures["model"]["model_id"]} at {figures["model"]["rate_hz"]:g} Hz, trained on {html.escape(str(trained))};
{len(figures["sets"])} sets, {row["minutes"]:.0f} minutes, every sample answered by the file itself from a fresh state.
{html.escape(SIMULATED) if "simulated" in kind else ""} Intervals are 95 %, over trials (bootstrap) or exact (shares of acts).</p>
{_warnings(evidence)}"""


def _beaten(figures: dict[str, Any], headline: str) -> str:
    """What stands beside ours and finds more, said where nobody can miss it."""
    ours, against = figures["all"]["rows"][headline], figures["all"]["mcnemar"]
    better = [
        f" <strong>The {html.escape(name)} does better at finding:</strong> {_share(row['recall'])} at "
        f"{_number(row['false_per_min'])} false alarms a minute and {_share(row['safe_acts_called']['share'])} of the safe acts "
        f"called (McNemar p {_p(against[name])})."
        for name, row in figures["all"]["rows"].items()
        if name in against and name != INTENT and (row["recall"] or 0.0) > (ours["recall"] or 0.0)
    ]
    return "".join(better)


def _warnings(evidence: Evidence) -> str:
    seen = [
        (name, one["data"])
        for name, one in evidence.figures["sets"].items()
        if one["data"]["trained_on_recordings"]
    ]
    return "".join(
        f"<p class=note><strong>Warning:</strong> the model was trained on {data['trained_on_recordings']} of the "
        f"{data['recordings']} recordings of {html.escape(name)}; its figures flatter.</p>"
        for name, data in seen
    )


def _first_sentence(row: dict[str, Any]) -> str:
    if not row["events"]:
        return f"No grip fails in these streams; the hand was asked to act {row['false_alarms']} times for nothing."
    delay = row["delay_ms"]
    when = f", a median of {delay['p50']:.0f} ms after the load's onset" if delay else ""
    return (
        f"Of {row['events']} grips that fail the hand is asked to act in {row['found']} ({_share(row['recall'])}){when}, at "
        f"{_number(row['false_per_min'])} false alarms a minute, and {_share(row['safe_acts_called']['share'])} of the "
        "hand-overs and put-downs are called risky."
    )


def _second_sentence(row: dict[str, Any]) -> str:
    closing = row["closing"]
    if closing is None or not closing["modelled"]:
        return "Whether a closing hand would have held them cannot be said of these recordings."
    return (
        f"A hand that closes as a Michelangelo does would still hold {closing['kept']} of the {closing['preventable']} "
        f"objects that such a hand can hold at all; {closing['not_preventable']} of {closing['modelled']} it would lose even "
        "if it knew at load onset."
    )


def _timelines(evidence: Evidence) -> str:
    if not evidence.shown:
        return ""
    first, kind = next(iter(evidence.figures["sets"])), kind_of(evidence)
    parts = "".join(
        f"<h3>{html.escape(title)}</h3>{draw.timelines(rows, kind)}"
        for title, rows in evidence.shown.items()
    )
    return f"""{_head(evidence, "Trials as they went by")}
<p class=key>The first trials of {html.escape(first)}, an object in turn, one row a trial. Behind, in pale colour from edge to
edge, what was; in front, what the file said at every sample (hatched: unknown, settling); a triangle is where the hand is
asked to act. {key(SITUATION_COLOURS)}</p>{parts}"""


def _tables(evidence: Evidence) -> str:
    figures = evidence.figures
    told = figures["thresholds"]["rivals"]
    laws = "; ".join(
        f"<b>{html.escape(name)}</b>: {html.escape(one['law'])}, here {one['setting']:.3g}"
        + ("" if one["fits"] else ", which is still too many false alarms")
        for name, one in told.items()
    )
    parts = (
        [("all sets", figures["all"]), *figures["sets"].items()]
        if len(figures["sets"]) > 1
        else [*figures["sets"].items()]
    )
    rows = "\n".join(line for name, one in parts for line in _rows(name, one))
    heads = "".join(f"<th>{name}" for name in HEADS)
    return f"""{_head(evidence, "What it stands beside")}
<p>An alarm finds an event if it begins between the load's onset and the loss of contact, give or take 20 ms; one that was on
before finds nothing. Rivals ask at once, through the same decision, only while something is held, each at our rate of false
alarms on {html.escape(", ".join(figures["thresholds"]["matched_on"]))}, which need not be theirs here. McNemar's exact test
compares, event by event, our first line with each.</p>
<p class=note>{laws}.</p>
<div class=wide><table class=close><tr><th>{html.escape(kind_of(evidence))}{heads}
{rows}</table></div>
{_wide_collar(evidence)}"""


def _rows(name: str, one: dict[str, Any]) -> Iterator[str]:
    yield f"<tr><th colspan={len(HEADS) + 1} style='text-align:left;padding-top:.9rem'>{html.escape(name)}"
    for line, row in one["rows"].items():
        against = one["mcnemar"].get(line)
        style = "ours" if line.startswith("ours") else "warning" if line == INTENT else ""
        yield (
            f"<tr class='{style}'><td>{html.escape(line)}<td>{row['events']}"
            f"<td>{_two(_share(row['recall']), _range(row['recall_ci'], percent=True))}"
            f"<td>{_two(_number(row['false_per_min']), _range(row['false_per_min_ci']))}"
            f"<td>{_number(row['false_per_hour'], 0)}<td>{_spread(row['delay_ms'])}<td>{_spread(row['lead_ms'])}"
            f"<td>{_percents(row['lead_used'])}<td>{_share(row['in_time'])}"
            f"<td>{_two(_share(row['safe_acts_called']['share']), _range(row['safe_acts_called']['share_ci'], percent=True))}"
            f"<td>{_kept(row['closing'])}<td>{_p(against)}"
        )


def _wide_collar(evidence: Evidence) -> str:
    rows = evidence.figures["all"]["rows"]
    told = "; ".join(
        f"{html.escape(name)} {_share(row['collar_40_ms']['recall'])} at {_number(row['collar_40_ms']['false_per_min'])}"
        for name, row in rows.items()
    )
    return f"<p class=note>At a collar of 40 ms, found and false a minute, all sets: {told}.</p>"


def _distributions(evidence: Evidence) -> str:
    if not evidence.timed:
        return ""
    return f"""{_head(evidence, "How late, and how much time was left")}
<p>Of the events found: from the load's onset to the first sample called risky_slip and to the request to act; and of the lead
there was, from load onset to gross slip, what was left when the hand was asked (below 0: it slid already).</p>
{draw.distributions(evidence.timed, kind_of(evidence))}"""


def _camera(evidence: Evidence) -> str:
    """Alarms against the slip as a camera saw it, beside the scene's truth of the same events."""
    told = [
        (name, line, row["camera"])
        for name, one in evidence.figures["sets"].items()
        for line, row in one["rows"].items()
        if row["camera"] is not None
    ]
    if not told:
        return ""
    rows = "".join(
        f"<tr class='{'ours' if line.startswith('ours') else ''}'><td>{html.escape(name)}: {html.escape(line)}<td>{seen['onsets']}"
        f"<td>{seen['found']} of {seen['events']}<td>{_spread(seen['delay_ms'])}<td>{_spread(seen['lead_ms'])}"
        + "".join(
            f"<td>{_spread((seen['truth'] or {}).get(key))}"
            for key in ("delay_ms", "lead_ms", "start_off_ms", "gross_off_ms")
        )
        for name, line, seen in told
    )
    sd = ", ".join(
        f"{html.escape(name)} {_ms(seen['start_sd_ms'], 'p50')} ms"
        for name, line, seen in told
        if line == _headline(evidence)
    )
    return f"""{_head(evidence, "By a camera, and by the truth")}
<p>A camera beside the hand saw the object begin to move in it, and go a fixed distance; no tactile sample had a say in that. Left
the alarm against these two; right, where a scene knows them, against the first part that slid and gross slip, and how far the
camera's times are off. ms, median and 5 to 95 %; a delay below 0 is an alarm before the object moved. Its start is known to
(standard deviation, median) {sd}. Soft pads let an object move before anything slips: a start may come early, and the lead to
it look short.</p>
<div class=wide><table class=close><tr><th>line<th>onsets seen<th>events found<th>camera: act after the start<th>camera: lead left to
gross slip<th>truth: act after the first sliding<th>truth: lead left to gross slip<th>camera less truth, start<th>gross
{rows}</table></div>"""


def _safe_and_specific(evidence: Evidence) -> str:
    name = _headline(evidence)
    sets = {key: one["rows"][name] for key, one in evidence.figures["sets"].items()}
    acts = "".join(
        f"<tr><td>{html.escape(which)}<td>{html.escape(action or 'not stated')}<td>{one['n']}<td>{_share(one['share'])}"
        f"<td>{_range(one['share_ci'], percent=True)}"
        for which, row in sets.items()
        for action, one in row["safe_acts_by_action"].items()
    )
    rows = evidence.figures["all"]["rows"]
    asked = rows[name]["specificity"] or {}
    holds = "".join(
        f"<tr><td>{html.escape(line)}"
        + "".join(
            f"<td>{_two(_share(one['share']), _range(one['share_ci'], percent=True))}"
            for one in row["specificity"].values()
        )
        for line, row in rows.items()
        if asked
    )
    kinds = "".join(
        f"<th>{kind}: {one['n']} held, {one['failed']} failed" for kind, one in asked.items()
    )
    specific = (
        f"""<h3>Holds that are disturbed</h3>
<p>Grip (dFn), load (dFt) or motor (dq) disturbed three times; specific: no alarm from the first sample to the last, of the
holds that held. Those that truly failed are events and no false alarms.</p>
<div class=wide><table class=close><tr><th>no alarm, of those that held{kinds}
{holds}</table></div>"""
        if holds
        else ""
    )
    return f"""{_head(evidence, "Left alone what should be")}
<h3>Hand-overs and put-downs called risky</h3>
<p>{html.escape(name)}: the hand was asked to act at some sample of the voluntary act.</p>
<div class=wide><table class=close><tr><th>set<th>action<th>acts<th>called<th>95 %, exact
{acts}</table></div>{_styles(evidence)}{specific}"""


def _styles(evidence: Evidence) -> str:
    told = evidence.figures["all"]["rows"][_headline(evidence)]["by_style"]
    if not told:
        return ""
    rows = "".join(
        f"<tr><td>{html.escape(STYLES.get(name, name))}<td>{one['events']}<td>{_share(one['recall'])}"
        f"<td>{_range(one['recall_ci'], percent=True)}<td>{_number(one['false_per_min'])}<td>{_range(one['false_per_min_ci'])}"
        f"<td>{_share(one['safe_acts_called']['share'])}<td>{_range(one['safe_acts_called']['share_ci'], percent=True)}"
        for name, one in told["styles"].items()
    )
    return f"""<h3>By style</h3><p>Drawn over styles instead of trials, the intervals are {_range(told["recall_ci"], percent=True)}
for the events found and {_range(told["false_per_min_ci"])} for the false alarms a minute.</p>
<div class=wide><table class=close><tr><th>style, all sets<th>events<th>found<th>95 %<th>false a minute<th>95 %<th>safe acts called<th>95 %, exact
{rows}</table></div>"""


def _closing(evidence: Evidence) -> str:
    sets = {name: one for name, one in evidence.figures["sets"].items() if one["closing"]}
    if not sets:
        return ""
    headline = _headline(evidence)
    rows = "".join(
        f"<tr><td>{html.escape(name)}<td>{of['modelled']}<td>{of['preventable']}<td>{of['not_preventable']}<td>{of['kept']}"
        f"<td>{_share(of['kept_share'])}<td>{of['kept_without_a_slip']}"
        + "".join(
            f"<td>{o['kept']} of {o['preventable']}" for o in one["closing"]["by_lag_ms"].values()
        )
        + f"<td>{_error(one['closing']['model_error_ms'])}"
        for name, one in sets.items()
        for of in (one["rows"][headline]["closing"],)
    )
    lags = "".join(f"<th>lag {lag} ms" for lag in next(iter(sets.values()))["closing"]["by_lag_ms"])
    return f"""{_head(evidence, "Would a closing hand have held it?")}
<p>A model, not a measurement: the hand closes {STROKE_MM:g} mm in {CLOSING_S:g} s (published for the Michelangelo), behind a lag of
{1e3 * LAG_S:g} ms (assumed; other columns have others), to at most {MOST_N:g} N; the object is one mass on one line between the
puller, or its weight, and the friction of the grip. Preventable: a hand that is asked at load onset would keep it. A pull of
25 to 50 N on a grip of a few newtons is over in some 50 ms, and no such hand can hold it; a falling object takes longer.
What the model makes of a hand that does nothing is off the truth's slip by so many ms (median, 5 to 95 %).</p>
<div class=wide><table class=close><tr><th>set<th>drops<th>preventable<th>not preventable<th>prevented by ours<th>share<th>without a slip{lags}
<th>model's slip, ms off
{rows}</table></div>"""


def _error(told: dict[str, float] | None) -> str:
    if not told or "p50" not in told:
        return "none"
    return _two(f"{told['p50']:.0f}", f"{told['p5']:.0f} to {told['p95']:.0f}")


def _states(evidence: Evidence) -> str:
    figures = evidence.figures
    rows = "".join(
        f"<tr><td>{html.escape(name)}<td>{_spread(states['to_risky_state_ms'])}<td>{_number(states['changes_per_s'])}"
        f"<td>{_number(states['true_changes_per_s'])}<td>{_share(states['safe_acts_state_called']['share'])}"
        f"<td>{_number(calibrated['ece'], 3)}<td>{_number(calibrated['ece_risky'], 3)}"
        + "".join(
            f"<td>{_f1(states['confusion'].get(level))}" for level in ("four", "seven", "eight")
        )
        + f"<td>{_number(one['windows']['situations']['macro_f1'], 3)}"
        for name, one in figures["sets"].items()
        for states, calibrated in (
            (one["states"], one["states"]["calibration"] or {"ece": None, "ece_risky": None}),
        )
    )
    first, one = next(iter(figures["sets"].items()))
    drawn = [
        f"<div><p class=note>{level} classes, {html.escape(first)}</p>{draw.confusion(told, kind_of(evidence))}</div>"
        for level, told in sorted(
            one["states"]["confusion"].items(), key=lambda pair: len(pair[1]["classes"])
        )
    ]
    answered = {name: one for name, one in figures["sets"].items() if one["states"]["calibration"]}
    if answered:
        drawn.insert(
            1,
            f"<div><p class=note>calibration</p>{draw.reliability(answered, kind_of(evidence))}</div>",
        )
    return f"""{_head(evidence, "The states themselves")}
<p>Per sample of every labelled phase, in natural proportion, unless said. A state is a single sample's answer, before any
debounce; its changes a second stand beside the truth's own. Seven classes count nothing once: light and heavy are one signal
there, and eight cannot be told.</p>
<div class=wide><table class=close><tr><th>set<th>first risky state, ms<th>changes a second<th>in truth<th>safe acts with a risky sample
<th>calibration error<th>of risky<th>4, F1<th>7, F1<th>8, F1<th>4, F1 at windows
{rows}</table></div>
<div class=side>{"".join(drawn)}</div>"""


def _f1(level: dict[str, Any] | None) -> str:
    return (
        ""
        if level is None
        else _two(_number(level["macro_f1"], 3), _range(level["macro_f1_ci"], places=3))
    )


def _outcomes(evidence: Evidence) -> str:
    table = {
        (row["object"], row["style"], row["action"]): row for row in evidence.figures["outcomes"]
    }
    if not table:
        return ""
    styles = [style for style in STYLES if any(key[1] == style for key in table)]
    over = "".join(f"<th colspan={len(COLUMNS)}>{STYLES[style]}" for style in styles)
    heads = "".join(f"<th>{column}" for _ in styles for column in COLUMNS)
    lines = "\n".join(
        f"<tr><td>{html.escape(name)}"
        + "".join(_cell(table.get((name, style, column))) for style in styles for column in COLUMNS)
        for name in THESIS
    )
    return f"""{_head(evidence, "The thesis' table of outcomes, side by side")}
<p>Left the thesis' word, right ours, with our count of trials. ok: recognised in every trial; part: in some; no: in none. A pull
or fall is recognised where the hand was asked to act in it and never else; a hand-over or put-down where safe_slip was said in it
and the hand was never asked to act. <strong>Ours are simulated</strong> styles of the same names, many trials each, where the
thesis shows a few of real people; "every" is harder to reach for sixty trials than for three.</p>
<div class=wide><table class=close><tr><th>thesis / ours (simulated){over}<tr><th>{heads}
{lines}</table></div>"""


def _cell(row: dict[str, Any] | None) -> str:
    if row is None:
        return "<td>"
    words = f"{row['thesis']} / <b>{row['ours']}</b>"
    counted = f"{row['recognised']} of {row['trials']}"
    return f"<td>{_two(words, counted)}"


def _real(evidence: Evidence) -> str:
    told = evidence.figures.get("real")
    if told is None:
        return ""
    if "next" in told:
        return f"<h2>Real recordings</h2><p>{html.escape(told['next'])}. {html.escape(told.get('why', ''))}</p>"
    human = told["human_slip_uskin"]
    (one,) = human["sets"].values()
    heads = "".join(f"<th>{name}" for name in HEADS)
    rows = "\n".join(_rows("human_slip_uskin, people never met", one))
    states = one["states"]
    return f"""<h2>Real recordings <em class=note>({html.escape(one["data"]["kind"])})</em></h2>
<p>{one["data"]["recordings"]} trials of {one["data"]["groups"]} people whom this file (of <code>make real</code>, at
{one["data"]["rate_hz"]:.1f} Hz) never met, {html.escape(told["note"])}; rivals are matched on the very same trials, which flatters them. A risky event
is a rotation of the object that passes 15 degrees ("gross slip"), its onset where it passes 5, later than the load's; a "safe act" is
one that turns back before 15, and nobody's intention. {html.escape(one["data"]["caveat"])} Nothing is known of the forces behind it,
so no closing hand.</p>
<div class=wide><table class=close><tr><th>real{heads}
{rows}</table></div>
<p>Changes of state a second {_number(states["changes_per_s"])} (truth {_number(states["true_changes_per_s"])}); calibration error
{_number(states["calibration"]["ece"], 3)}, of risky {_number(states["calibration"]["ece_risky"], 3)}; macro F1 over four situations per
sample {_number(states["confusion"]["four"]["macro_f1"], 3)}, at windows {_number(one["windows"]["situations"]["macro_f1"], 3)}.</p>
{_eflesh(told.get("eflesh_slip"))}"""


def _eflesh(told: dict[str, Any] | None) -> str:
    if told is None:
        return ""
    rows = "".join(
        f"{name}: {1e3 * one['p50']:.0f} ms ({1e3 * one['p5']:.0f} to {1e3 * one['p95']:.0f}) after the field departs, "
        f"{told['held_trials_with_an_alarm'][name]} held trials with an alarm; "
        for name, one in told["delay_s"].items()
    )
    return f"""<h3>eflesh_slip</h3><p>From <code>make real</code>, blocks held out, {told["n_trials"]} trials: {rows}
{html.escape(told["caveat"])}</p>"""


def _data(evidence: Evidence) -> str:
    rows = "".join(
        f"<tr><td>{html.escape(name)}<td style='text-align:left;white-space:normal'>{html.escape(str(data.get('title', '')))}"
        f"<td>{html.escape(data['kind'])}<td>{data['recordings']}<td>{data['minutes']:.1f}<td>{data['events']}<td>{data.get('seed', '')}"
        f"<td>{data['rate_hz']:g}<td>{html.escape(str(data.get('card_sha256', ''))[:12])}<td>{data['trained_on_recordings']}"
        for name, one in evidence.figures["sets"].items()
        for data in (one["data"],)
    )
    effects = "; ".join(
        f"{html.escape(name)}: {html.escape(', '.join(one['data'].get('effects') or ['none told']))}"
        for name, one in evidence.figures["sets"].items()
    )
    limits = "".join(f"<li>{html.escape(one)}</li>" for one in LIMITS)
    caveats = " ".join(
        dict.fromkeys(one["data"]["caveat"] for one in evidence.figures["sets"].values())
    )
    onsets = " ".join(
        f"{html.escape(name)}: {html.escape(words)}."
        for name, one in evidence.figures["sets"].items()
        if (words := onsets_in_words(one["data"]))
    )
    return f"""<h2>The data, what is simulated and what is real, and limits</h2>
<div class=wide><table class=close><tr><th>set<th style='text-align:left'>what<th>kind<th>recordings<th>minutes<th>risky events<th>seed<th>Hz<th>card<th>trained on
{rows}</table></div>
<p class=note>Effects: {effects}. {html.escape(caveats)} {onsets}</p>
<p>{html.escape(SIMULATED)} Real: what stands under "Real recordings", the published figures of the hand, and the thesis' words.</p>
<ul>{limits}</ul>"""


def _made(evidence: Evidence) -> str:
    figures = evidence.figures
    rules = ", ".join(f"{name} {value}" for name, value in figures["thresholds"]["rules"].items())
    lines = "; ".join(
        f"{html.escape(name)}: {one['min_risky_permille']} of 1000"
        for name, one in figures["thresholds"]["lines"].items()
    )
    return f"""<h2>How this was made</h2>
<p><code>holdfast evaluate</code>, seed {figures["seed"]}; decision rules of the card: {html.escape(rules)}; least confidence:
{lines}. Votes for {len(figures["model"]["votes_for"])} classes, of {", ".join(SITUATIONS)}.</p>"""


def _number(value: float | None, places: int = 2) -> str:
    return "none" if value is None else f"{value:.{places}f}"


def _share(value: float | None) -> str:
    return "none" if value is None else f"{100 * value:.1f} %"


def _range(interval: list[float] | None, *, percent: bool = False, places: int = 2) -> str:
    if not interval:
        return ""
    return " to ".join(
        f"{100 * edge:.1f}" if percent else f"{edge:.{places}f}" for edge in interval
    )


def _ms(spread: dict[str, float] | None, which: str) -> str:
    return "none" if spread is None else f"{spread[which]:.0f}"


def _two(value: str, below: str) -> str:
    """A value, and in small below it what it may be between."""
    return f"{value}<br><span class=note>{below}</span>" if below else value


def _spread(spread: dict[str, float] | None) -> str:
    """The median; below it 5 to 95 %."""
    if spread is None:
        return ""
    low, middle, high = (round(spread[name]) for name in ("p5", "p50", "p95"))
    return _two(f"{middle}", f"{low} to {high}")


def _percents(spread: dict[str, float] | None) -> str:
    if spread is None:
        return ""
    return _two(
        f"{100 * spread['p50']:.0f} %", f"{100 * spread['p5']:.0f} to {100 * spread['p95']:.0f}"
    )


def _kept(closing: dict[str, Any] | None) -> str:
    return "" if closing is None else f"{closing['kept']} of {closing['preventable']}"


def _p(against: dict[str, Any] | None) -> str:
    if against is None:
        return ""
    return "&lt; 0.001" if against["p"] < 0.001 else f"{against['p']:.3f}"
