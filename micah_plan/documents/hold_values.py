"""The block `hold` of a problem file as a value, and back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from micah_plan.automaton.contacts.task import Grip, HeldPart
from micah_plan.documents.hold_document import HeldPartDocument, HoldDocument
from micah_plan.documents.located import KeyPath, Located
from micah_plan.documents.model_data import shape_data
from micah_plan.documents.part_values import shape_of
from micah_plan.task.problem import Hold

_AXES = "xyz"


def hold_of(document: HoldDocument | None, bodies: Sequence[str], located: Located) -> Hold | None:
    """What is under the key `hold`.

    Args:
        bodies: names of those of the scene.

    Raises:
        InputError: for shapes that are none, an unknown body, parts of one name and a reach without room.
    """
    if document is None:
        return None
    contacts = []
    for i, contact in enumerate(document.contacts):
        if contact.body not in bodies:
            raise located.unknown(("hold", "contacts", i, "body"), "body", contact.body, bodies)
        contacts.append((contact.body, _AXES.index(contact.face[1]), 1 if contact.face[0] == "+" else -1))
    reach = document.reach
    if any(low >= high for low, high in zip(reach.lower, reach.upper, strict=True)):
        problem = f"expected lower corners below the upper ones, found {reach.lower} and {reach.upper}"
        raise located.error(("hold", "reach"), problem, "give the hand room")
    if document.held.name == document.moving.name:
        raise located.error(("hold", "moving", "name"), "both parts have the same name", "name them apart")
    grip = Grip(
        held=_held_part(document.held, located, "held"),
        moving=_held_part(document.moving, located, "moving"),
        point=document.point,
        rotation=document.rotation,
        travel=document.travel,
        pivots=document.pivots,
        datum=document.datum,
        coordinate=document.coordinate,
    )
    return Hold(grip, tuple(contacts), reach.lower, reach.upper)


def hold_data(hold: Hold | None) -> dict[str, Any]:
    """The entry `hold` of a problem file; none without one."""
    if hold is None:
        return {}
    grip = hold.grip
    data = {
        "held": _held_data(grip.held),
        "moving": _held_data(grip.moving),
        "point": list(grip.point),
        "rotation": list(grip.rotation),
        "travel": grip.travel,
        "pivots": grip.pivots,
        "coordinate": grip.coordinate,
        "reach": {"lower": list(hold.lower), "upper": list(hold.upper)},
        "contacts": [
            {"body": body, "face": ("+" if sign > 0 else "-") + _AXES[axis]} for body, axis, sign in hold.contacts
        ],
    }
    return {"hold": data if grip.datum is None else {**data, "datum": grip.datum}}


def _held_part(document: HeldPartDocument, located: Located, key: str) -> HeldPart:
    path: KeyPath = ("hold", key, "shapes")
    return HeldPart(document.name, tuple(shape_of(s, located, (*path, i)) for i, s in enumerate(document.shapes)))


def _held_data(part: HeldPart) -> dict[str, Any]:
    return {"name": part.name, "shapes": [shape_data(shape) for shape in part.shapes]}
