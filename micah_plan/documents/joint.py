"""Joints: their entries in the modes of a model file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar, Literal

import numpy as np

from micah_plan.arrays import EQUAL
from micah_plan.automaton.joint import IDENTITY, Joint, JointKind, ParameterCovariance
from micah_plan.automaton.path import path
from micah_plan.documents.fields import (
    ZERO,
    Listed,
    Matrix,
    Place,
    Quaternion,
    Row,
    Vector3,
    check_covariance,
    of_unit_length,
)
from micah_plan.documents.layout import Document, doc
from micah_plan.documents.located import Located
from micah_plan.errors import InputError

_UNUSED: Mapping[str, tuple[str, ...]] = {
    "rigid": ("axis", "center", "pitch"),
    "prismatic": ("center", "pitch", "held"),
    "revolute": ("pitch", "held"),
    "screw": ("held",),
    "path": ("axis", "center", "pitch", "held"),
}
ParameterName = Literal[
    "axis_1",
    "axis_2",
    "center_1",
    "center_2",
    "pitch",
    "rotation_1",
    "rotation_2",
    "rotation_3",
    "position_1",
    "position_2",
    "position_3",
]


class CovarianceDocument(Document):
    makes = ParameterCovariance

    names: Annotated[tuple[ParameterName, ...], Listed(1)] = doc(
        "Parameters: tilts of the axis [rad], shifts of the centre [m], pitch [m/rad], origin [rad, m]."
    )
    matrix: Matrix = doc("Symmetric positive semi-definite, one row per name.")

    def check(self, at: Located) -> None:
        if len(set(self.names)) < len(self.names):
            raise at.at("names").error("a parameter is named twice", "name each once")
        at = at.at("matrix")
        check_size(self.matrix, len(self.names), len(self.names), at)
        check_covariance(self.matrix, at)


class JointDocument(Document):
    makes = Joint
    renamed: ClassVar = {"held": "fixed_at"}

    kind: JointKind = doc("rigid, prismatic, revolute, screw or path.")
    position: Vector3 = doc("Origin of the part in the base frame at configuration 0 [m].")
    quaternion: Quaternion = doc("Its orientation there: unit quaternion, scalar last.", IDENTITY)
    axis: Vector3 = doc("Unit vector of motion or rotation in the base frame; not for rigid and path.", ZERO)
    center: Vector3 = doc("Point on the axis closest to `position` [m]; revolute and screw.", ZERO)
    pitch: Place = doc("Translation along the axis per angle [m/rad]; only for screw.", 0.0)
    held: Place = doc("Configuration that a rigid joint stands for [rad or m].", 0.0)
    covariance: CovarianceDocument | None = doc("Covariance of the parameters, as older files have it.", None)
    knots: Annotated[tuple[Row, ...], Listed()] = doc(
        "Poses along a path: rows of c [m], position (3) [m] and quaternion (4).", ()
    )

    def check(self, at: Located) -> None:
        for key in _UNUSED[self.kind]:
            if getattr(self, key) not in (ZERO, 0.0):
                raise at.at(key).error(f"a {self.kind} joint has no {key}", "remove it or correct the kind")
        if self.kind != "path" and self.knots:
            raise at.at("knots").error(f"a {self.kind} joint has no knots", "remove them or correct the kind")
        if self.kind == "path":
            self._check_path(at)
        elif self.kind != "rigid":
            of_unit_length(self.axis, at.at("axis"))

    def _check_path(self, at: Located) -> None:
        try:
            start = path(self.knots)
        except InputError as error:
            raise at.at("knots").error(error.problem, "give smooth poses in the order of c") from None
        off = np.subtract(start.position + start.quaternion, (*self.position, *self.quaternion))
        if np.abs(off).max() > EQUAL:
            there = ", ".join(f"{value:.6g}" for value in start.position)
            raise at.at("position").error(f"expected the pose of the path at c = 0, ({there})", "correct it")


def joint_remark(joint: Joint) -> str | None:
    """Standard deviations of a joint's parameters as a comment for the covariance's names."""
    if joint.covariance is None:
        return None
    pairs = zip(joint.covariance.names, standard_deviations(joint.covariance.matrix), strict=True)
    return "std " + ", ".join(f"{std:.2g} {_unit(name)}" for name, std in pairs)


def check_size(rows: Sequence[Sequence[float]], height: int, width: int, located: Located) -> None:
    """Raise an InputError unless a matrix has the given size."""
    if len(rows) != height or any(len(row) != width for row in rows):
        shape = f"{len(rows)} rows of {', '.join(sorted({str(len(row)) for row in rows}))}"
        raise located.error(f"expected {height} rows of {width}, found {shape}")


def standard_deviations(covariance: Sequence[Sequence[float]]) -> list[float]:
    """Standard deviations from a covariance, 0 for variances below 0."""
    deviations: list[float] = np.sqrt(np.maximum(np.diag(np.array(covariance)), 0.0)).tolist()
    return deviations


def _unit(parameter: str) -> str:
    kind = parameter.split("_")[0]
    return "m/rad" if kind == "pitch" else "rad" if kind in ("axis", "rotation") else "m"
