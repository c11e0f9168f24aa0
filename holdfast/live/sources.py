"""Source URLs: where samples come from, the same for every verb; and the files that belong to them.

replay://PATH, PATH         a recorded trial
replay://SET#N, SET#N       trial N (or its name) of a data set
sim://CARD?seed=S&trial=N   a trial of a scene, simulated now (default 0, 0)
sim://CARD?trials=K         K trials end to end

A source that is neither a URL nor an existing file gets a suggestion.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import SplitResult, parse_qs, urlsplit

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.core.errors import UnitError, UsageError
from holdfast.core.source import Source
from holdfast.drivers.replay import Replay, open_replay
from holdfast.edge_runtime.preparation import Preparation

if TYPE_CHECKING:
    from holdfast.simulation.scene import Scene, SimulatedTrial


LINES = ("stdin", "tcp", "udp", "serial", "unix")
"""Sources that are lines of another program (holdfast/live/line_sources.py)."""
STANDARD_INPUT = "-"
"""The same as stdin://."""
SCHEMES = ("usb", "i2c", "virtual", "sim", "replay", *LINES)
_NATIVE = re.compile(r"(?:/dev/)?i2c-(\d{1,3})")


def is_standard_input(url: str) -> bool:
    """Whether a source is what is piped into the program, so that no key can be read from there."""
    return url == STANDARD_INPUT or url.startswith("stdin:")


def require_meant(word: str) -> None:
    """Raise UsageError with a suggestion, if the word looks like a source without its scheme."""
    # a file may have the name of a scene or a bridge, and then it is the file that is meant
    is_terminal = word.startswith("/dev/tty")
    if "://" in word or (_exists(word) and not is_terminal):
        return
    meant = _meant(word)
    if meant:
        what = f"{word!r} is not a file, and a source needs its scheme"
        raise UsageError(what, next_step=f"write {meant}")


def _exists(word: str) -> bool:
    try:
        return Path(word).exists()
    # a word that is too long, or has a zero byte, is no name of a file
    except (OSError, ValueError):
        return False


def _meant(word: str) -> str:
    """What to write instead; empty without a suggestion."""
    scheme, colon, name = word.partition(":")
    if colon and scheme in SCHEMES:
        slash = "/" if scheme in ("serial", "unix") else ""
        return f"{scheme}://{slash}{name.lstrip('/')}"
    if word.startswith("/dev/tty"):
        return f"serial://{word}?baud=115200"
    if native := _NATIVE.fullmatch(word):
        return f"i2c://{native[1]}"
    return _bridge(word) or _card(word)


def _bridge(word: str) -> str:
    from holdfast.drivers.bridges import BRIDGES

    name, _, options = word.partition("?")
    if name not in BRIDGES:
        return ""
    query = f"?{options}" if options else ""
    return f"usb://{name}{query} for the bridge itself, virtual://{name}{query} for an emulated one"


def _card(word: str) -> str:
    from holdfast.simulation import shipped_scenes

    name, _, _ = word.partition("?")
    return f"sim://{word}" if name in shipped_scenes() else ""


REPLAY = "replay://"
SIM = "sim://"
SIM_KEYS = ("seed", "trial", "trials", "rate_hz")
MOST_DIGITS = 18
ToForce = Callable[[FloatArray], FloatArray]
"""Field [sensors, 3] -> force [sensors, 3]."""
SetReader = Callable[[str, int | None], Replay]
"""(SET#N, channels) -> trial N of a labelled set, prepared. Sets are read by packages above."""


def open_source(
    url: str,
    *,
    channels: int | None = None,
    preparation: Preparation | None = None,
    read_set: SetReader | None = None,
) -> Replay:
    """Open a source and remove its bias as in `preparation` (data sets are prepared already).

    read_set: reads SET#N with so many channels.

    Raises a DataError or UsageError.
    """
    # simulated, prepared or recorded: all of them come as one stream with times
    if url.startswith(SIM):
        source = _simulated(url)
    elif "://" in url and not url.startswith(REPLAY):
        raise UsageError(
            f"{url!r}: no such source",
            next_step=f"use {REPLAY}PATH or {SIM}CARD; holdfast run and record also read usb://, "
            "i2c://, virtual://, lsl:// and lines (docs/live-sources.md)",
        )
    else:
        require_meant(url)
        name = url.removeprefix(REPLAY)
        # a folder may have a number sign in its name
        if "#" in name and not Path(name).exists() and read_set is not None:
            return read_set(name, channels)
        source = open_replay(name)

    return source if preparation is None else source.prepared(preparation)


