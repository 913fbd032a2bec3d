"""Sentences of arms that cannot follow a path, with remedies."""

from __future__ import annotations

from collections.abc import Sequence

from micah_plan.message import message
from micah_plan.quantities import plain, quantity

MOVE_ROOT = "move the robot's root"
MOVE_ROOT_OR_GRASP = "move the robot's root or the grasp"
MOVE_GRASP_OR_ROOT = "move the grasp, or the robot's root"
MOVE_ROOT_GRASP_OR_SCENE = "move the robot's root, the grasp or the scene"
SMALLER_STEPS = "take smaller steps (planner.max_step), or move the robot's root"


@message
def singularity(knot: int, manipulability: float) -> str:
    """A knot near a singularity."""
    return f"the arm is near a singularity at knot {knot}: manipulability {plain(manipulability, 2)}"


@message
def jump(joint: str, amount: float, knot: int) -> str:
    """A joint that would move too far between two knots [rad or m]."""
    return f"joint '{joint}' would jump by {plain(amount)} at knot {knot}"


@message
def collision(pair: tuple[str, ...], distance: float, knot: int) -> str:
    """Two solids that meet, or come too close [m]."""
    first, second, *_ = pair
    apart = quantity(abs(distance), "m")
    how = f"meets {second}, {apart} deep" if distance < 0 else f"comes within {apart} of {second}"
    return f"{first} {how}, at knot {knot}"


@message
def joint_limit(knot: int, away: float, turned: float, joints: Sequence[tuple[str, str]]) -> str:
    """A pose beyond joint limits (joint, ``lower`` or ``upper``) [m, rad]."""
    limits = [f"'{name}' ({end})" for name, end in joints]
    return f"{_misses(knot, away, turned)}: joint limit of {', '.join(limits)}"


@message
def unreachable(knot: int, away: float, turned: float) -> str:
    """A pose out of reach [m, rad]."""
    return f"{_misses(knot, away, turned)}: it is out of reach"


def _misses(knot: int, away: float, turned: float) -> str:
    return f"the tool stays {quantity(away, 'm')} and {quantity(turned, 'rad')} from its pose at knot {knot}"
