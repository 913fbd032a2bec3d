"""An arm's trajectory in a plan file, and back."""

from __future__ import annotations

from typing import Any

import numpy as np

from micah_plan.documents.located import Located
from micah_plan.documents.plan_document import ArmDocument
from micah_plan.task.plan import ArmTrajectory

_AGAIN = "solve the problem again"


def arm_data(arm: ArmTrajectory) -> dict[str, Any]:
    """The plain data of an arm's trajectory."""
    return {
        "joints": list(arm.joints),
        "positions": arm.positions.tolist(),
        "manipulability": arm.manipulability.tolist(),
        "clearance": list(arm.clearance),
        "least_clearance": arm.least_clearance,
        "closest_pair": list(arm.closest_pair),
        "closest_knot": int(arm.closest_knot),
        "deviation": float(arm.deviation),
    }


def arm_of(document: ArmDocument | None, knots: int, located: Located) -> ArmTrajectory | None:
    """The arm's trajectory of a plan file.

    Args:
        knots: of the belief trajectory.

    Raises:
        InputError: if a length disagrees with the joints or the knots.
    """
    if document is None:
        return None
    width = len(document.joints)
    for key in ("positions", "manipulability", "clearance"):
        if len(getattr(document, key)) != knots:
            raise located.error(("arm", key), f"expected {knots} knots, found {len(getattr(document, key))}", _AGAIN)
    for i, row in enumerate(document.positions):
        if len(row) != width:
            raise located.error(("arm", "positions", i), f"expected {width} joints, found {len(row)}", _AGAIN)
    if document.closest_knot >= knots or len(document.closest_pair) not in (0, 2):
        raise located.error(("arm",), "its closest pair and knot are none of the plan", _AGAIN)
    return ArmTrajectory(
        joints=tuple(document.joints),
        positions=np.array(document.positions, dtype=float).reshape(knots, width),
        manipulability=np.array(document.manipulability, dtype=float),
        clearance=tuple(document.clearance),
        least_clearance=document.least_clearance,
        closest_pair=tuple(document.closest_pair),
        closest_knot=document.closest_knot,
        deviation=document.deviation,
    )
