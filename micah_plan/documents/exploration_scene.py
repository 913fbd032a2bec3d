"""Scene files (`problems/explore_handle.yaml`): a hand that holds an unknown handle."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from micah_plan.documents.fields import Distance, Line, Positive, Quaternion, Vector3
from micah_plan.documents.layout import Document, Scope, doc
from micah_plan.documents.located import Located
from micah_plan.documents.problem import load_problem
from micah_plan.documents.validation import validated
from micah_plan.documents.yaml_lines import read_yaml_file
from micah_plan.errors import InputError
from micah_plan.task.exploration_scene import Scene


class HoldsDocument(Document):
    position: Vector3 = doc("Place of the handle in the base frame [m].")
    quaternion: Quaternion | None = doc("Its orientation, scalar last; default: as first measured.", None)


class WorkspaceDocument(Document):
    low: Vector3 = doc("The corner with the smallest coordinates, base frame [m].")
    high: Vector3 = doc("The corner with the largest coordinates [m].")

    def check(self, at: Located) -> None:
        for axis, low, high in zip("xyz", self.low, self.high, strict=True):
            if not low < high:
                raise at.at("high").error(f"expected a corner above {low:g} in {axis}, found {high:g}", "swap them")


class SceneDocument(Document):
    """An unknown object held by its handle, with the limits for `micah-plan explore`."""

    makes = Scene

    format: Literal["micah-plan/scene/1"] = doc("Format and version of this file.")
    largest_force: Positive = doc("The largest force that the hand may exert [N].", 45.0)
    largest_stiffness: Positive | None = doc(
        "The largest stiffness of the hand, as its controller is set [N/m]: commands stay below the largest force with "
        "it, whatever the force sensor tells. Absent: as pushes tell it.",
        None,
    )
    largest_step: Distance = doc("The largest displacement of the hand in one command [m].", 0.05)
    steps: Annotated[int, Field(ge=1, le=10_000)] = doc("How many commands may be given.", 300)
    opening: Distance = doc("The way of the handle after which the object counts as opened [m].", 0.2)
    holds: HoldsDocument | None = doc(
        "Where the hand holds the handle; a first measurement more than 5 cm from there is refused. Default: where it "
        "is first measured.",
        None,
    )
    workspace: WorkspaceDocument | None = doc("A box which the handle is not led out of; default: none.", None)
    simulated: Line | None = doc(
        "A problem file, relative to this one, whose object the plants `nominal` and `mujoco` put into the hand, where "
        "the problem starts; other plants ignore it.",
        None,
    )

    def read(self, at: Located, scope: Scope) -> Any:
        self.check(at)
        if self.workspace is not None:
            self.workspace.check(at.at("workspace"))
        holds, box = self.holds, self.workspace
        simulated = None
        if self.simulated is not None:
            path = Path(at.source).parent / self.simulated
            try:
                simulated = load_problem(path)
            except InputError as error:
                within = "" if error.where is None else f", {error.where}"
                raise at.at("simulated").error(f"{path}{within}: {error.problem}", error.remedy) from None
            if simulated.hold is not None or len(simulated.automaton.links) != 1:
                raise at.at("simulated").error("expected an object that stands and has one moving part", "name another")
        return Scene(
            largest_force=self.largest_force,
            largest_stiffness=self.largest_stiffness,
            largest_step=self.largest_step,
            steps=self.steps,
            opening=self.opening,
            position=None if holds is None else holds.position,
            quaternion=None if holds is None else holds.meanings(at.at("holds"), scope)["quaternion"],
            low=None if box is None else box.low,
            high=None if box is None else box.high,
            simulated=simulated,
        )


def load_scene(path: str | Path) -> Scene:
    """The scene that a file describes.

    Raises:
        InputError: if it cannot be used; one line with file, line, key, expected and found content, and the remedy.
    """
    located = read_yaml_file(path)
    scene: Scene = validated(located, SceneDocument).read(located, {})
    return scene
