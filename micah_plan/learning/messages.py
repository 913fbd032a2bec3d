"""Sentences of learning."""

from __future__ import annotations

from micah_plan.message import message
from micah_plan.quantities import quantity


@message
def small_motion(part: str, moved: float, turned: float | None, wander: tuple[float, float]) -> str:
    """A motion hardly larger than the tracker's assumed wander [m, rad]; turned None: no orientations."""
    motion = f"moves over {quantity(moved, 'm', digits=2)}"
    settings = f"LearnSettings.position_wander ({wander[0]:g} m)"
    if turned is not None:
        motion += f" and turns by {quantity(turned, 'rad', digits=2)}"
        settings += f" and rotation_wander ({wander[1]:g} rad)"
    return (
        f"part '{part}' {motion}, hardly more than a tracker is assumed to wander: its stops and its kind of joint may "
        f"be missed; if the tracker is better, lower {settings}"
    )
