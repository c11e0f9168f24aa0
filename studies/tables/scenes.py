"""docs/scenes.md, written from the code and from what `holdfast bench` measured: `make docs`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from evaluation.page import markdown
from simulation.card import read_card
from simulation.effect import Effect
from simulation.effects import EFFECTS
from simulation.shipped import CARDS, shipped
from studies.scenes.study import OURS

INTRO = """# Scenes

A scene is an experiment card (TOML). The core always runs: six contacts with brush friction (more where the card's
`[hand]` says so, [hand](../simulation/hand.py)), an object in three dimensions, people, a box, a hand that closes and
opens ([core](../simulation/core.py)). Nothing else runs unless the card names it. Written by `make docs`; **every
number here is simulated**.

```sh
holdfast simulate thesis --trials 50 --rate 150 --seed 0 --out build/scenes/thesis
holdfast simulate my-card.toml --out build/scenes/mine
holdfast replay MODEL "sim://apple?seed=1&trial=3"
```

A card, whole ([how it is read](../simulation/card.py)):

```toml
[record]
rate_hz = 100

[[trials]]
objects = ["soft-ball", "full-bottle"]
action = "pass"                        # pass, pull, fall, put-down, hold, nothing
count = 10
hold_s = { uniform = [2, 4] }          # a constant, or uniform, normal, log_uniform, choice

[effects.brush]
count = 5
```

Every trial leaves `trial_<n>.csv` (the thesis' layout), `trial_<n>.truth.json` (phases with provenance, load onset,
incipient and gross slip, contact lost, what was drawn, card and seed) and `trial_<n>.motion.csv` (object and hand, mm);
with `[camera]` and `[effects.camera_frames]` also `trial_<n>.frames.npz` (frames with AprilTags 36h11, 0 on the object,
1 on the hand; [what they leave out](../simulation/camera/frames.py)).
The truth comes from the core's state, never from a sensor. The same card and seed write the same bytes.

Styles (`author`, `p1`, `p2`) are ranges of parameters, not people. The sensor is calibrated by one linear map, so its
curvature stays in the newtons: NORMAL N normal and SHEAR N shear, root mean square over the thesis'
calibration loads (published for the real one: 0.27 and 0.12 N).
"""

HOLD_AND_PULL = """## Beside MuJoCo

A cylinder of 198 g held for 60 s, then pulled down by at most 8 N (friction holds) and at most 16 N (it cannot);
all at a fixed step. CPU time a trial and simulated second; creep from 1 s on ("-": it fell); time of 2 mm of slip
("-": none). MuJoCo can hold exactly too, with its no-slip pass; its default does not. Ours is dear alone and cheap in
numbers. `make peers`, then `holdfast bench simulator`.

"""
FRICTION = """## The thing not done: other laws of friction

One block on one contact, held for 60 s at a share of the friction limit, without and with a vibration of 5 % of the
limit at 10 Hz ([laws](../benchmarks/friction_peers.py)). Creep from 1 s on; price at the law's own step.

