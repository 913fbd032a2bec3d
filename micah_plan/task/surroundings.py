"""A scene for held objects: boxes to avoid, and faces to touch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from micah_plan.arrays import ROUND_OFF, Floats
from micah_plan.automaton.contacts.values import Face, Solid, Surroundings
from micah_plan.automaton.joint import Vector3
from micah_plan.task.body import Body, Shape, corners, vector3


def surroundings_of(
    scene: Sequence[Body], contacts: Sequence[tuple[str, int, int]], lower: Vector3, upper: Vector3
) -> Surroundings:
    """Bounding boxes of all shapes along the base axes; stacks that fill one box are merged.

    Args:
        scene: the bodies.
        contacts: (body, axis, sign) of the faces that may be touched. Such a body is no obstacle: other contacts with
            it are resting on it.
        lower, upper: corners of where the hand may go [m].
    """
    touched = {body for body, _, _ in contacts}
    solids = []
    for body in scene:
        for number, shape in enumerate(body.shapes, start=1):
            if body.name not in touched:
                low, high = _box(body, (shape,))
                name = body.name if len(body.shapes) == 1 else f"{body.name} {number}"
                solids.append(Solid(name, vector3(low), vector3(high)))
    return Surroundings(_joined(solids), faces_of(scene, contacts), lower, upper)


def faces_of(scene: Sequence[Body], contacts: Sequence[tuple[str, int, int]]) -> tuple[Face, ...]:
    """The faces (body, axis, sign) of a scene that may be touched."""
    boxes = {body.name: _box(body, body.shapes) for body in scene if body.name in {name for name, _, _ in contacts}}
    return tuple(Face(body, axis, sign, float(boxes[body][sign > 0][axis])) for body, axis, sign in contacts)


def _joined(solids: Sequence[Solid]) -> tuple[Solid, ...]:
    """The solids with adjacent boxes merged: every solid costs planning time."""
    found: list[Solid] = []
    for solid in solids:
        whole = solid
        while rival := next((rival for rival in found if _is_box(whole, rival)), None):
            found.remove(rival)
            low, high = np.minimum(whole.lower, rival.lower), np.maximum(whole.upper, rival.upper)
            whole = Solid(f"{rival.name}, {whole.name}", vector3(low), vector3(high))
        found.append(whole)
    return tuple(found)


def _is_box(first: Solid, second: Solid) -> bool:
    """Whether the union of two boxes is a box: equal along two axes, without a gap along the third."""
    ends = np.array([[first.lower, first.upper], [second.lower, second.upper]])
    differs = ~np.isclose(ends[0], ends[1], rtol=0.0, atol=ROUND_OFF).all(axis=0)
    if differs.sum() != 1:
        return bool(differs.sum() == 0)
    (first_low, first_high), (second_low, second_high) = ends[:, :, differs.argmax()]
    return bool(max(first_low, second_low) <= min(first_high, second_high) + ROUND_OFF)


def _box(body: Body, shapes: Sequence[Shape]) -> tuple[Floats, Floats]:
    """Lower and upper corner of shapes in the base frame [m]."""
    points = body.pose.apply(np.concatenate([corners(shape) for shape in shapes]))
    return points.min(axis=0), points.max(axis=0)
