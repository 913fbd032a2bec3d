"""A screw parameterised by its positions: Frenet frame at one point, curvature, and lead angle.

A piece of a helix shows its tangent, its curvature and its torsion, each less clearly than the one before. Axis, centre
and pitch depend on all of these. In the frame of the path only one number is poorly determined: the lead angle, whose
tangent is torsion by curvature, and pitch by radius.

Source: do Carmo, Differential Geometry of Curves and Surfaces, 1976, section 1-5 (Frenet's frame).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from micah_plan.arrays import DIFFERENCE, Floats
from micah_plan.automaton.joint import Joint, screw
from micah_plan.learning.joints.parametrization import JointChart, cross, frame_of
from micah_plan.learning.joints.quaternions import rotated, rotation_quaternion

NUMBERS = 7  # turn of the frame (3) and shift across the path (2), both in the frame; curvature; lead angle
_FLATTEST = 1e-3  # 1/m; a straighter path has no frame
_STEEPEST = 1.55  # rad; a steeper path is straight


@dataclass(frozen=True, eq=False)
class Helix:
    """A helix at a point [m]: rows of its frame are tangent, normal and binormal.

    Attributes:
        curvature: of the path [1/m].
        lead: angle of the path against the plane across its axis [rad]; 0 on a circle.
    """

    point: Floats
    frame: Floats
    curvature: float
    lead: float

    @property
    def width(self) -> float:
        """Arc length per radian [m]."""
        return float(np.cos(self.lead)) / self.curvature

    @property
    def axis(self) -> Floats:
        """(3,) unit vector."""
        return np.asarray(np.sin(self.lead) * self.frame[0] + np.cos(self.lead) * self.frame[2])

    def moved(self, numbers: Floats) -> Helix | None:
        """The helix after a step of the first of the `NUMBERS`; None outside their range."""
        step = np.zeros(NUMBERS)
        step[: len(numbers)] = numbers
        curvature, lead = self.curvature + float(step[5]), self.lead + float(step[6])
        if curvature < _FLATTEST or abs(lead) > _STEEPEST:
            return None
        turned = np.asarray(rotated(rotation_quaternion(self.frame.T @ step[:3]), self.frame))
        return Helix(self.point + step[3:5] @ self.frame[1:], turned, curvature, lead)

    def joint(self, length: float, like: Joint) -> Joint:
        """The screw whose origin lies an arc length [m] before the point; its orientation is arbitrary."""
        axis, center, pitch, position = _parts(self, length)
        return screw(axis, center, float(pitch[0]), position, like.quaternion)


def helix_of(joint: Joint, length: float) -> Helix | None:
    """A screw's path at an arc length [m] from its origin; None where it is straight."""
    frame, radius = frame_of(joint)
    square = radius**2 + joint.pitch**2
    if radius < _FLATTEST * square:
        return None
    width = float(np.sqrt(square))
    c = length / width
    axis = frame[2]
    outwards = np.cos(c) * frame[0] + np.sin(c) * frame[1]
    around = cross(axis, outwards)
    point = np.array(joint.center) + radius * outwards + joint.pitch * c * axis
    rows = [(radius * around + joint.pitch * axis) / width, -outwards, (radius * axis - joint.pitch * around) / width]
    lead = float(np.arctan2(joint.pitch, radius))
    return Helix(point, np.stack(rows), radius / square, float(np.clip(lead, -_STEEPEST, _STEEPEST)))


def chart_slopes(helix: Helix, length: float, joint: Joint, chart: JointChart) -> Floats:
    """(p, 7) derivative of the screw's parameters (`chart_of` without orientations) by those of its helix."""
    slopes = np.zeros((chart.free.shape[1], NUMBERS))
    across = chart.free[5:, 5:].T
    turns, shifts = helix.frame, helix.frame[1:]
    # Turns and shifts of the path move the screw as a rigid body.
    slopes[:2, :3] = chart.basis @ turns.T
    slopes[2:4, :3] = chart.basis @ np.cross(turns, np.subtract(joint.center, helix.point)).T
    slopes[5:, :3] = across @ np.cross(turns, np.subtract(joint.position, helix.point)).T
    slopes[2:4, 3:5], slopes[5:, 3:5] = chart.basis @ shifts.T, across @ shifts.T
    for number, size in ((5, DIFFERENCE * helix.curvature), (6, DIFFERENCE)):
        step = np.zeros(NUMBERS)
        step[number] = size
        ahead, behind = (helix.moved(sign * step) for sign in (1.0, -1.0))
        if ahead is None or behind is None:
            continue
        slope = (np.concatenate(_parts(ahead, length)) - np.concatenate(_parts(behind, length))) / (2 * size)
        of_axis, of_center, of_pitch, of_position = np.split(slope, (3, 6, 7))
        tilt = cross(np.array(joint.axis), of_axis)
        slopes[:, number] = np.concatenate(
            [chart.basis @ tilt, chart.basis @ of_center, of_pitch, across @ of_position]
        )
    return slopes


def _parts(helix: Helix, length: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Axis, centre, pitch (1,) and position of the screw whose origin lies an arc length [m] before the point."""
    width, axis, outwards = helix.width, helix.axis, -helix.frame[1]
    radius, pitch, c = width * np.cos(helix.lead), width * float(np.sin(helix.lead)), -length / width
    center = helix.point - radius * outwards + pitch * c * axis
    return axis, center, np.array([pitch]), center + radius * (np.cos(c) * outwards + np.sin(c) * cross(axis, outwards))
