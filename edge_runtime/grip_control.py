"""Controller, friction margin and supervisor joined: from one prediction to one grip command."""

from __future__ import annotations

import math
from dataclasses import replace

from holdfast.edge_runtime.contract import BoolArray, FloatArray, Prediction, Unit
from holdfast.edge_runtime.errors import UsageError
from holdfast.edge_runtime.friction import FrictionMargin
from holdfast.edge_runtime.grip import CONTROLLERS, AnswerRules, Controller, GripSense
from holdfast.edge_runtime.grip_command import HOLD, IDLE, MODES, YIELD, GripCommand
from holdfast.edge_runtime.lanes import ONE_LANE, Lanes, Number
from holdfast.edge_runtime.supervisor import Limits, Supervisor

FORCE_CONTROLLERS = ("pd-shear", "sliding-mode")
"""Controllers whose parameters are in N: they need forces, not raw fields."""
LARGEST = 1e9
"""No sensor reads more, N or uT; a larger number counts as no force."""
CUE_P = AnswerRules.from_p
"""p(risky slip) from which the wearer's vibration cue begins; full at 1."""


def controller_of(
    name: str, lanes: Lanes, rate_hz: float, setting: float | None = None
) -> Controller:
    """A controller by its name; setting: None for its default. Raises UsageError."""
    if name not in CONTROLLERS:
        raise UsageError(
            f"no controller {name!r}", next_step=f"choose from {', '.join(CONTROLLERS)}"
        )
    kind = CONTROLLERS[name]
    return kind(lanes, rate_hz, kind.SETTING if setting is None else setting)


class GripLoop:
    """Friction margin, controller and supervisor of one hand, or of many."""

    def __init__(
        self,
        lanes: Lanes,
        rate_hz: float,
        controller: Controller,
        limits: Limits | None = None,
        shear_gain: float = 1.0,
    ) -> None:
        self.controller = controller
        self.margin = FrictionMargin(lanes, rate_hz, shear_gain)
        self.supervisor = Supervisor(lanes, rate_hz, limits)

    def step(self, sense: GripSense) -> Number:
        """One sample: the target, N a side; 0 for none."""
        self.margin.step(sense)
        margin, given_n = self.margin, self.supervisor.given_n
        wanted_n = self.controller.want(sense, given_n, margin.needed_n)
        return self.supervisor.step(sense, wanted_n, self.controller.fresh, margin.holds_n)


class GripControl:
    """The grip controller of one hand, beside its monitor: one command a sample.

    name: of CONTROLLERS. setting: the controller's own, None for its default. unit: of the forces.
    In uT or count there is no N: a friction ratio still means something, a grip in N does not, so
    controllers that need N are refused, the ceiling is the hand's own business, and every command
    says `reduced`. Raises UsageError.
    """

    def __init__(
        self,
        name: str,
        rate_hz: float,
        setting: float | None = None,
        unit: Unit = "N",
        n_fingers: int = 6,
        limits: Limits | None = None,
    ) -> None:
        self.reduced, self._n_fingers = unit != "N", n_fingers
        if self.reduced and name in FORCE_CONTROLLERS:
            raise UsageError(
                f"{name} needs forces in N, this model answers in {unit}",
                next_step="calibrate the sensors (holdfast calibrate), or choose holdfast",
            )
        self.limits = limits or Limits()
        controller = controller_of(name, ONE_LANE, rate_hz, setting)
        limits = replace(self.limits, ceiling_n=math.inf) if self.reduced else self.limits
        self._loop = GripLoop(ONE_LANE, rate_hz, controller, limits)

    def step(self, prediction: Prediction, forces: FloatArray, valid: BoolArray) -> GripCommand:
        """One sample. forces [C]: prepared, in the model's unit; valid [S]. Raises UsageError."""
        if forces.shape != (3 * self._n_fingers,) or valid.shape != (self._n_fingers,):
            raise UsageError(
                f"{forces.size // 3} fingers, the grip controller was made for {self._n_fingers}",
                next_step="use a model made for this hand",
            )
        target_n = self._loop.step(sense_of(prediction, forces, valid))
        return self._command(prediction, target_n)

    def _command(self, prediction: Prediction, target_n: float) -> GripCommand:
        supervisor, margin = self._loop.supervisor, self._loop.margin
        mode = int(supervisor.mode)
        observed = margin.mu_hat > 0.0
        return GripCommand(
            sequence=prediction.sequence,
            t_ns=prediction.t_acquired_ns,
            mode=MODES[mode],
            target_n=target_n if target_n > 0.0 and not self.reduced else None,
            slew_n_s=self.limits.slew_n_s,
            feedback=_cue(prediction),
            reason=_reason(prediction, mode, self.reduced),
            mu_hat=margin.mu_hat if observed else None,
            margin=margin.margin if observed else None,
            needed_n=margin.needed_n if observed and not self.reduced else None,
        )


def sense_of(prediction: Prediction, forces: FloatArray, valid: BoolArray) -> GripSense:
    """What a controller knows of one sample; no force where a sensor is not valid or not finite."""
    f, grip_n, load_n = forces.tolist(), 0.0, 0.0
    for x, y, z, good in zip(f[::3], f[1::3], f[2::3], valid.tolist(), strict=True):
        if good and abs(x) + abs(y) + abs(z) < LARGEST:
            grip_n += z if z > 0.0 else 0.0
            load_n += math.sqrt(x * x + y * y)
    grip_n *= 0.5
    return GripSense(
        grip_n=grip_n,
        load_n=load_n,
        p_risky=prediction.p_risky,
        p_safe=prediction.p_situation["safe_slip"],
        known=prediction.state != "unknown",
        empty=prediction.state == "nothing",
        opening=prediction.opening,
        overridden=prediction.overridden,
    )


def _cue(prediction: Prediction) -> float:
    """Strength of the wearer's vibration cue, 0 to 1."""
    if prediction.state == "unknown" or prediction.p_risky < CUE_P:
        return 0.0
    return prediction.p_risky


def _reason(prediction: Prediction, mode: int, reduced: bool) -> str:
    if prediction.overridden:
        reason = "override"
    elif prediction.opening:
        reason = "opening"
    elif prediction.state == "unknown":
        reason = f"unknown: {prediction.why}"
    elif mode in (IDLE, YIELD, HOLD):
        reason = prediction.state
    else:
        reason = "risky slip" if prediction.p_risky >= CUE_P else "friction margin"
    return f"{reason} (reduced: no N)" if reduced else reason
