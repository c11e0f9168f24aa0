"""What the templates of documents call: numbers as text, and rows that need more than a loop."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.cost.point import README_POINTS
from holdfast.core.contract import NORMAL_FLOOR, Json
from holdfast.core.schema import ranges
from holdfast.core.trial_layout import SITUATION_OF_ACTION
from holdfast.data.metrics import ABSENT, over
from holdfast.edge_runtime.grip import AnswerRules
from holdfast.edge_runtime.model import Model
from holdfast.evaluation.formats import DEPLOYED, markdown
from holdfast.live.output_table import OUTPUTS
from holdfast.simulation import SCENES, shipped_scenes
from holdfast.simulation.actions import ACTION_MODULES, COMMON, parameters_of
from holdfast.simulation.effects.effect import all_effects
from holdfast.simulation.effects.magnet import (
    HEIGHT,
    dipole_ut,
    linear_map,
    loads_n,
    place_m,
)
from holdfast.simulation.scenes.scene_file import read_scene_file
from holdfast.step.features import GROUPS, feature_count, feature_graph
from holdfast.step.history import LAGS_S
from holdfast.step.spec import StepSpec
from studies.row_names import shown
from studies.shared_control.picture import front as loop_front
from studies.shared_control.plan import OURS as OUR_CONTROLLER
from studies.shared_control.targets import target_rows as loop_targets
from studies.thesis_preliminary.published import ACCURACY_PERCENT, LEARNERS

Rows = Sequence[Json]
SHIPPED = Path(__file__).resolve().parents[1] / "models/holdfast-150hz.onnx"
SENSORS, RATE_HZ = 6, 58.9
"""What the numbers of the page of features are for."""


def calibration_error_n() -> tuple[float, float]:
    """RMS error of the sensors' linear map over its loads: (normal, shear), N."""
    loads = loads_n()
    matrix, rest = linear_map()
    fields = dipole_ut(place_m(loads, HEIGHT.default)) - rest
    squares = (fields @ matrix.T - loads) ** 2
    normal, shear = squares[:, 2].mean(), squares[:, :2].mean()
    return math.sqrt(normal), math.sqrt(shear)


def table(
    rows: Rows,
    heads: Mapping[str, str],
    words: Mapping[str, Mapping[Any, str]] | None = None,
) -> str:
    """Chosen columns of rows of figures as Markdown. heads: key -> title with its unit.

    words: key -> what the table says for a value, where that is not the value itself.
    """
    lines = []
    for row in rows:
        line = {head: row.get(key) for key, head in heads.items()}
        for key, names in (words or {}).items():
            line[heads[key]] = names.get(row[key], row[key])
        lines.append(line)
    return markdown(lines)


def number(value: float | None, places: int) -> str | None:
    """A number with so many decimal places."""
    return None if value is None else f"{value:.{places}f}"


def grouped(value: float, places: int = 0) -> str:
    """A large number with a comma every three digits."""
    return f"{value:,.{places}f}"


def percent(share: float) -> str:
    """A share in whole per cent."""
    return f"{share:.0%}"


def with_interval(value: float | None, interval: Sequence[float] | None) -> str | None:
    """A figure with its 95 % interval: 0.986 (0.98 to 0.99)."""
    if value is None:
        return None
    if interval is None:
        return f"{value:.3g}"
    return f"{value:.3g} ({interval[0]:.2f} to {interval[1]:.2f})"


def of_hundred(share: float | None, interval: Sequence[float] | None) -> str | None:
    """A share in words of a hundred, with its 95 % interval: 99 (96 to 100)."""
    if share is None or interval is None:
        return None
    return f"{100 * share:.0f} ({100 * interval[0]:.0f} to {100 * interval[1]:.0f})"


def exact(value: float, interval: Sequence[float]) -> str:
    """The same with three places everywhere."""
    return f"{value:.3f} ({interval[0]:.3f} to {interval[1]:.3f})"


def lags() -> str:
    """The lags of the features, s."""
    return ", ".join(f"{lag:.2f}" for lag in LAGS_S)


def floors() -> str:
    """The least normal force that a ratio divides by, in each unit."""
    return ", ".join(f"{value:g} {unit}" for unit, value in NORMAL_FLOOR.items())


def feature_groups() -> list[Json]:
    """Every group of features: how many, how long its memory, how many nodes, its formula."""
    alone = _nodes("now")
    rows = []
    for name, group in GROUPS.items():
        memory = f"{group.memory_s:.2f}"
        nodes = 0 if name == "now" else _nodes("now", name) - alone
        row = {"name": name, "features": feature_count(_spec(name)), "memory": memory}
        # a bar would end the cell
        formula = group.formula.replace("|", "\\|")
        rows.append({**row, "nodes": nodes, "formula": formula, "why": group.reason})
    return rows


def _nodes(*groups: str) -> int:
    return len(feature_graph(_spec(*groups)).graph.node)


def _spec(*groups: str) -> StepSpec:
    return StepSpec(SENSORS, RATE_HZ, "N", groups)


