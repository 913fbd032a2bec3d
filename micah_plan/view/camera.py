"""Camera placement: the motion is spread out and not occluded."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from micah_plan.arrays import Floats

if TYPE_CHECKING:
    from micah_plan.view.scene import DrawnScene


VIEW_ANGLE_DEG = 36.0
_MARGIN = 1.08
_HIDDEN_COST = 2.0
_ELEVATION, _LOW_ELEVATION = math.radians(28.0), math.radians(13.0)
_AZIMUTHS = np.radians(np.arange(-60, 300, 15))


def camera(scene: DrawnScene, motion: Floats, blockers: Floats | None = None) -> dict[str, object]:
    """Position, target and clipping that show the whole scene, from where the motion spreads widest.

    Args:
        motion: (k, 3) points that the moving parts pass.
        blockers: (b, 2, 3) lower and upper corners of boxes that should not stand before them [m].
    """
    lower, upper = scene.bounds()
    target = (lower + upper) / 2
    radius = max(float(np.linalg.norm(upper - lower)) / 2, 1e-3)
    best = viewing_direction(motion, target, radius, blockers)
    distance = _distance_to_see(upper - target, best)
    position = target + distance * best
    return {
        "position": [float(p) for p in position],
        "target": [float(p) for p in target],
        "near": distance / 200,
        "far": distance * 50,
        "angle": VIEW_ANGLE_DEG,
    }


def viewing_direction(motion: Floats, target: Floats, radius: float, blockers: Floats | None = None) -> Floats:
    """(3,) unit vector from the target (3,) [m] to an elevated camera that shows the motion (k, 3) best.

    Args:
        radius: of the visible scene [m].
        blockers: as for `camera`.
    """
    toward = _directions(_ELEVATION)
    if blockers is not None and len(blockers):
        toward = np.concatenate([toward, _directions(_LOW_ELEVATION)])  # to look under what stands above
    hidden = np.array([_hidden_share(way, motion, blockers) for way in toward])
    quality = np.array([_view_quality(way, motion, target, radius) for way in toward])
    return np.asarray(toward[np.argmax(quality - _HIDDEN_COST * hidden)])


def _directions(elevation: float) -> Floats:
    """(a, 3) unit vectors all around, at an elevation [rad]."""
    level = math.cos(elevation) * np.stack([np.cos(_AZIMUTHS), np.sin(_AZIMUTHS)], axis=1)
    return np.column_stack([level, np.full(len(level), math.sin(elevation))])


def _hidden_share(way: Floats, motion: Floats, blockers: Floats | None) -> float:
    """Fraction of the points (k, 3) that boxes (b, 2, 3) occlude from a camera in direction `way`."""
    if blockers is None or not len(blockers):
        return 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = (blockers[None] - motion[:, None, None]) / way  # (k, b, 2, 3): where the rays cross the boxes' planes
    enter, leave = np.nanmax(ends.min(axis=2), axis=2), np.nanmin(ends.max(axis=2), axis=2)
    return float(((leave > enter) & (leave > 0)).any(axis=1).mean())


def _distance_to_see(half: Floats, way: Floats) -> float:
    """Distance [m] from which a camera in direction `way` sees a box of half lengths `half` in a square picture."""
    across = np.cross([0.0, 0.0, 1.0], way)
    across /= np.linalg.norm(across)
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T * half
    offset = np.abs(corners @ np.column_stack([across, np.cross(way, across)])).max(axis=1)
    tangent = math.tan(math.radians(VIEW_ANGLE_DEG) / 2)
    return float((corners @ way + _MARGIN * offset / tangent).max())


def _view_quality(way: Floats, motion: Floats, target: Floats, radius: float) -> float:
    """Score of a camera direction `way` (unit, (3,)) for showing the motion; larger is better.

    It should see the motion spread out (an arc as an arc), stand on the side of the moving part, and a little off the
    perpendicular of the motion, where a panel would be edge on in the middle of its swing.
    """
    centred = motion - motion.mean(axis=0)
    flat = centred - np.outer(centred @ way, way)
    wide, high, _ = np.sqrt(np.linalg.svd(flat.T @ flat, compute_uv=False))
    directions, extent, _ = np.linalg.svd(centred.T @ centred)
    spread = (0.3 * wide + high) / max(math.sqrt(extent[0]), 1e-12)
    side = float(way @ (motion.mean(axis=0) - target)) / radius
    off_perpendicular = abs(abs(float(way @ directions[:, 0])) - 0.45)
    return float(spread + 0.5 * side - 0.8 * off_perpendicular)
