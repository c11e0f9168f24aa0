"""The sets that the shipped files learn from: scenes, the same scenes as two transducers feel them,
and the lifts of ten people.

The second ones stand beside the lifts so that the sensing does not tell the answer: with lifts
alone a learner takes "two sensors, one axis silent" for "never a slip".
"""

from __future__ import annotations

from pathlib import Path

from holdfast.data.datasets import find
from holdfast.data.datasets.grip_lift_ati import NAME as LIFTS
from studies.people.two_pads import two_pad_name, write_two_pad_scene
from tools.harness import SimulatedSet, simulate_sets

SCENES = (("thesis", None), ("broad", None), ("wide", 500), ("everyday", 200))
"""Scene and trials, None for all of the scene."""
TWO_PAD_SCENES = (("thesis", 300), ("wide", 250), ("everyday", 120))
SEED, TWO_PAD_SEED = 0, 1
QUICK_TRIALS = 8
"""Of each set, where only the way is tried."""


def training_sets(
    out: Path, rate_hz: float, *, lifts: bool = True, quick: bool = False
) -> list[str]:
    """Simulate into `out` what is missing there; returns the sets for `holdfast train --data`.

    lifts: with the two-pad scenes and the lifts of people. quick: a few trials of each. Raises
    DataNotFound where the lifts are not there, before anything is simulated.
    """
    lifts_from = str(find(LIFTS)) if lifts else ""
    sets = []
    for scene, trials in SCENES:
        count = QUICK_TRIALS if quick else trials
        sets.append(SimulatedSet(scene, scene, count, SEED, rate_hz))
    for scene, trials in TWO_PAD_SCENES if lifts else ():
        card = write_two_pad_scene(scene, rate_hz, out)
        count = QUICK_TRIALS if quick else trials
        name = two_pad_name(scene)
        sets.append(SimulatedSet(name, str(card), count, TWO_PAD_SEED, rate_hz))

    # A set is written whole or not at all, so one that is there is the one that was asked for.
    simulate_sets([one for one in sets if not (out / one.folder).is_dir()], out)
    names = [str(out / one.folder) for one in sets]
    return [*names, lifts_from] if lifts else names
