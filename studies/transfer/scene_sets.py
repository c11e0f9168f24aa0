"""The scenes of the study: cards, what is left out of them, and how they become sets on disk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from holdfast.core.contract import Unit
from holdfast.core.writing import write_whole
from holdfast.simulation import SCENES, shipped_scenes
from holdfast.training.datasets import join, load
from holdfast.training.featurise import digest_of
from holdfast.training.recording import DataSet
from holdfast.training.windows import Choice
from tools.harness import SimulatedSet, simulate_sets

PEOPLE_HZ = 58.9
"""Mean rate of human_slip_uskin."""
EFLESH_HZ = 100.0
"""Nominal rate of eflesh_slip."""
CHIP_NOISE = ("hall_noise", "quantisation")
"""Effects that a row without chip noise leaves out."""
NOISE = (*CHIP_NOISE, "white_noise")
"""The same, for a card that draws its noise."""
SEED = 101
"""Of every simulated set: a development seed. The test sets of this study are recordings."""


@dataclass(frozen=True)
class SceneSet:
    """Scenes that one model is trained on, or one column is measured on.

    name: of the row. cards: names of shipped cards. without: effects that are left out. added:
    effects that are put in, with their defaults. rate_hz, unit: of the recordings, whatever the
    card says. hand: the hand card instead of theirs; empty for theirs.
    """

    name: str
    cards: tuple[str, ...]
    without: tuple[str, ...] = ()
    rate_hz: float = PEOPLE_HZ
    unit: Unit = "N"
    added: tuple[str, ...] = ()
    hand: str = ""

    @property
    def here(self) -> bool:
        """Whether all of its cards are shipped."""
        return set(self.cards) <= set(shipped_scenes())


def without_chip_noise(of: SceneSet) -> SceneSet:
    """The same scenes with a chip that reads exactly."""
    return replace(of, name=f"{of.name}, no chip noise", without=CHIP_NOISE)


def noise_from_zero(of: SceneSet) -> SceneSet:
    """The same scenes with white noise of 0 to 40 mN instead of theirs, drawn for every trial."""
    added = ("white_noise",)
    name = f"{of.name}, noise 0 to 40 mN"
    return replace(of, name=name, without=NOISE, added=added)


SHIPPED = SceneSet("thesis and broad", ("thesis", "broad"))
"""What the shipped models are trained on."""
PINCH = SceneSet("pinch", ("pinch",))
"""Like human_slip_uskin; its sensors have no chip, hence no noise of one."""
PINCH_CHIP = replace(PINCH, name="pinch, chip noise", added=("dipole", *CHIP_NOISE))
PINCH_SPREAD = replace(PINCH, name="pinch, spread taxels", hand="pinch-pad-spread")
ON_SPREAD = (PINCH_SPREAD, noise_from_zero(PINCH_SPREAD))
"""Scenes whose models are scored on people with spread taxels."""
WIDE = SceneSet("wide", ("wide",))
TRAINED = (
    SHIPPED,
    without_chip_noise(SHIPPED),
    noise_from_zero(SHIPPED),
    PINCH,
    PINCH_CHIP,
    noise_from_zero(PINCH),
    WIDE,
    replace(without_chip_noise(WIDE), name="wide, no noise", without=NOISE),
)
"""Scenes that models are trained on and then scored on people."""
TOLD_APART = (SHIPPED, without_chip_noise(SHIPPED), PINCH, PINCH_CHIP, WIDE)
"""Scenes whose windows a classifier tells from people's."""
COMPARED = (
    SceneSet("thesis", ("thesis",)),
    SceneSet("broad", ("broad",)),
    SceneSet("daily", ("daily",)),
    SceneSet("everyday", ("everyday",)),
    PINCH,
    WIDE,
)
"""Scenes whose statistics stand beside those of the real sets."""
DRAWN = (PINCH, *COMPARED[:2])
"""Scenes whose slips are drawn beside those of a robot's grip, as far as they are shipped."""
IN_FIELD = (
    SceneSet("thesis and broad", ("thesis", "broad"), (), EFLESH_HZ, "uT"),
    SceneSet("eflesh", ("eflesh",), (), EFLESH_HZ, "uT"),
)
"""Scenes in the unit of eflesh_slip."""
IN_NEWTONS = replace(IN_FIELD[0], unit="N")
"""Scenes whose tugs say how large one is for a model in N."""


def there(sets: Sequence[SceneSet]) -> list[SceneSet]:
    """Those whose cards are shipped."""
    return [one for one in sets if one.here]


def card_text(card: str, of: SceneSet) -> str:
    """The text of a shipped card as a set wants it: its effects and unit.

    >>> "hall_noise" in card_text("thesis", without_chip_noise(SHIPPED))
    False
    """
    left_out = {f"[effects.{name}]" for name in of.without}
    lines = []
    section = ""
    for line in (SCENES / f"{card}.toml").read_text(encoding="utf-8").splitlines():
        word = line.split("#")[0].strip()
        if word.startswith("["):
            section = word
        if section in left_out:
            continue
        if section == "[record]" and word.startswith("unit"):
            continue
        if of.hand and section == "[hand]" and word.startswith("card"):
            lines.append(f'card = "{of.hand}"')
            continue
        lines.append(line)
        if word == "[record]":
            lines.append(f'unit = "{of.unit}"')
    lines += [f"[effects.{name}]" for name in of.added]
    return "\n".join(lines) + "\n"


def simulated(sets: Sequence[SceneSet], trials: int, out: Path) -> list[list[Path]]:
    """Folders of the cards of every set, `trials` a card; what an earlier run wrote is kept.

    A folder is named after its card's text, trials, seed and rate; a change of the simulator
    itself does not show in it (`--fresh` simulates again).
    """
    wanted: dict[str, SimulatedSet] = {}
    folders = []
    for one in sets:
        of_set = []
        for card in one.cards:
            text = card_text(card, one)
            digest = digest_of([text, trials, SEED, one.rate_hz])
            folder = f"sets/{card}-{digest}"
            place = out / "cards" / digest / f"{card}.toml"
            write_whole(place, text)
            wanted[folder] = SimulatedSet(folder, str(place), trials, SEED, one.rate_hz)
            of_set.append(out / folder)
        folders.append(of_set)
    missing = [one for name, one in wanted.items() if not (out / name).is_dir()]
    simulate_sets(missing, out)
    return folders


def read(folders: Sequence[Path], windows: Choice = "balanced") -> DataSet:
    """The cards of a set together."""
    return join([load(folder, windows=windows) for folder in folders])