def scene_titles() -> dict[str, str]:
    """The title of every shipped scene."""
    return {
        name: read_scene_file(str(SCENES / f"{name}.toml")).title
        for name in shipped_scenes()
    }


ACTION_WORDS = {
    "pass": "another person takes it slowly, and the hand opens",
    "pull": "another person tears at it",
    "fall": "the support vanishes under a grip too weak for the weight",
    "put-down": "a box comes from below and takes the weight; later the hand opens",
    "hold": "disturbances of grip, load or motor",
    "nothing": "the open, empty hand",
    "tug": "a person pulls at it and lets go again, to one side or back and forth",
    "stack": "weight is added, laid on by hand or dropped in",
    "relax": "the grip drifts down by itself",
    "lift": "the hand grips it on a table and lifts it",
    "carry": "walking: the hand swings with every step",
    "turn": "the hand turns over and back",
    "pour": "the hand turns, the mass falls slowly, the hand turns back",
    "regrip": "the grip goes down and up again",
    "touch-table": "it is put against a table and taken off again",
    "stroke": "a person strokes the pads of the empty hand",
    "tap": "a person taps on the pads of the empty hand",
}
"""Every action of scenes in words."""
SITUATION_WORDS = {
    "safe_slip": "safe slip",
    "risky_slip": "risky slip where it slips, else grasp",
    "grasp": "grasp; risky slip where it slips",
    "nothing": "nothing",
}
"""What the truth of an action says, by the situation of the action."""


def action_rows() -> list[Json]:
    """Every action of scenes: what happens, what its truth says, its own parameters."""
    rows = []
    for name in ACTION_MODULES:
        own = [key for key in parameters_of(name) if key not in COMMON]
        truth = SITUATION_WORDS[SITUATION_OF_ACTION[name]]
        if name in ("stroke", "tap"):
            truth = "grasp above 0.3 N on a pad, else nothing"
        row = {"name": name, "what": ACTION_WORDS[name], "truth": truth}
        rows.append({**row, "parameters": _quoted(own)})
    return rows


def effect_rows(figures: Json) -> list[Json]:
    """Every effect of the code with its parameters and its measured price."""
    prices = {row["effect"]: row["ns_per_sample"] for row in figures["prices"]}
    rows = []
    for name, effect in all_effects().items():
        price_ns = prices.get(name)
        row: Json = {"name": name, "stage": effect.stage}
        row["ns"] = ABSENT if price_ns is None else grouped(price_ns)
        rows.append(row)
    return rows


def parameter_rows() -> list[Json]:
    """Every parameter of every effect: what holds without a value, its range, what it is."""
    rows = []
    for effect, entry in all_effects().items():
        for name, one in entry.parameters.items():
            limits = f"{one.low:g} to {one.high:g} {one.unit}".rstrip()
            many = ", a list" if one.many else ""
            row = {"effect": effect, "name": name, "about": one.about}
            default = _default_words(one.default)
            rows.append({**row, "range": limits + many, "default": default})
    return rows


def rule_rows() -> list[Json]:
    """Every number of the grip's answers: its shipped value, its range, what it is."""
    shipped = AnswerRules.of(Model(SHIPPED).card.decision)
    rows = []
    for name, one in ranges(AnswerRules).items():
        value = getattr(shipped, name)
        ends = f"from {one.ge:g}" if one.le is None else f"{one.ge:g} to {one.le:g}"
        row = {"name": name, "range": ends, "about": one.description}
        rows.append({**row, "shipped": f"{value:g}" if value < math.inf else ABSENT})
    return rows


def _default_words(default: Any) -> str:
    """A constant, a distribution, or that there is none."""
    if isinstance(default, dict):
        ((kind, numbers),) = default.items()
        return f"{kind} [{', '.join(f'{one:g}' for one in numbers)}]"
    return f"{default:g}" if isinstance(default, float) else ABSENT


def _quoted(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def readme_points(cost: Json) -> list[Json]:
    """The README's rows."""
    points = {(row["of"], row["what"]): row for row in cost["rows"]}
    return [points[one.of, one.what] for one in README_POINTS]


FUNCTIONS: dict[str, Callable[..., Any] | object] = {
    "averaged_over": over,
    "calibration_error_n": calibration_error_n,
    "deployed": DEPLOYED,
    "action_rows": action_rows,
    "effect_rows": effect_rows,
    "parameter_rows": parameter_rows,
    "exact": exact,
    "feature_groups": feature_groups,
    "floors": floors,
    "grouped": grouped,
    "lags": lags,
    "loop_front": loop_front,
    "loop_targets": loop_targets,
    "number": number,
    "of_hundred": of_hundred,
    "our_controller": OUR_CONTROLLER,
    "percent": percent,
    "published_learners": LEARNERS,
    "published_percent": ACCURACY_PERCENT,
    "outputs": OUTPUTS,
    "readme_points": readme_points,
    "rule_rows": rule_rows,
    "scene_titles": scene_titles,
    "shown": shown,
    "table": table,
    "with_interval": with_interval,
}
"""Every name that a template may use besides the figures."""
