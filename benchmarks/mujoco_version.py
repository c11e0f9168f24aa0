"""Whether MuJoCo is here: it has an environment of its own (`make world`)."""

from __future__ import annotations

from holdfast.core.errors import UsageError


def require_mujoco(target: str) -> str:
    """The version. target: of make, which installs it. Raises UsageError."""
    try:
        import mujoco
    except ModuleNotFoundError:
        raise UsageError(
            "this needs MuJoCo, which is not installed here",
            cause="it has an environment of its own, outside .venv",
            next_step=f"make {target}",
        ) from None
    version: str = mujoco.__version__
    return version
