"""Joints: their entries in the modes of a model file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

import numpy as np

from micah_plan.automaton.joint import Joint, JointKind, ParameterCovariance
from micah_plan.documents.layout import IDENTITY, ZERO, Document, Listed, Matrix, Quaternion, Vector3, doc, plain
from micah_plan.documents.located import Located

_UNIT_TOLERANCE = 1e-3
_SYMMETRY_TOLERANCE = 1e-6
_UNUSED: Mapping[str, tuple[str, ...]] = {
    "rigid": ("axis", "center", "pitch"),
    "prismatic": ("center", "pitch", "held"),
    "revolute": ("pitch", "held"),
    "screw": ("held",),
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
    names: Annotated[tuple[ParameterName, ...], Listed(1)] = doc(
        "Parameters: tilts of the axis [rad], shifts of the centre [m], pitch [m/rad], origin [rad, m]."
    )
    matrix: Matrix = doc("Symmetric positive semi-definite, one row per name.")


class JointDocument(Document):
    kind: JointKind = doc("rigid, prismatic, revolute or screw.")
    position: Vector3 = doc("Origin of the part in the base frame at configuration 0 [m].")
    quaternion: Quaternion = doc("Its orientation there: unit quaternion, scalar last.", IDENTITY)
    axis: Vector3 = doc("Unit vector of motion or rotation in the base frame; not for rigid.", ZERO)
    center: Vector3 = doc("Point on the axis closest to `position` [m]; revolute and screw.", ZERO)
    pitch: float = doc("Translation along the axis per angle [m/rad]; only for screw.", 0.0)
    held: float = doc("Configuration that a rigid joint stands for [rad or m].", 0.0)
    covariance: CovarianceDocument | None = doc("Covariance of the parameters, if estimated.", None)


def joint_of(document: JointDocument, located: Located) -> Joint:
    """The joint that an entry describes."""
    check_unit(document.quaternion, located.at("quaternion"))
    for key in _UNUSED[document.kind]:
        if getattr(document, key) not in (ZERO, 0.0):
            problem = f"a {document.kind} joint has no {key}"
            raise located.at(key).error(problem, "remove it or correct the kind")
    if document.kind != "rigid":
        check_unit(document.axis, located.at("axis"))
    covariance = None
    if document.covariance is not None:
        covariance = _covariance_of(document.covariance, located.at("covariance"))
    return Joint(**dict(document) | {"covariance": covariance})


def joint_data(joint: Joint) -> dict[str, Any]:
    """The entry of a joint, which `joint_of` reads back."""
    return plain(JointDocument, joint)


def joint_remark(joint: Joint) -> str | None:
    """The standard deviations of a joint's parameters for people, for the end of the line of the covariance's names."""
    if joint.covariance is None:
        return None
    pairs = zip(joint.covariance.names, standard_deviations(joint.covariance.matrix), strict=True)
    return "std " + ", ".join(f"{std:.2g} {_unit(name)}" for name, std in pairs)


def check_unit(vector: Sequence[float], located: Located) -> None:
    """Raise an InputError unless a vector has unit length within a thousandth."""
    length = float(np.linalg.norm(vector))
    if abs(length - 1.0) > _UNIT_TOLERANCE:
        raise located.error(f"expected unit length, found length {length:.6g}", "normalise it")


def check_size(rows: Sequence[Sequence[float]], height: int, width: int, located: Located) -> None:
    """Raise an InputError unless a matrix has that many rows of that many entries."""
    if len(rows) != height or any(len(row) != width for row in rows):
        found = f"{len(rows)} rows of {', '.join(sorted({str(len(row)) for row in rows}))}"
        raise located.error(f"expected {height} rows of {width}, found {found}")


def standard_deviations(covariance: Sequence[Sequence[float]]) -> list[float]:
    """Those that a covariance states, 0 for variances below 0."""
    deviations: list[float] = np.sqrt(np.maximum(np.diag(np.array(covariance)), 0.0)).tolist()
    return deviations


def _covariance_of(document: CovarianceDocument, located: Located) -> ParameterCovariance:
    names = document.names
    if len(set(names)) < len(names):
        raise located.at("names").error("a parameter is named twice", "name each once")
    check_size(document.matrix, len(names), len(names), located.at("matrix"))
    matrix = np.array(document.matrix)
    scale = float(np.abs(matrix).max())
    symmetric = np.abs(matrix - matrix.T).max() <= _SYMMETRY_TOLERANCE * scale
    lowest = 0.0 if scale == 0.0 else float(np.linalg.eigvalsh(matrix / scale)[0])
    if not symmetric or lowest < -_SYMMETRY_TOLERANCE:
        problem = "expected a symmetric positive semi-definite matrix"
        raise located.at("matrix").error(problem, "correct it or leave the covariance out")
    return ParameterCovariance(names, document.matrix)


def _unit(parameter: str) -> str:
    kind = parameter.split("_")[0]
    return "m/rad" if kind == "pitch" else "rad" if kind in ("axis", "rotation") else "m"
