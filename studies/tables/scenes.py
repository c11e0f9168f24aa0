"""The tables of docs/scenes.md, from the code and from what commands measured: `make docs`."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from holdfast.core.reading import Json
from holdfast.evaluation.formats import markdown
from holdfast.simulation.card import read_card
from holdfast.simulation.effect import Effect
from holdfast.simulation.effects import EFFECTS
from holdfast.simulation.sensor.magnet import residual_n
from holdfast.simulation.shipped import CARDS, shipped
from holdfast.training.figures import over
from studies.row_names import OURS, shown
from tools.doc_tables import Tables, fill, refresh, table

STEP_HEADS = {
    "step_ms": "step, ms",
    "p50_ms": "error, median, ms",
    "p90_ms": "error, 90 %, ms",
    "cpu_s_per_trial": "CPU s per trial",
}
TRIAL_HEADS = {"trials": "trials at once", "cpu_s_per_trial": "CPU s per trial"}
ELEMENT_HEADS = {
    "elements": "brush elements",
    "cpu_s_per_trial": "CPU s per trial",
    "incipient_ms": "incipient to gross slip, ms",
}
LEAD_HEADS = {
    "card": "card",
    "action": "action",
    "n": "trials",
    "p5_ms": "5 %, ms",
    "p50_ms": "median, ms",
    "p95_ms": "95 %, ms",
    "expected_ms": "prototype, ms",
}
SOLVER_HEADS = {
    "solver": "solver",
    "step_ms": "step, ms",
    "cpu_ms_per_s": "CPU ms per simulated s",
    "held_s": "held, s",
    "creep_mm": "creep, mm",
    "slip_8n_ms": "slip at 8 N, ms",
    "slip_16n_ms": "slip at 16 N, ms",
}
LOOP_HEADS = {
    "action": "action",
    "ours": "our core",
    "mujoco": "MuJoCo",
    "normal": "normal force of a finger, %",
    "along": "force along the skin, %",
}
LEVELS = {"8 classes, accuracy": "eight", "7, accuracy": "seven", "4, accuracy": "four"}


def _from_code() -> Tables:
    return {"sensor": _sensor(), "cards": _cards()}


def _simulator(simulator: Json) -> Tables:
    """The simulator's time, and its solution beside others'."""
    return {
        "step": table(simulator["step"], STEP_HEADS),
        "by-trials": table(simulator["by_trials"], TRIAL_HEADS),
        "by-elements": table(simulator["by_elements"], ELEMENT_HEADS),
        "plausibility": table(simulator["plausibility"], LEAD_HEADS),
        "solvers": table(simulator["hold_and_pull"], SOLVER_HEADS),
        "friction": markdown([_friction_row(row) for row in simulator["friction"]]),
    }


def mujoco_loop(figures: Json) -> Tables:
    """Of `make peers`."""
    return {
        "mujoco-loop": table(
            [_loop_row(trial) for trial in figures["trials"]], LOOP_HEADS
        )
    }


def _loop_row(trial: Json) -> Json:
    *normals, along = (100.0 * force["difference"] for force in trial["forces"])
    fates = {
        world: _fate(trial["action"], trial[world]) for world in ("ours", "mujoco")
    }
    return {"action": trial["action"], **fates, "normal": max(normals), "along": along}


def _fate(action: str, hands: Json) -> str:
    """What became of the object with holdfast, after what became of it in a bare hand."""
    bare, held = hands["none"], hands["holdfast"]
    if action == "pass":
        gone = [f"taken after {1e3 * one['lost_s']:.0f} ms" for one in (bare, held)]
        return f"{gone[0]}; {gone[1]}{', blocked' if held['blocked'] else ''}"
    before, after = ("kept" if one["kept"] else "lost" for one in (bare, held))
    return f"{before}; {after}, {held['slip_mm']:.1f} mm"


def _sensor() -> str:
    normal_n, shear_n = residual_n()
    rows = [
        ("simulated", f"{normal_n:.2f}", f"{shear_n:.2f}"),
        ("published", "0.27", "0.12"),
    ]
    return markdown(
        [
            dict(zip(("sensor", "normal, N", "shear, N"), row, strict=True))
            for row in rows
        ]
    )


def _cards() -> str:
    titles = {name: read_card(str(CARDS / f"{name}.toml")).title for name in shipped()}
    return markdown(
        [{"card": f"`{name}`", "what": title} for name, title in titles.items()]
    )


def _effects(figures: Json) -> dict[str, str]:
    prices = {row["effect"]: row["ns_per_sample"] for row in figures["prices"]}
    core = [
        {
            "what": "core alone, CPU ns per sample",
            "value": f"{prices['(core alone)']:,.0f}",
        },
        {
            "what": "the same with an empty `[effects]`, times the core alone",
            "value": f"{figures['empty_list_over_core']:.3f}",
        },
    ]
    rows = [_effect_row(effect, prices.get(name)) for name, effect in EFFECTS.items()]
    return {"core-price": markdown(core), "effects": markdown(rows)}


def _effect_row(effect: Effect, price_ns: float | None) -> Json:
    ranges = [
        f"`{name}` {parameter.allowed().split(' from ')[-1]}"
        for name, parameter in effect.parameters.items()
    ]
    return {
        "effect": f"`{effect.name}`",
        "stage": effect.stage,
        "needs": ", ".join(f"`{name}`" for name in effect.needs) or "-",
        "parameters": ", ".join(ranges) or "-",
        "CPU ns per sample": None if price_ns is None else f"{price_ns:,.0f}",
    }


def _friction_row(row: Json) -> Json:
    return {
        "law": row["law"],
        "load, share of the limit": row["share"],
        "vibration, share of the limit": row["vibration"],
        "creep, mm": "slides away" if row["lets_go"] else 1e3 * row["creep_m"],
        "step, ms": 1e3 * row["step_s"],
        "CPU us per simulated s": 1e-3 * row["cost_ns_per_s"],
    }


def _study(figures: Json) -> dict[str, str]:
    """The forests on scenes: by rate, on what is unseen, over retrainings."""
    rates = figures["rates"]
    best = rates[figures["headline_hz"]]
    held = [
        _scores(f"{rate} Hz: {shown(name)}", row)
        for rate, one in rates.items()
        for name, row in one["rows"].items()
    ]
    leak = [
        {"rate, Hz": rate, "accuracy (99 %)": _leak(one["leak"])}
        for rate, one in rates.items()
    ]
    return {
        "forests": markdown(held),
        "leak": markdown(leak),
        "unseen": markdown([_scores(*one) for one in _unseen(best)]),
        "class-recall": markdown(_recalls(best["retrainings"][OURS])),
    }


def _unseen(rate: Json) -> list[tuple[str, Json]]:
    """Every method on every object left out, and on every card that it was not trained on."""
    return [
        (f"{what}: {shown(name)}", row)
        for name in rate["objects"]
        for what, row in [
            *(
                (f"without {thing}", row)
                for thing, row in rate["objects"][name].items()
            ),
            *((card, other["rows"][name]) for card, other in rate["others"].items()),
        ]
    ]


def _leak(leak: Json) -> str:
    low, high = leak["eight_class_accuracy_ci99"]
    return f"{leak['eight_class_accuracy']:.3f} ({low:.3f} to {high:.3f})"


def _recalls(retrainings: Json) -> list[Json]:
    return [
        {
            "class": name.replace("_", " "),
            "recall of each retraining": " ".join(f"{one:.3f}" for one in recalls or ())
            or None,
            "largest minus smallest": retrainings["spread"][name],
        }
        for name, recalls in retrainings["recall"].items()
    ]


def _scores(method: str, row: Json) -> Json:
    scores: Json = {"method": method}
    for head, level in LEVELS.items():
        scores[head] = f"{row[level]['accuracy']:.3f}" if level in row else None
    scores["4, macro F1"] = _macro_f1(row["four"]) if "four" in row else None
    for name in ("risky", "safe", "grasp"):
        share = row["calls"][name]["share"]
        scores[f"{name} called risky"] = None if share is None else f"{share:.3f}"
    return scores


def _macro_f1(four: Json) -> str | None:
    """With the classes that it is over, where one is absent from the truth."""
    if four["macro_f1"] is None:
        return None
    return f"{four['macro_f1']:.3f} {over(four.get('f1', {}))}".rstrip()


def made_from(bench: Path, study: Path) -> dict[Path, Callable[[Json], Tables]]:
    """bench: folder of `holdfast bench`; study: scenes.json of `make study NAME=scenes`."""
    return {
        bench / "effects.json": _effects,
        bench / "simulator.json": _simulator,
        bench / "mujoco-loop.json": mujoco_loop,
        study: _study,
    }


if __name__ == "__main__":
    bench_folder, study_file, page = map(Path, sys.argv[1:])
    fill(page, _from_code())
    refresh(page, made_from(bench_folder, study_file))
