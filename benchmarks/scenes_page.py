"""docs/scenes.md, written from the code and from what `holdfast bench` measured: `make docs`."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from simulation.card import CARDS, read_card, shipped
from simulation.effect import Effect
from simulation.effects import EFFECTS

INTRO = """# Scenes

A scene is an experiment card (TOML). The core always runs: six contacts with brush friction, an object in three
dimensions, people, a box, a hand that closes and opens ([core](../simulation/core.py)). Nothing else runs unless the
card names it. Written by `make docs`; **every number here is simulated**.

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
incipient and gross slip, contact lost, what was drawn, card and seed) and `trial_<n>.motion.csv` (object and hand, mm).
The truth comes from the core's state, never from a sensor. The same card and seed write the same bytes.

Styles (`author`, `p1`, `p2`) are ranges of parameters, not people. The sensor is calibrated by one linear map, so its
curvature stays in the newtons: NORMAL N normal and SHEAR N shear, root mean square over the thesis'
calibration loads (published for the real one: 0.27 and 0.12 N).
"""


def page(bench: Path) -> str:
    """The whole page; bench: the folder with effects.json and simulator.json."""
    from simulation.sensor.calibration import residual_n

    effects = json.loads((bench / "effects.json").read_text("utf-8"))
    simulator = json.loads((bench / "simulator.json").read_text("utf-8"))
    normal, shear = residual_n()
    prices = {row["effect"]: row for row in effects["prices"]}
    cards = [{"card": f"`{name}`", "what": read_card(str(CARDS / f"{name}.toml")).title} for name in shipped()]
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
    ]
    return "\n\n".join(parts) + "\n"


def markdown(rows: Sequence[dict[str, Any]]) -> str:
    """Rows as a table."""
    head = list(rows[0])
    lines = [head, ["---"] * len(head), *([_cell(row[name]) for name in head] for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _effect_row(effect: Effect, price: dict[str, Any] | None) -> dict[str, Any]:
    told = [f"`{name}` {p.allowed().split(' from ')[-1]}" for name, p in effect.parameters.items()]
    return {
        "effect": f"`{effect.name}`",
        "stage": effect.stage,
        "needs": ", ".join(f"`{name}`" for name in effect.needs) or "-",
        "parameters": ", ".join(told) or "-",
        "ns a sample": None if price is None else f"{price['ns_per_sample']:,.0f}",
    }


def _cell(value: Any) -> str:
    return "-" if value is None else f"{value:.3g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    sys.stdout.write(page(Path(sys.argv[1])))
