"""A hand that turns on the object: positions on a joint with orientations that contradict it.

A robot whose fingers pivot on a handle, or a person whose wrist rotates, moves its tool round a circle and rotates it
by another angle; or along a line, and rotates it about another axis. The positions are right then, but the orientations
are not those of the part ("Recognizing Orientation Slip in Human Demonstrations", arXiv 2108.04695). The residuals of
the motion of the origin are compared: of a circle or a line through the positions, and of p = c + R r with the
orientations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.arrays import Floats
from micah_plan.recording import messages

# A path is far better than orientations if it leaves so much less, and what they leave is larger than trackers err [m].
_FAR_BETTER, _LEAST_LEFT = 0.2, 0.002
# Least angle on a circle, and least difference of the rotation, for a decision [rad].
_LEAST_ANGLE, _LEAST_SLIP = 0.25, 0.15
_SHARE, _STDS = 0.2, 6.0  # of the angle; of what is left of a slip in proportion to it: trackers turn parts by noise
_ALONG = np.cos(np.radians(15.0))  # a turn about the line of motion is that of a screw
_LEAST_WAY, _STILL = 0.02, 0.02  # m, rad


@dataclass(frozen=True)
class TurnedGrip:
    """A slipping tool with the joint of its positions.

    Attributes:
        radius: of the circle of its positions [m]; None of a line.
        angle: on that circle [rad], or the length of the line [m].
        turned: by how much it turns meanwhile [rad].
    """

    radius: float | None
    angle: float
    turned: float

    def warning(self, part: str) -> str:
        """The finding in a sentence, with the remedy."""
        if self.radius is None:
            return messages.grip_slips_on_line(part, self.angle, self.turned)
        return messages.grip_slips_on_circle(part, self.angle, self.radius, self.turned)


def turned_grip(position: Floats, rotation: Rotation) -> TurnedGrip | None:
    """The slip of a tool at positions (n, 3) [m] with orientations (n,); None if both agree or are inconclusive."""
    away = position - position.mean(axis=0)
    spread, axes = np.linalg.svd(away, full_matrices=False)[1:]
    if len(position) < 10 or spread[0] / np.sqrt(len(position)) < 0.3 * _LEAST_WAY:
        return None
    left = _left_by_turns(position, rotation)
    turns = (rotation * rotation[len(position) // 2].inv()).as_rotvec()
    off_line = float(np.sqrt((spread[1] ** 2 + spread[2] ** 2) / len(position)))
    if off_line < _FAR_BETTER * left and left > _LEAST_LEFT:
        return _along_line(away @ axes[0], axes[0], turns)
    circle = _circle(away @ axes[:2].T)
    if circle is None:
        return None
    middle, radius, off_circle = circle
    off = float(np.hypot(off_circle, spread[2] / np.sqrt(len(position))))
    if not (off < _FAR_BETTER * left and left > _LEAST_LEFT):
        return None
    arm = away @ axes[:2].T - middle
    angle = np.unwrap(np.arctan2(arm[:, 1], arm[:, 0]))
    turned = turns @ np.cross(axes[0], axes[1])
    gone, follows, rest = float(np.ptp(angle)), *_line(angle, turned)
    slip = abs(1.0 - follows) * gone
    if gone < _LEAST_ANGLE or slip < max(_LEAST_SLIP, _SHARE * gone, _STDS * rest):
        return None
    return TurnedGrip(radius, gone, abs(follows) * gone)


def _line(at: Floats, values: Floats) -> tuple[float, float]:
    """Slope of values (n,) over places (n,), and the residual std."""
    slope, start = np.polyfit(at, values, 1)
    return float(slope), float((values - slope * at - start).std())


def _along_line(way: Floats, axis: Floats, turns: Floats) -> TurnedGrip | None:
    main = np.linalg.svd(turns - turns.mean(axis=0), full_matrices=False)[2][0]
    follows, rest = _line(way, turns @ main)
    turned = abs(follows) * float(np.ptp(way))
    if turned < max(_LEAST_SLIP, _STDS * rest) or abs(float(main @ axis)) > _ALONG:
        return None
    return TurnedGrip(None, float(np.ptp(way)), turned)


def _left_by_turns(position: Floats, rotation: Rotation) -> float:
    """Root mean square residual [m] of p = c + R r, with the best constant c and r; of a line for a part at rest."""
    matrices = rotation.as_matrix()
    design = np.concatenate([np.tile(np.eye(3), (len(position), 1, 1)), matrices], axis=2).reshape(-1, 6)
    rest = position.ravel() - design @ np.linalg.lstsq(design, position.ravel(), rcond=None)[0]
    rest = rest.reshape(-1, 3)
    spread = np.linalg.svd(rest - rest.mean(axis=0), compute_uv=False)
    is_still = float((rotation * rotation[0].inv()).magnitude().max()) < _STILL
    along = spread[1:] if is_still else spread
    return float(np.sqrt((along**2).sum() / len(position)))


def _circle(points: Floats) -> tuple[Floats, float, float] | None:
    """Middle, radius and root mean square distance of the circle through points (n, 2) (Kåsa's fit, then Newton's)."""
    design = np.column_stack([2.0 * points, np.ones(len(points))])
    (x, y, c), *_ = np.linalg.lstsq(design, (points**2).sum(axis=1), rcond=None)
    middle, radius = np.array([x, y]), float(np.sqrt(max(c + x * x + y * y, 0.0)))
    for _ in range(10):
        arm = points - middle
        distance = np.linalg.norm(arm, axis=1)
        if not radius > 0.0 or not distance.min() > 0.0 or not radius < 1e3:
            return None
        slopes = np.column_stack([-arm / distance[:, None], -np.ones(len(points))])
        step = np.linalg.lstsq(slopes, radius - distance, rcond=None)[0]
        middle, radius = middle + step[:2], radius + float(step[2])
    distance = np.linalg.norm(points - middle, axis=1)
    return middle, radius, float(np.sqrt(np.mean((distance - radius) ** 2)))
