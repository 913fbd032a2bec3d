"""Rows that no single joint explains: why no automaton can be made of them, in one line.

A misfit is not skipped: the joints before and after it share one coordinate only through the rows between them, and a
part that moves off its joint once can do so again, in every mode of the automaton.
"""

from __future__ import annotations

from micah_plan.automaton.certainty import Misfit
from micah_plan.automaton.graph import KinematicGraph, Segment
from micah_plan.errors import InputError
from micah_plan.quantities import quantity

_REMEDY = (
    "check that the part is stiff, moves in one way at a time and is tracked relative to what it is mounted on, or "
    "leave these rows out"
)


def misfit_of(segment: Segment) -> Misfit | None:
    """Why no single joint explains a segment's rows; None if its joint does."""
    return None if segment.certainty is None else segment.certainty.misfit


def misfit_error(graph: KinematicGraph) -> InputError | None:
    """The refusal for the first rows that no single joint explains, to be raised; None if there are none."""
    found = [
        (segment, misfit, edge.child)
        for edge in graph.edges
        for segment in edge.segments
        if (misfit := misfit_of(segment)) is not None
    ]
    if not found:
        return None
    more = f" (and {len(found) - 1} more such stretch{'es' if len(found) > 2 else ''})" if len(found) > 1 else ""
    return InputError(_sentence(*found[0]) + more, remedy=_REMEDY)


def _sentence(segment: Segment, misfit: Misfit, part: str) -> str:
    distances = [(misfit.position, misfit.position_noise, "m")]
    if misfit.rotation is not None and misfit.rotation_noise is not None:
        distances.append((misfit.rotation, misfit.rotation_noise, "rad"))
    missed = " and ".join(quantity(miss, unit, degrees=False) for miss, _, unit in distances)
    noise = " and ".join(quantity(alone, unit, digits=2, degrees=False) for _, alone, unit in distances)
    return (
        f"no single-joint model fits rows {segment.start} to {segment.end} of part '{part}' (run {segment.run}): the "
        f"best, {segment.joint.kind}, misses them by {missed} where the measurement alone would leave {noise}"
    )