def _simulated(url: str) -> Replay:
    """Trials of a card, one after another, as one stream."""
    scene, trials = _trials_of(url)
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


def simulated_trial(url: str) -> tuple[Scene, SimulatedTrial] | None:
    """The scene of a sim:// source and its trial; None where it has several."""
    scene, trials = _trials_of(url)
    return (scene, trials[0]) if len(trials) == 1 else None


def simulated_scene(url: str) -> Scene:
    """The scene of a sim:// source."""
    return _trials_of(url)[0]


@lru_cache(maxsize=1)
def _trials_of(url: str) -> tuple[Scene, list[SimulatedTrial]]:
    from holdfast.simulation.scene import Scene
    from holdfast.simulation.scene_file import read_scene_file

    parts = split_url(url)
    name = parts.netloc + parts.path
    numbers = _numbers(url)
    card = read_scene_file(name, rate_hz=numbers.get("rate_hz"))
    scene = Scene(card, int(numbers["seed"]))

    trials = scene.trials()
    first = int(numbers["trial"])
    # first and count are checked together: their sum may lie beyond the scene
    count = int(numbers["trials"])
    if not 0 <= first < first + count <= len(trials):
        raise UsageError(
            f"{url!r}: no trials {first} to {first + count - 1}",
            next_step=f"choose from 0..{len(trials) - 1}",
        )

    return scene, scene.run_together(trials[first : first + count])


def _numbers(url: str) -> dict[str, float]:
    options = parse_qs(split_url(url).query, keep_blank_values=True)
    numbers: dict[str, float] = {"seed": 0, "trial": 0, "trials": 1}
    for key, values in options.items():
        if key not in SIM_KEYS:
            raise UsageError(
                f"{url!r}: {key!r} is not known",
                next_step=f"allowed: {', '.join(SIM_KEYS)}",
            )
        # a key that is given twice counts by its last value, as in other URLs
        text = values[-1]
        try:
            numbers[key] = float(text) if key == "rate_hz" else _whole(text)
        except ValueError:
            raise UsageError(
                f"{url[:80]!r}: {key}={text[:40]!r} is not a number",
                next_step=f"write {key}=1",
            ) from None

    return numbers


def _whole(text: str) -> int:
    """A whole number that is not negative. Raises ValueError."""
    if not text.isdecimal() or len(text) > MOST_DIGITS:
        raise ValueError(text)
    return int(text)


def split_url(url: str) -> SplitResult:
    """The parts of a URL. Raises UsageError."""
    try:
        return urlsplit(url)
    except ValueError as error:
        raise UsageError(
            f"{url[:80]!r} is not a URL ({error})",
            next_step="write SCHEME://NAME?key=value",
        ) from None


def force_of(path: Path | None) -> ToForce | None:
    """The map from field to force in a calibration file, or None. Raises a DataError."""
    if path is None:
        return None
    from holdfast.drivers.calibration import read_calibration

    return read_calibration(path).apply


def resting_of(path: Path | None, source: Source) -> FloatArray | None:
    """A bias file [C] that fits the source, or None. Raises a DataError."""
    if path is None:
        return None
    from holdfast.drivers.calibration import read_bias

    bias = read_bias(path)
    # a bias in another unit would be subtracted without any error
    if bias.unit != source.unit or len(bias.values) != source.n_channels:
        raise UnitError(
            f"{len(bias.values)} channels in {bias.unit}, "
            f"the source has {source.n_channels} in {source.unit}",
            where=path,
            cause="measured with another calibration or hand",
            next_step="run holdfast bias again",
        )

    return bias.values
