"""Sentences of explorations: why they end, and what was noticed on the way."""

from __future__ import annotations

from micah_plan.message import message
from micah_plan.quantities import count, quantity

CHANGED = "the hand, its force sensor or the tracker no longer behaves as before"
DRY_FRICTION = "dry friction against the spring of the hand"


# Ends


@message
def opened(way: float) -> str:
    """The handle moved as far as asked [m]."""
    return f"the handle moved {quantity(way, 'm')}"


@message
def nothing_moved(force: float) -> str:
    """No push up to a force moved the handle [N]."""
    return f"nothing moved it with up to {force:.3g} N; a latch that holds more is not excluded"


@message
def nothing_moved_on(way: float, force: float) -> str:
    """No push moved the handle further."""
    return f"after {way:.2g} m nothing with up to {force:.3g} N moved it further"


@message
def hand_unknown() -> str:
    """The hand's stiffness is too uncertain for safe pushes."""
    return "too little is known about the hand to push safely; perhaps it does not hold the handle"


@message
def workspace_ends() -> str:
    """The chain leads out of the workspace."""
    return "the workspace ends here"


@message
def handle_not_seen(steps: int) -> str:
    """The tracker lost the handle."""
    return f"the tracker has not seen the handle for {count(steps, 'step')}"


@message
def handle_lost() -> str:
    """The hand lost the handle."""
    return "the hand has lost the handle: commands meet no force, and it does not follow them"


@message
def force_exceeded(force: float, largest: float) -> str:
    """A measured force above the scene's limit [N]."""
    return f"the hand met {force:.3g} N, more than the {largest:.3g} N that are allowed: {CHANGED}"


@message
def rest_pulls(force: float) -> str:
    """Even a command of zero would pull too hard [N]."""
    return (
        "the tracker sees the handle elsewhere than its force indicates, and commands count from there: even a command "
        f"of zero would pull with {force:.3g} N"
    )


@message
def force_contradicts_tracker(expected: float, seen: float) -> str:
    """The motion that forces indicate and the one that the tracker saw [m]."""
    return f"by its force the handle moved {expected:.2g} m, but the tracker saw {seen:.2g} m of that: {CHANGED}"


@message
def plant_failed(failure: str) -> str:
    """The machine failed during a command."""
    return failure


# Complaints about hands


@message
def forces_late() -> str:
    """Forces lag by a command."""
    return "forces are those of the command before: answer only when everything is at rest again"


@message
def forces_reversed() -> str:
    """Forces have the other sign."""
    return "the measured forces point against the commands: give the force that the hand exerts at the handle"


@message
def no_force() -> str:
    """Pushes meet hardly any force."""
    return "pushes meet hardly any force: the hand does not hold the handle, or nothing holds the object"


@message
def forces_turned() -> str:
    """Forces and commands are in different frames."""
    return "the measured forces are turned against the commands: give both in the base frame"


@message
def stiffness_differs(least: float, largest: float) -> str:
    """A hand that is softer in one direction than in another [N/m]."""
    soft, stiff = quantity(least, "N/m"), quantity(largest, "N/m")
    return f"the hand is a spring of {soft} in one direction and of {stiff} in another: make it alike in all"


# Notes


@message
def blind_until(steps: int, step: int) -> str:
    """Steps without a measured pose."""
    return f"the tracker saw nothing for {count(steps, 'step')}, until step {step}"


@message
def slipped(step: int, distance: float) -> str:
    """A slip of the grip [m]."""
    return f"step {step}: the handle is seen {1000.0 * distance:.0f} mm from where the force indicates"


def searching(step: int) -> str:
    """Progress before anything moved."""
    return f"step {step}: looking for a direction in which it moves"


def following(step: int, kind: str, way: float) -> str:
    """Progress along a joint [m]."""
    return f"step {step}: {kind}, {quantity(way, 'm')} so far"