"""


def page(bench: Path, study: Path) -> str:
    """The whole page; bench: the folder with effects.json and simulator.json; study: scenes.json of
    `make scenes`."""
    from simulation.sensor.calibration import residual_n

    effects = json.loads((bench / "effects.json").read_text("utf-8"))
    simulator = json.loads((bench / "simulator.json").read_text("utf-8"))
    normal, shear = residual_n()
    prices = {row["effect"]: row for row in effects["prices"]}
    cards = [
        {"card": f"`{name}`", "what": read_card(str(CARDS / f"{name}.toml")).title}
        for name in shipped()
    ]
    parts = [
        INTRO.replace("NORMAL", f"{normal:.2f}").replace("SHEAR", f"{shear:.2f}"),
        f"## Cards that come with it\n\n{markdown(cards)}",
        "## Effects and their prices\n\n"
        "From one run of `holdfast bench effects`; the core alone costs "
        f"{prices['(core alone)']['ns_per_sample']:,.0f} ns a sample of six fingertips (CPU time, 200 trials at once), "
        f"and with an empty `[effects]` {effects['empty_list_over_core']:.3f} times that.\n\n"
        + markdown([_effect_row(effect, prices.get(name)) for name, effect in EFFECTS.items()]),
        "## What accuracy costs in time\n\nError of the time of gross slip against a 25 us step, pulls and falls of "
        f"`thesis`; the step is first order.\n\n{markdown(simulator['step'])}\n\n"
        "CPU time by trials stepped together, and by brush elements (with the median time from incipient to gross "
        f"slip):\n\n{markdown(simulator['by_trials'])}\n\n{markdown(simulator['by_elements'])}",
        "## Plausible?\n\nFrom load onset to gross slip. Expected: medians of an earlier prototype, to which the "
        f"styles were fitted.\n\n{markdown(simulator['plausibility'])}",
        HOLD_AND_PULL + markdown(simulator["hold_and_pull"]),
        FRICTION + markdown([_friction_row(row) for row in simulator["friction"]]),
        *study_parts(json.loads(study.read_text("utf-8"))),
    ]
    return "\n\n".join(parts) + "\n"


def _effect_row(effect: Effect, price: dict[str, Any] | None) -> dict[str, Any]:
    told = [f"`{name}` {p.allowed().split(' from ')[-1]}" for name, p in effect.parameters.items()]
    return {
        "effect": f"`{effect.name}`",
        "stage": effect.stage,
        "needs": ", ".join(f"`{name}`" for name in effect.needs) or "-",
        "parameters": ", ".join(told) or "-",
        "ns a sample": None if price is None else f"{price['ns_per_sample']:,.0f}",
    }


def _friction_row(row: dict[str, Any]) -> dict[str, Any]:
    return {
        "law": row["law"],
        "share of the limit": row["share"],
        "vibration": row["vibration"],
        "creep_mm": "lets go" if row["lets_go"] else 1e3 * row["creep_m"],
        "step_ms": 1e3 * row["step_s"],
        "us_per_s": 1e-3 * row["cost_ns_per_s"],
    }


def study_parts(figures: dict[str, Any]) -> list[str]:
    """What a forest tells on scenes: by rate, on what it never met, over retrainings."""
    rates = figures["rates"]
    best = rates[figures["headline_hz"]]
    held = [
        _told(f"{rate} Hz: {name}", row)
        for rate, one in rates.items()
        for name, row in one["rows"].items()
    ]
    met = [
        _told(f"{what}: {name}", row)
        for name in best["objects"]
        for what, row in [
            *((f"without {thing}", row) for thing, row in best["objects"][name].items()),
            *((card, other["rows"][name]) for card, other in best["others"].items()),
        ]
    ]
    weight = "; ".join(
        f"{rate} Hz {one['leak']['eight_class_accuracy']:.3f} ({_span(one['leak']['eight_class_accuracy_ci99'])})"
        for rate, one in rates.items()
    )
    again = [
        {
            "class": name.replace("_", " "),
            "recall": " ".join(f"{x:.3f}" for x in recalls),
            "spread": spread,
        }
        for (name, recalls), spread in zip(
            best["retrainings"][OURS]["recall"].items(),
            best["retrainings"][OURS]["spread"].values(),
            strict=True,
        )
    ]
    return [
        "## What a forest tells on scenes\n\n"
        f"`make scenes` (simulated; {best['data']['n_trials']} trials of `thesis`, trials held out, balanced windows; "
        "95 % intervals over trials in build/scenes/study). Seven classes count nothing once: light and heavy are "
        f"the same signal there.\n\n{markdown(held)}\n\n"
        "Eight classes on the raw window from a fresh state, with its 99 % interval; above 0.875 would be a leak of "
        f"the weight: {weight}.",
        f"On objects left out and on cards never met, {figures['headline_hz']} Hz, trained on `thesis` (all windows "
        f"of the cards, not balanced):\n\n{markdown(met)}",
        f"Recall of five retrainings with other seeds of split and forest, {figures['headline_hz']} Hz (the two of "
        f"nothing are a coin's):\n\n{markdown(again)}",
    ]


def _told(what: str, row: dict[str, Any]) -> dict[str, Any]:
    levels = {"8, accuracy": "eight", "7, accuracy": "seven", "4, accuracy": "four"}
    told: dict[str, Any] = {"asked": what}
    told |= {
        head: f"{row[level]['accuracy']:.3f}" if level in row else None
        for head, level in levels.items()
    }
    told["4, macro F1"] = f"{row['four']['macro_f1']:.3f}" if "four" in row else None
    return told | {
        f"{name} called risky": _share(row["calls"][name]["share"])
        for name in ("risky", "safe", "grasp")
    }


def _share(share: float | None) -> str | None:
    return None if share is None else f"{share:.3f}"


def _span(interval: list[float]) -> str:
    return f"{interval[0]:.3f} to {interval[1]:.3f}"


if __name__ == "__main__":
    sys.stdout.write(page(Path(sys.argv[1]), Path(sys.argv[2])))
