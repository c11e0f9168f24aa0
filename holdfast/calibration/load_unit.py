"""The unit of a load column that names none, from the readings themselves.

The unit of eflesh_calibration is written nowhere ("weight"). The evidence, printed with every run:

- A reading of exactly -1 is no load: nearly every second row has it, and no other reading is below
  zero. It is left out.
- The deeper half of a press gives the pad's stiffness, and its end the largest load. In newtons the
  pad would carry 3.5 kN at 380 N/mm under a probe that an arm holds; in gram-force 34 N at 3.7 N/mm
  (shear: 18 N at 1.1 N/mm).
- The authors publish errors of 0.27 N and 0.12 N. A network is not 250 times better than the best
  linear map of the same readings, so newtons are out; nor is it worse than a linear map, so
  millinewtons are out. Gram-force is what is left.
- Centinewtons differ from gram-force by 2 %, which the data cannot resolve; a column called
  "weight" is more likely gram-force.

The field needs no guess: it moves in steps of 2.4 (x, y) and 3.872 (z), or 0.6 and 0.968, which are
16 and 4 times the MLX90393's 0.150 and 0.242 uT.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from holdfast.calibration.study import PUBLISHED_N, Probing
from holdfast.drivers.calibration_fit import fit
from holdfast.edge_runtime.contract import NORMAL_AXIS, FloatArray
from holdfast.edge_runtime.errors import UnitError

UNITS_N = {"newton": 1.0, "gram-force": 9.80665e-3, "millinewton": 1e-3}
LARGEST_PLAUSIBLE_N = 200.0
"""More than an arm can push into a palm-sized printed pad."""


def load_unit(
    probings: Sequence[Probing], axis: int, loads: FloatArray, depth_mm: FloatArray
) -> tuple[str, tuple[str, ...]]:
    """(unit of the load column, the evidence).

    Raises UnitError unless readings and published error leave exactly one unit.
    """
    published = PUBLISHED_N["normal" if axis == NORMAL_AXIS else "shear"]
    blocks = np.repeat(np.arange(len(probings)), [len(one.load) for one in probings])
    linear = fit(
        np.concatenate([one.field_ut for one in probings]),
        np.concatenate([one.load for one in probings]),
        blocks,
    )
    units_rmse = float(np.sqrt(np.mean(linear.held_out_n[:, axis] ** 2)))
    stiffness = _stiffness_per_mm(loads, depth_mm)
    reach = f"up to {loads.max():.0f} at {depth_mm.max():.0f} mm"
    lines = [f"load column: steps of {_resolution(loads):g}, {reach}"]
    left = []
    for unit, newton in UNITS_N.items():
        ratio = published / (units_rmse * newton)
        fits = loads.max() * newton < LARGEST_PLAUSIBLE_N and 0.05 <= ratio <= 1.0
        left += [unit] if fits else []
        lines.append(
            f"as {unit}: largest {loads.max() * newton:.4g} N, stiffness {stiffness * newton:.3g} "
            f"N/mm; the published {published} N would be {ratio:.2g} of a linear map's error: "
            + ("possible" if fits else "out")
        )
    if len(left) != 1:
        raise UnitError(
            f"the load column fits {' and '.join(left) or 'no known unit'}",
            cause="; ".join(lines),
            next_step="ask the authors of the recording",
        )
    doubt = "; the data cannot exclude centinewton (2 % more)" if left == ["gram-force"] else ""
    return left[0], (*lines, f"taken as {left[0]}{doubt}")


def _resolution(loads: FloatArray) -> float:
    """Smallest step between two readings."""
    return float(np.round(np.diff(np.unique(loads)).min(), 6))


def _stiffness_per_mm(loads: FloatArray, depth_mm: FloatArray) -> float:
    """Slope of the load over the deeper half of the press, least squares."""
    deep = depth_mm > 0.5 * depth_mm.max()
    return float(np.polyfit(depth_mm[deep], loads[deep], 1)[0])
