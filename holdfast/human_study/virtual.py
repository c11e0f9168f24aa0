"""A virtual participant: the scene of a source, and the trial of it that fits what is recorded."""

from __future__ import annotations

from functools import lru_cache
from urllib.parse import parse_qs

from holdfast.edge_runtime.errors import UsageError
from holdfast.recorder.card import NOTHING, Task
from holdfast.sources import SIM, split_url


def scene_in(url: str) -> tuple[str, int] | None:
    """(card, seed) of a source whose scene's trials can be chosen; None where it names a trial."""
    parts = split_url(url) if "://" in url else None
    options = {} if parts is None else parse_qs(parts.query, keep_blank_values=True)
    if parts is None or "trial" in options or "trials" in options:
        return None
    name = parts.netloc + parts.path if url.startswith(SIM) else options.get("scene", [""])[-1]
    seed = options.get("seed", ["0"])[-1]
    known = parts.scheme in ("sim", "virtual") and name and seed.isdecimal()
    return (name, int(seed)) if known else None


def url_for(url: str, task: Task, nth: int) -> str:
    """The source of the n-th trial of a task, from 0; the URL itself where it has no scene.

    A scene's trials of that object and action come in turn. Raises UsageError where it has none.
    """
    scene = scene_in(url)
    if scene is None:
        return url
    fitting = [k for k, one in enumerate(_tasks(*scene)) if one == Task(task.thing, task.action)]
    if not fitting:
        raise UsageError(
            f"the scene {scene[0]} has no trial of {task.thing}, {task.action}",
            cause="a card with other objects or actions than the protocol's",
            next_step="take a scene with them, such as sim://p1 for the card thesis",
        )
    return f"{url}{'&' if '?' in url else '?'}trial={fitting[nth % len(fitting)]}"


@lru_cache(maxsize=1)
def _tasks(name: str, seed: int) -> list[Task]:
    """What each trial of a scene is. Raises CardError."""
    from holdfast.simulation.card import read_card
    from holdfast.simulation.scene import Scene

    trials = Scene(read_card(name), seed).trials()
    things = [NOTHING if one.action == NOTHING else one.thing.name for one in trials]
    return [Task(thing, one.action) for thing, one in zip(things, trials, strict=True)]
