"""The next experiment worth making: what would tell apart effects that a recording cannot."""

from __future__ import annotations

from micah_plan.quantities import count, quantity

_SEPARATING: dict[frozenset[str], str] = {
    frozenset({"gain", "sensor_scale"}): (
        "drive the part against a stop whose place is known: a sensor's scale moves the stop's reading, a gain does not"
    ),
    frozenset({"gain", "frame_rotation"}): (
        "command a displacement across the joint: in a turned frame it moves the part, with a gain it does not"
    ),
    frozenset({"gain", "follow"}): "command places that stay where they are for many rows, and not displacements",
    frozenset({"gain", "lag"}): "command one long step and then none: a lag goes on moving, a gain does not",
    frozenset({"gain", "dead_zone"}): "command steps of very different sizes: friction takes as much off each",
    frozenset({"gain", "saturation"}): "command small and large steps: a limit only cuts the large ones",
    frozenset({"gain", "spring"}): "hold the commands at zero far from the rest position: only a spring moves the part",
    frozenset({"bias", "drift"}): "let the part rest against a stop: a sensor that drifts goes on, a bias does not",
    frozenset({"bias", "gravity"}): "visit the whole range: gravity changes with the angle, a bias does not",
    frozenset({"bias", "spring"}): "visit the whole range: a spring's pull changes its sign, a bias does not",
    frozenset({"spring", "gravity"}): "visit a wider range of angles: gravity bends back, a spring does not",
    frozenset({"spring", "latch"}): "visit places far from the attraction: a spring pulls on, a latch lets go",
    frozenset({"delay", "lag"}): "command one large step after a rest: a delay moves all at once, a lag gradually",
    frozenset({"lag", "backlash"}): "reverse slowly: play loses the same distance at any speed, a lag less",
    frozenset({"delay", "backlash"}): "reverse slowly: play loses the same distance at any speed, a delay less",
    frozenset({"backlash", "stick_slip"}): "command many small steps one way: with play all but the first arrive",
    frozenset({"guard_shift", "limit"}): (
        "push the part against the end and look whether it latches: a shifted threshold changes the mode, a stop not"
    ),
    frozenset({"guard_shift", "guard_hysteresis"}): "go through the threshold in both directions",
    frozenset({"guard_shift", "sensor_scale"}): "compare readings with a ruler in the middle of the range",
    frozenset({"guard_shift", "drift"}): "rest at the end for a while: a drifting reading goes on",
}


def separating(one: str, other: str) -> str:
    """The experiment that tells two effects apart."""
    known = _SEPARATING.get(frozenset({one, other}))
    return known or f"vary size and direction of the commands over the whole range, to tell {one} from {other}"


def for_alike_runs(name: str) -> str:
    """The experiment where all runs make the same motion."""
    return f"start elsewhere, and stop on the way: if it is {name}, only the place matters and not what went before"


def for_unexplained(where: str) -> str:
    """The experiment for what no effect explains."""
    return f"repeat slow and fast motions in both directions {where}, with rests in between"


def for_missing_mode(place: float, unit: str) -> str:
    """The experiment for a mode that the automaton lacks."""
    return (
        f"record slow motion through {quantity(place, unit)} in both directions and learn the model again, with that "
        "mode: micah-plan learn RECORDING.csv -o MODEL.yaml"
    )


def for_nothing(rows: int, moved: float, unit: str) -> str:
    """The experiment where nothing was found."""
    return (
        f"there is nothing to find in {count(rows, 'row')} over {quantity(moved, unit)}: commands that are larger, "
        "reverse and rest at both ends would show smaller effects"
    )
