"""Scenes behind sim:// and virtual:// URLs: trials as a stream, and the field at emulated chips."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.core.errors import UsageError
from holdfast.drivers.replay import Replay
from holdfast.live.running import progress_of, say
from holdfast.live.source_url import SIM, SourceUrl, source_url

if TYPE_CHECKING:
    from holdfast.drivers.virtual.virtual_hand import Track
    from holdfast.simulation.protocol import PlannedTrial
    from holdfast.simulation.scene import Scene, SimulatedTrial

Report = Callable[[str], None]
FIELD_HZ = 1000.0
"""Rate of a scene's field for the virtual chips, each of which converts it at its time."""


def simulated_stream(source: SourceUrl) -> Replay:
    """Trials of a sim:// URL, one after another, as one stream. Raises CardError, UsageError."""
    scene, trials = _trials_of(source)
    # end to end, with the state of the model going on from one to the next
    signal, _, _ = scene.join(trials)
    t_ns = np.round(signal.t_s * 1e9).astype(np.int64)
    return Replay(
        t_ns,
        signal.values.reshape(len(t_ns), -1),
        signal.valid,
        scene.file.rate_hz,
        signal.unit,
    )


@lru_cache(maxsize=1)
def _trials_of(source: SourceUrl) -> tuple[Scene, list[SimulatedTrial]]:
    from holdfast.simulation.scene import Scene
    from holdfast.simulation.scene_file import read_scene_file

    options = source.options
    card = read_scene_file(source.name, rate_hz=options.rate_hz)
    scene = Scene(card, options.seed)
    trials = scene.trials()
    chosen = trials[options.trial : options.trial + options.trials]
    if not 0 < len(chosen) == options.trials:
        raise UsageError(
            f"{source.url!r}: no {options.trials} trials from {options.trial} on",
            next_step=f"choose from 0..{len(trials) - 1}",
        )
    return scene, scene.run_together(chosen)


def scene_of(url: str) -> tuple[Scene, SimulatedTrial] | None:
    """The scene and the trial of a virtual:// URL with a scene, or of sim://; else None."""
    source = source_url(url)
    if source.scheme == "sim":
        scene, trials = _trials_of(source)
        return (scene, trials[0]) if len(trials) == 1 else None
    named = _named_trial(source)
    return None if named is None else simulated(*named)


def _named_trial(source: SourceUrl) -> tuple[str, int, int] | None:
    """(scene, seed, trial) of a virtual:// URL; None where it has no scene."""
    if source.scheme != "virtual" or not source.options.scene:
        return None
    return source.options.scene, source.options.seed, source.options.trial


def field_of(source: SourceUrl, report: Report) -> Track | None:
    """The field of a scene's trial at the chips of a virtual hand; None without a scene."""
    from holdfast.drivers.virtual.virtual_hand import Track

    named = _named_trial(source)
    if named is None:
        return None
    signal = simulated(*named, report)[1].signal
    return Track(signal.t_s, signal.values)


_kept: dict[tuple[str, int, int], tuple[Scene, SimulatedTrial]] = {}
"""The newest simulated trial, which several callers need."""


def simulated(
    scene: str, seed: int, trial: int, report: Report = say
) -> tuple[Scene, SimulatedTrial]:
    """A trial of a scene as field at the chips of a virtual hand. Raises CardError, UsageError.

    It takes seconds, so `report` gets the progress.
    """
    key = scene, seed, trial
    if key not in _kept:
        made, planned = _planned(scene, seed, trial)
        progress = progress_of(f"simulating scene {scene}", report)
        one = made.run_together([planned], progress)[0]
        # one trial is enough for a run, and a long one is large
        _kept.clear()
        _kept[key] = made, one

    return _kept[key]


def planned_scene(
    url: str, rate_hz: float, step_s: float
) -> tuple[Scene, PlannedTrial] | None:
    """(scene, trial before it is simulated) of a virtual:// URL; None where it has no scene.

    rate_hz: of the field at the chips. Raises CardError, UsageError.
    """
    named = _named_trial(source_url(url))
    return None if named is None else _planned(*named, rate_hz, step_s)


def _planned(
    name: str,
    seed: int,
    number: int,
    rate_hz: float = FIELD_HZ,
    step_s: float | None = None,
) -> tuple[Scene, PlannedTrial]:
    made = _scene_at_chips(name, seed, rate_hz, step_s)
    trials = made.trials()
    # numbers in URLs count from 0
    if number >= len(trials):
        what = f"scene {name}: no trial {number}"
        raise UsageError(what, next_step=f"0..{len(trials) - 1}")
    return made, trials[number]


def _scene_at_chips(
    name: str, seed: int, rate_hz: float, step_s: float | None
) -> Scene:
    """The scene in uT without the effects of the virtual chip and bus, and without a controller."""
    from holdfast.simulation.effect import EFFECT_MODULES
    from holdfast.simulation.scene import Scene
    from holdfast.simulation.scene_file import read_scene_file

    file_rate_hz = rate_hz if Path(name).is_file() else None
    card = read_scene_file(name, rate_hz=file_rate_hz)

    # the virtual chip adds its own noise and quantisation, which must not count twice
    effects: dict[str, dict[str, float]] = {"dipole": {}}
    for effect, values in card.effects.items():
        if EFFECT_MODULES[effect] != "chip":
            effects[effect] = values

    field = replace(card, rate_hz=rate_hz, unit="uT", effects=effects)
    if step_s is not None:
        field = replace(field, step_s=step_s)
    return Scene(field, seed)


def shear_gain_of(url: str, calibration: Path | None) -> float | None:
    """Ratio of shear and normal force as read, over the true one; None where not measured.

    Of the calibration, else of the sensors that a scene emulates. Raises a DataError.
    """
    if calibration is not None:
        from holdfast.drivers.calibration import read_calibration

        return read_calibration(calibration).shear_gain

    if url.startswith("virtual://"):
        from holdfast.simulation.magnet import shear_gain

        return shear_gain()
    if not url.startswith(SIM):
        return None
    from holdfast.simulation.magnet import shear_gain_in

    return shear_gain_in(_trials_of(source_url(url))[0].file.effects)


def scene_force() -> Callable[[FloatArray], FloatArray]:
    """The calibration of the scenes' sensors, for a virtual hand without a calibration."""
    from holdfast.drivers.virtual.virtual_hand import FORCE_N_PER_UT

    return lambda field_ut: np.einsum("ij,sj->si", FORCE_N_PER_UT, field_ut)
