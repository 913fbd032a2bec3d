"""How a hand holds the object, and what it may touch: the entry `hold` of a problem file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import Field

from micah_plan.automaton.contacts.values import Grip, HeldPart
from micah_plan.documents.layout import ZERO, Document, Name, Positive, Vector3, doc, plain
from micah_plan.documents.located import Located
from micah_plan.documents.parts import ShapeDocument, shapes_of
from micah_plan.task.problem import Hold

_AXES = "xyz"


class HeldPartDocument(Document):
    name: Name = doc("Of the part.")
    shapes: Annotated[list[ShapeDocument], Field(min_length=1)] = doc(
        "Its solids in the hinge frame, with the joint at the datum: y along the hinge, the moving part turns from x "
        "towards z as the joint's coordinate grows."
    )


class ReachDocument(Document):
    lower: Vector3 = doc("Lower corner [m].")
    upper: Vector3 = doc("Upper corner [m].")


class ContactDocument(Document):
    body: Name = doc("Body of the scene.")
    face: Literal["+x", "-x", "+y", "-y", "+z", "-z"] = doc("Which side of it, by where it looks.")


class HoldDocument(Document):
    held: HeldPartDocument = doc("The part in the hand.")
    moving: HeldPartDocument = doc("The part that swings.")
    point: Vector3 = doc("Where the hand is, in the hinge frame [m]; its position is the state x, y, z.")
    rotation: Vector3 = doc("Rotation vector from the hinge frame to the base frame [rad].", ZERO)
    travel: Positive = doc("How far the joint opens from the datum [rad or m].")
    pivots: bool = doc("Whether the held part may turn in the hand when pressed on.", False)
    datum: float | None = doc("Configuration at which shapes are given [rad or m]; default: where it latches.", None)
    coordinate: Name = doc("Name of the joint's coordinate in this problem.", "theta")
    reach: ReachDocument = doc("Where the hand may go.")
    contacts: list[ContactDocument] = doc(
        "Faces that the moving part may touch; anything else is to be kept clear of.", list
    )


def hold_of(document: HoldDocument | None, bodies: Sequence[str], located: Located) -> Hold | None:
    """What is under the key `hold`.

    Args:
        bodies: names of those of the scene.

    Raises:
        InputError: for shapes that are none, an unknown body, parts of one name and a reach without room.
    """
    if document is None:
        return None
    for i, contact in enumerate(document.contacts):
        located.at("contacts", i, "body").number(contact.body, bodies, "body")
    lower, upper = document.reach.lower, document.reach.upper
    if any(low >= high for low, high in zip(lower, upper, strict=True)):
        problem = f"expected lower corners below the upper ones, found {lower} and {upper}"
        raise located.at("reach").error(problem, "give the hand room")
    if document.held.name == document.moving.name:
        raise located.at("moving", "name").error("both parts have the same name", "name them apart")
    held, moving = (
        HeldPart(part.name, shapes_of(part.shapes, located.at(key, "shapes")))
        for key, part in (("held", document.held), ("moving", document.moving))
    )
    grip = Grip(
        held=held,
        moving=moving,
        point=document.point,
        rotation=document.rotation,
        travel=document.travel,
        pivots=document.pivots,
        datum=document.datum,
        coordinate=document.coordinate,
    )
    return Hold(grip, tuple(_contact_of(contact) for contact in document.contacts), lower, upper)


def hold_data(hold: Hold) -> dict[str, Any]:
    """The entry of a hold with every setting written out, which `hold_of` reads back."""
    contacts = [{"body": body, "face": "+-"[sign < 0] + _AXES[axis]} for body, axis, sign in hold.contacts]
    data = {**vars(hold.grip), "reach": hold, "contacts": contacts}
    data = plain(HoldDocument, data, keep=HoldDocument.model_fields.keys() - {"datum"})
    if "datum" in data:
        data["datum"] = data.pop("datum")
    return data


def _contact_of(document: ContactDocument) -> tuple[str, int, int]:
    """(body, axis, sign) of a face."""
    sign, axis = document.face
    return document.body, _AXES.index(axis), 1 if sign == "+" else -1
