"""A test of deafness: simulated slips put into real holds.

A model that learned from lifts in which nothing falls may have learned never to alarm on two pads.
So the change of load and normal force of simulated pulls and falls, from load onset to gross slip,
is added to the middle of lifts by people who were left out:

    slips = simulated_slips(scene_path, seed=100)
    recording = with_slips(recording, slips, np.random.default_rng(100))

The events of the recording say where, so alarms are matched as anywhere else
(holdfast.evaluation.alarms.match_alarms). The change is added; how a person would react to the slip
is not in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from holdfast.core.contract import GRASP, RISKY_SLIP, FloatArray
from holdfast.core.errors import RateError
from holdfast.data.recording import Recording
from holdfast.data.timeline import Phase, RiskyEvent
from holdfast.simulation.scenes.scene import Scene, SimulatedTrial
from holdfast.simulation.scenes.scene_file import read_scene_file

SLIPPING = ("pull", "fall")
"""Actions whose slips are taken."""
BEGINS = (0.35, 0.55)
"""A slip begins at such a share of the contact: in the quiet hold."""
BEFORE_RELEASE_S = 0.1
"""Gross slip comes so long before the contact's end, when the person already lets go."""
LOAD_OVER_S = 0.1
"""The lift's load and normal force are means over this time before a slip."""
LEAST_LOAD_N = 0.2
"""A lift with less load in the hold gets no slip: nothing was lifted yet."""
AGAINST_N = 0.05
"""A hold with less load has no direction that a pull could be against."""
AFTER_GROSS_S = 0.25
"""An alarm later than this after gross slip, or after the loss of contact, finds nothing."""
LOAD, NORMAL = 1, 2
"""Axes of a two-pad recording; x is not measured."""


@dataclass(frozen=True)
class SimulatedSlip:
    """What a slip changes on the two pads, from the sample before load onset to gross slip.

    name        scene, action and number
    rate_hz     of the samples
    load_n      [K, 2] change of the load of either pad along its own load; row 0 is 0
    normal_n    [K, 2] change of the normal force
    at_gross_n  what both pads together bear at gross slip; against their load, half of the change
    onset_s, gross_s, end_s  load onset, gross slip, and the last alarm that counts, from row 0
    """

    name: str
    rate_hz: float
    load_n: FloatArray
    normal_n: FloatArray
    at_gross_n: float
    onset_s: float
    gross_s: float
    end_s: float


def simulated_slips(
    scene_path: Path | str, seed: int, trials: int | None = None
) -> list[SimulatedSlip]:
    """The slips of a two-pad scene's pulls and falls, the fastest first. Raises CardError.

    trials: of the whole scene, in its proportions.
    """
    scene = Scene(read_scene_file(str(scene_path)), seed)
    planned = [one for one in scene.trials(trials) if one.action in SLIPPING]
    slips = []
    for simulated in scene.run(planned):
        slip = _slip_of(simulated, scene.file.name, scene.file.rate_hz)
        if slip is not None:
            slips.append(slip)
    return by_speed(slips)


def by_speed(slips: Sequence[SimulatedSlip]) -> list[SimulatedSlip]:
    """Slips by their time from load onset to gross slip, the fastest first."""
    return sorted(slips, key=lambda slip: (_lasts_s(slip), slip.name))


def with_slips(
    recording: Recording,
    slips: Sequence[SimulatedSlip],
    rng: np.random.Generator,
    size: float = 1.0,
) -> Recording:
    """The recording with one slip in every lift that has room for one, and with its events.

    A slip is scaled so that at gross slip its pads bear the load that the lift's pads bore: a pull
    or a fall at most doubles the load, and one of a hold that bore much already adds less; a pull
    against the load turns it round. The time of the slip is drawn log-uniformly among those that
    fit the lift. After gross slip the change stays, and goes as the pads let go; rows after the
    event, to the end of the contact, count in no figure.

    slips: of the recording's rate (RateError otherwise). size: factor of every change.
    """
    for slip in slips:
        if slip.rate_hz != recording.rate_hz:
            raise RateError(
                f"a slip at {slip.rate_hz:g} Hz in a recording at {recording.rate_hz:g} Hz",
                where=recording.trial_id,
                cause="the scene was simulated at another rate",
                next_step="simulate the two-pad scene at the recording's rate",
            )

    samples = recording.samples.copy()
    phases: list[Phase] = []
    events = list(recording.events)
    left_out = list(recording.left_out)
    slips = by_speed(slips)
    for phase in recording.phases:
        placed = None
        if phase.situation == GRASP:
            placed = _placed(recording, phase, slips, rng)
        if placed is None:
            phases.append(phase)
            continue
        row, slip = placed
        event = _event(slip, row, phase, recording.rate_hz)
        stop = min(int(np.ceil(event.end_s * recording.rate_hz)), phase.stop)
        samples[row : phase.stop] = _slipping(recording, row, phase.stop, slip, size)
        phases.append(Phase(phase.first, row + 1, GRASP))
        phases.append(Phase(row + 1, stop, RISKY_SLIP))
        events.append(event)
        if stop < phase.stop:
            left_out.append((stop, phase.stop))

    return replace(
        recording,
        trial_id=f"{recording.trial_id}/slips",
        samples=samples,
        phases=tuple(phases),
        events=tuple(events),
        left_out=tuple(sorted(left_out)),
    )


