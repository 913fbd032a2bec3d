"""Grasp, contacts and release of an object: `hold` and `release` of a problem file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field

from micah_plan.automaton.contacts.values import AXES, Grip
from micah_plan.automaton.hybrid import Part
from micah_plan.documents.fields import (
    ITEMS,
    ZERO,
    Distance,
    Name,
    Place,
    Positive,
    StdOrZero,
    Vector3,
    named,
)
from micah_plan.documents.layout import Document, Scope, doc
from micah_plan.documents.located import Located
from micah_plan.documents.parts import ShapeDocument
from micah_plan.task.problem import Hold, Release


class HeldPartDocument(Document):
    makes = Part

    name: Name = doc("Name of the part.")
    shapes: Annotated[list[ShapeDocument], Field(min_length=1)] = doc(
        "Its solids in the hinge frame, with the joint at the datum: y along the hinge, the moving part turns from x "
        "towards z as the joint's coordinate grows."
    )


class ReachDocument(Document):
    lower: Vector3 = doc("Lower corner [m].")
    upper: Vector3 = doc("Upper corner [m].")


class ContactDocument(Document):
    body: Annotated[Name, named("body")] = doc("Body of the scene.")
    face: Literal["+x", "-x", "+y", "-y", "+z", "-z"] = doc("Side of it, by its outward direction.")

    def read(self, at: Located, scope: Scope) -> tuple[str, int, int]:
        """The (body, axis, sign) of the face."""
        sign, axis = self.face
        return self.meanings(at, scope)["body"], AXES.index(axis), 1 if sign == "+" else -1

    @classmethod
    def written(cls, value: tuple[str, int, int], scope: Scope) -> Mapping[str, Any]:
        body, axis, sign = value
        return {"body": body, "face": "+-"[sign < 0] + AXES[axis]}


class HoldDocument(Document):
    held: HeldPartDocument = doc("The part in the hand.")
    moving: HeldPartDocument = doc("The part that swings.")
    point: Vector3 = doc("Where the hand is, in the hinge frame [m]; its position is the state x, y, z.")
    rotation: Vector3 = doc("Rotation vector from the hinge frame to the base frame [rad].", ZERO)
    travel: Distance = doc("How far the joint opens from the datum [rad or m].")
    pivots: bool = doc("Whether the held part may turn in the hand when pressed on.", False)
    datum: Place | None = doc("Configuration at which shapes are given [rad or m]; default: where it latches.", None)
    coordinate: Name = doc("Name of the joint's coordinate in this problem.", "theta")
    reach: ReachDocument = doc("Where the hand may go.")
    contacts: list[ContactDocument] = doc(
        "Faces that the moving part may touch; it keeps clear of everything else.", list
    )

    def check(self, at: Located) -> None:
        lower, upper = self.reach.lower, self.reach.upper
        if any(low >= high for low, high in zip(lower, upper, strict=True)):
            problem = f"expected lower corners below the upper ones, found {lower} and {upper}"
            raise at.at("reach").error(problem, "give the hand room")
        if self.held.name == self.moving.name:
            raise at.at("moving", "name").error("both parts have the same name", "name them apart")

    def read(self, at: Located, scope: Scope) -> Hold:
        values = self.meanings(at, scope)
        contacts, reach = values.pop("contacts"), values.pop("reach")
        return Hold(Grip(**values), contacts, **reach)

    @classmethod
    def written(cls, value: Hold, scope: Scope) -> Mapping[str, Any]:
        return {**vars(value.grip), "reach": value, "contacts": value.contacts}


class ReleaseDocument(Document):
    makes = Release

    support: Annotated[Name, named("body")] = doc("Body of the scene on whose upper side the object is put.")
    support_std: StdOrZero = doc("How well the height of that side is known [m].", Release.support_std)
    step: Distance = doc("How far the hand goes down per step while it feels for the support [m].", Release.step)
    force: Positive = doc("Force at which the contact is felt [N].", Release.force)
    shift_std: StdOrZero = doc(
        "How far the object moves along x and along y when the gripper opens [m].", Release.shift_std
    )
    fingers: Annotated[dict[Name, Place], ITEMS] = doc(
        "Joints of the robot that open the gripper, and where they then are [rad or m].", dict
    )
    withdraw: Distance = doc("How far the hand then goes away from the object [m].", Release.withdraw)


HoldDocument.always_written = HoldDocument.model_fields.keys() - {"datum"}
