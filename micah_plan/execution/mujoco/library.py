"""The only importer of MuJoCo, and what of its warnings matters."""

from __future__ import annotations

from types import ModuleType
from typing import Any

from micah_plan.errors import InputError, MissingDependencyError


def import_mujoco() -> ModuleType | Any:
    """The library. It is kept from writing its warnings to a file in the current folder.

    Raises:
        MissingDependencyError: if it is not installed.
    """
    try:
        import mujoco
        import mujoco.rollout
    except ImportError as error:
        raise MissingDependencyError(
            "the MuJoCo plant needs the package 'mujoco'; install it with: pip install 'micah-plan[sim]'"
        ) from error
    mujoco.set_mju_user_warning(_ignore)
    return mujoco


def check_stable(mujoco: ModuleType | Any, data: Any) -> None:
    """Refuse to go on after a step that diverged: MuJoCo begins again from its initial state then.

    Raises:
        InputError: if positions, velocities or accelerations became huge.
    """
    kinds = mujoco.mjtWarning
    if any(data.warning[int(k)].number for k in (kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC)):
        raise InputError(
            f"the physics became unstable {float(data.time):.3g} s after its start",
            remedy="make the plant softer, heavier or better damped, or the model's parts larger",
        )


def _ignore(_: str) -> None:
    """`check_stable` reads the counts of warnings; an exception from here would end the process."""