def _slip_of(
    simulated: SimulatedTrial, scene_name: str, rate_hz: float
) -> SimulatedSlip | None:
    """The slip of a trial on the two pads; None where it has none, or none that is seen."""
    truth = simulated.truth
    if truth.load_onset_s is None or truth.gross_slip_s is None:
        return None
    t_s = simulated.motion.t_s
    before = int(np.searchsorted(t_s, truth.load_onset_s, side="right")) - 1
    gross = int(np.searchsorted(t_s, truth.gross_slip_s))
    if before < 0 or gross <= before or gross >= len(t_s):
        return None

    forces_n = simulated.motion.forces_n[before : gross + 1]
    held_n = forces_n[0, :, :2]
    at_gross_n = forces_n[-1, :, :2]
    loads_n = np.hypot(*at_gross_n.T)
    if forces_n.shape[1] != 2 or loads_n.min() <= 0.0:
        return None

    # In the lift the measured axis is that of the load, so a slip is turned onto it.
    along = at_gross_n / loads_n[:, None]
    change_n = ((forces_n[..., :2] - held_n) * along).sum(axis=2)
    # A pull against the load first takes load away.
    was_n = (held_n * along).sum(axis=1)
    against = np.where(was_n < -AGAINST_N, -1.0, 1.0)

    # From the hold's load to as much the other way is twice that load.
    size_n = np.where(against < 0.0, 0.5 * change_n[-1], loads_n)

    start_s = float(t_s[before])
    end_s = truth.gross_slip_s + AFTER_GROSS_S
    if truth.contact_lost_s is not None:
        end_s = min(end_s, truth.contact_lost_s)
    trial = simulated.trial
    return SimulatedSlip(
        name=f"{scene_name} {trial.action} {trial.number}",
        rate_hz=rate_hz,
        load_n=change_n * against,
        normal_n=forces_n[..., NORMAL] - forces_n[0, :, NORMAL],
        at_gross_n=float(size_n.sum()),
        onset_s=truth.load_onset_s - start_s,
        gross_s=truth.gross_slip_s - start_s,
        end_s=max(end_s, truth.gross_slip_s) - start_s,
    )


def _placed(
    recording: Recording,
    phase: Phase,
    slips: Sequence[SimulatedSlip],
    rng: np.random.Generator,
) -> tuple[int, SimulatedSlip] | None:
    """(row before the onset, slip) for a contact; None where none fits."""
    # Both drawn whatever comes of it, so that no lift shifts the draws of another.
    begins, speed = rng.uniform(size=2)
    low, high = BEGINS
    share = low + begins * (high - low)
    row = phase.first + int(share * (phase.stop - phase.first))
    load_n, _ = _held(recording, row)
    left_s = (phase.stop - row) / recording.rate_hz - BEFORE_RELEASE_S
    fitting = [slip for slip in slips if slip.gross_s <= left_s]
    if not fitting or np.abs(load_n).sum() < LEAST_LOAD_N:
        return None

    lasts = np.log([_lasts_s(slip) for slip in fitting])
    wanted = lasts[0] + speed * (lasts[-1] - lasts[0])
    return row, fitting[int(np.abs(lasts - wanted).argmin())]


def _held(recording: Recording, row: int) -> tuple[FloatArray, FloatArray]:
    """([2] load, [2] normal force) of the pads before a row."""
    first = max(0, row + 1 - round(LOAD_OVER_S * recording.rate_hz))
    held = recording.samples[first : row + 1].reshape(-1, 2, 3).mean(axis=0)
    return held[:, LOAD], held[:, NORMAL]


def _event(slip: SimulatedSlip, row: int, phase: Phase, rate_hz: float) -> RiskyEvent:
    """Where the slip stands in the recording; an event ends with the contact at the latest."""
    start_s = row / rate_hz
    end_s = min(start_s + slip.end_s, phase.stop / rate_hz)
    return RiskyEvent(start_s + slip.onset_s, start_s + slip.gross_s, end_s)


def _slipping(
    recording: Recording, row: int, stop: int, slip: SimulatedSlip, size: float
) -> FloatArray:
    """[stop - row, 6] the samples of the rest of a contact, with the slip in them."""
    pads = recording.samples[row:stop].reshape(-1, 2, 3).copy()
    load_n, _ = _held(recording, row)
    scale = size * float(np.abs(load_n).sum()) / slip.at_gross_n

    # After gross slip the change stays, and goes as the pads let go.
    rows = np.minimum(np.arange(len(pads)), len(slip.load_n) - 1)
    gross = min(len(slip.load_n), len(pads)) - 1
    let_go = np.ones((len(pads), 2))
    normal_n = pads[gross:, :, NORMAL]
    let_go[gross:] = np.clip(normal_n / np.maximum(normal_n[0], 1e-6), 0.0, 1.0)

    change_n = scale * let_go * slip.load_n[rows]
    pads[..., LOAD] += np.where(load_n < 0.0, -1.0, 1.0) * change_n
    # No pad pulls at what it touches.
    unchanged_n = pads[..., NORMAL]
    pressed_n = unchanged_n + scale * let_go * slip.normal_n[rows]
    pads[..., NORMAL] = np.maximum(pressed_n, np.minimum(unchanged_n, 0.0))
    return pads.reshape(-1, 6)


def _lasts_s(slip: SimulatedSlip) -> float:
    """From load onset to gross slip."""
    return slip.gross_s - slip.onset_s
