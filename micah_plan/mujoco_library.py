"""MuJoCo, an optional library: imported in one place, with one sentence where it is missing."""

from __future__ import annotations

from types import ModuleType
from typing import Any

from micah_plan.errors import MissingDependencyError


def import_mujoco(what: str = "the MuJoCo plant") -> ModuleType | Any:
    """The library. It is kept from writing its warnings to a file in the current folder.

    Args:
        what: needs it, for the message.

    Raises:
        MissingDependencyError: if it is not installed.
    """
    try:
        import mujoco
        import mujoco.rollout
    except ImportError as error:
        raise MissingDependencyError.of("sim", f"{what} needs MuJoCo") from error
    mujoco.set_mju_user_warning(lambda _: None)  # an exception from here would end the process
    return mujoco
