"""Sentences on models: improbable answers of learning, implausible numbers, effects that planning leaves out."""

from __future__ import annotations

from micah_plan.message import message
from micah_plan.quantities import count, percent, quantity


@message
def kind_uncertain(
    parts: tuple[str, str], kind: str, rows: tuple[int, int], probability: float, likelier: tuple[str, float]
) -> str:
    """A joint's kind with a low probability; (part, its base), and the likeliest other kind."""
    return (
        f"{parts[0]} is {kind} relative to {parts[1]} (rows {rows[0]} to {rows[1]}) with a probability of only "
        f"{percent(probability, 0)}, {likelier[0]} with {percent(likelier[1], 0)}; a longer motion, or more runs, "
        "would decide"
    )


@message
def change_count_uncertain(
    parts: tuple[str, str], run: int, changes: int, probability: float, likelier: tuple[int, float]
) -> str:
    """A number of changepoints with a low probability, and the likeliest number."""
    return (
        f"the joint of {parts[0]} relative to {parts[1]} changes {count(changes, 'time')} in run {run} with a "
        f"probability of only {percent(probability, 0)}, {count(likelier[0], 'time')} with {percent(likelier[1], 0)}"
    )


@message
def number_too_large(place: str, size: float, unit: str, most: float, than: str) -> str:
    """A number above its scale."""
    return f"{place}: {quantity(size, unit)} is more than {than}, {quantity(most, unit)}; check the unit"


@message
def length_too_large(place: str, size: float, unit: str) -> str:
    """A length that is too large for metres."""
    return (
        f"{place}: {quantity(size, unit)} is farther than a room is wide; lengths are in m: are these millimetres? "
        "Then divide by 1000"
    )


@message
def number_too_small(place: str, size: float, unit: str, least: float) -> str:
    """A number below its scale."""
    return f"{place}: {quantity(size, unit)} is less than the least, {quantity(least, unit)}; check the unit"


@message
def transition_never_taken(edge: tuple[str, str], first: tuple[str, str]) -> str:
    """A transition (name, guard) that an earlier one always preempts."""
    return (
        f"transition {edge[0]} ('{edge[1]}') is never taken: {first[0]} ('{first[1]}'), listed before it, is possible "
        "wherever it is; list the more general one last"
    )


@message
def part_jumps(edge: str, part: str, distance: float) -> str:
    """A transition that moves a part without motion [m]."""
    return (
        f"transition {edge}: part {part} jumps by {quantity(distance, 'm')} between the joints of its modes; check "
        "position, axis and center of both"
    )


@message
def effect_left_out(effect: str, coordinate: str, depends_on_past: bool) -> str:
    """An effect that planning ignores, since it depends on earlier inputs, or on the orientation of a parent."""
    why = "it depends on earlier inputs" if depends_on_past else "commands are given in the base frame"
    return f"planner, filter and nominal plant leave out the {effect} of {coordinate}: {why}"
