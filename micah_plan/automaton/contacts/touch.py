"""Contact geometry of a held object: heights of contact with a face, and collision states.

The height is a function of the joint. While the hand keeps its orientation the lowest corner of the moving part
decides: the object touches when the hand's height above the face is S(c) = max over corners v of -n'R(v(c) - p). Where
one edge stays the lowest and S decreases as the joint moves on, pressing moves the joint and the edge slides: a *line*
contact. It ends where a face of the part lies flush. From there on the part lies flat, and pressing moves the joint
further only if the held part rotates in the hand: a *surface* contact, in which the hand's height follows from the
lever between hand and hinge.

Both heights are sines of a turning joint. A piece stands for its own by the chord between its ends, so that the
automaton stays affine and every event of it can be located exactly: at the ends, where parts lie flush and latch, the
chord is exact; between them it is a little off (by 0.9 mm for 0.15 m over 0.4 rad).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.arrays import ROUND_OFF, Floats
from micah_plan.automaton.contacts.values import Face, Grip
from micah_plan.automaton.hybrid import Primitive

# A shorter lever than this [m, or m/m for a sliding joint] jams: it takes more force than a hand has.
_LEAST_LEVER = 0.02
_SAMPLES = 721
_ROUNDING = 1e-13


@dataclass(frozen=True)
class TouchPiece:
    """A stretch of the joint's range that pressing passes through in one kind of contact.

    Attributes:
        kind: ``"line"`` or ``"surface"``.
        begin, end: configurations; pressing leads from `begin` to `end` [rad or m].
        begin_height, end_height: of the hand above the face there [m]; the latter is smaller.
    """

    kind: Literal["line", "surface"]
    begin: float
    end: float
    begin_height: float
    end_height: float

    @property
    def slope(self) -> float:
        """Change of height per change of the joint [m/rad or 1]."""
        return (self.end_height - self.begin_height) / (self.end - self.begin)

    @property
    def direction(self) -> int:
        """The direction in which pressing moves the joint: +1 or -1."""
        return 1 if self.end > self.begin else -1


def box_corners(shapes: tuple[Primitive, ...]) -> Floats:
    """(k, 3) corners of the boxes around shapes, in their part's frame [m]."""
    lines = []
    for shape in shapes:
        if shape.kind == "box":
            half = np.array(shape.size) / 2
        elif shape.kind == "cylinder":
            half = np.array([shape.size[0], shape.size[0], shape.size[1] / 2])
        else:
            half = np.full(3, shape.size[0])
        signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        lines.append(Rotation.from_quat(shape.quaternion).apply(signs * half) + np.array(shape.position))
    return np.concatenate(lines) if lines else np.zeros((0, 3))


def moved(points: Floats, displacement: float, turns: bool) -> Floats:
    """(k, 3) points of the moving part in the hinge frame when the joint is `displacement` beyond the datum."""
    if not turns:
        return np.asarray(points + np.array([0.0, 0.0, displacement]))
    # About -y, written out: a range of contacts asks for thousands of turns, each too small for SciPy's transforms.
    c, s = np.cos(displacement), np.sin(displacement)
    return np.asarray(points @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]))


def touch_pieces(grip: Grip, face: Face, datum: float, low: float, high: float, turns: bool) -> tuple[TouchPiece, ...]:
    """The contacts of the moving part with a face, in the order of the joint's range.

    Args:
        datum: configuration at which the shapes are given.
        low, high: range of the joint [rad or m].
        turns: whether the joint is revolute.
    """
    geometry = _Geometry.of(grip, face, datum, turns)
    lines = _line_pieces(geometry, low, high)
    pieces: list[TouchPiece] = list(lines)
    for line in lines:
        next_line = any(np.isclose(neighbour.begin, line.end) for neighbour in lines)
        limit = high if line.direction > 0 else low
        if next_line or abs(limit - line.end) < ROUND_OFF or not grip.pivots or not turns:
            continue
        surface = _surface_piece(geometry, line, limit)
        if surface is not None:
            pieces.append(surface)
    return tuple(sorted(pieces, key=lambda piece: min(piece.begin, piece.end)))


def resting_height(grip: Grip, face: Face, datum: float, c: float, turns: bool) -> float:
    """Height of the hand above a face at first contact in configuration c, without rotation in the hand."""
    geometry = _Geometry.of(grip, face, datum, turns)
    return max(geometry.height(c), geometry.held_height)


@dataclass(frozen=True, eq=False)
class _Geometry:
    """Hand point (3,), normal of the face in the hinge frame (3,), corners (k, 3) of the moving part at the datum."""

    point: Floats
    normal: Floats
    corners: Floats
    held_height: float
    datum: float
    turns: bool

    @staticmethod
    def of(grip: Grip, face: Face, datum: float, turns: bool) -> _Geometry:
        outward = face.sign * np.eye(3)[face.axis]
        normal = Rotation.from_rotvec(grip.rotation).inv().apply(outward)
        point = np.array(grip.point)
        held = box_corners(grip.held.shapes)
        held_height = float(np.max(-(held - point) @ normal, initial=-np.inf))
        return _Geometry(point, normal, box_corners(grip.moving.shapes), held_height, datum, turns)

    def heights(self, c: float) -> Floats:
        """(k,) hand's height at which each corner touches."""
        return np.asarray(-(moved(self.corners, c - self.datum, self.turns) - self.point) @ self.normal)

    def height(self, c: float) -> float:
        """Height of the hand above the face at which the object touches, at configuration c [m]."""
        return float(self.heights(c).max())

    def lowest(self, c: float) -> int:
        """The corner that touches first; of an edge's corners the first."""
        heights = self.heights(c)
        return int(np.flatnonzero(heights >= heights.max() - _ROUNDING)[0])

    def lever(self, corner: int, c: float) -> float:
        """Change of the height at which a corner touches per change of the joint [m/rad or 1]."""
        at = moved(self.corners[corner], c - self.datum, self.turns)
        motion = np.cross([0.0, -1.0, 0.0], at) if self.turns else np.array([0.0, 0.0, 1.0])
        return float(-motion @ self.normal)

    def flat_height(self, flat: float, c: float) -> float:
        """Hand height with the part lying flat as at `flat`, the held part rotated in the hand by c - flat."""
        hand = moved(self.point, flat - c, turns=True)
        return float(hand @ self.normal + np.max(-moved(self.corners, flat - self.datum, turns=True) @ self.normal))


def _line_pieces(geometry: _Geometry, low: float, high: float) -> list[TouchPiece]:
    """Intervals with a single lowest edge whose lever moves the joint, without those where the held part touches."""
    grid = np.linspace(low, high, _SAMPLES)
    states = [_lowest_corner_and_slope(geometry, c) for c in grid]
    breaks = [low]
    for (a, at_a), (b, at_b) in pairwise(zip(grid, states, strict=True)):
        if at_a != at_b:
            breaks.append(_state_change(geometry, float(a), float(b), at_a))
    # Where a part lies flush exactly at an end of the range two edges touch at once; that is the end of one piece.
    breaks = [at for at in breaks if at == low or min(at - low, high - at) > ROUND_OFF]
    breaks.append(high)
    pieces = []
    for a, b in pairwise(breaks):
        middle = _lowest_corner_and_slope(geometry, (a + b) / 2)
        if middle is None or b - a < ROUND_OFF:
            continue
        begin, end = (a, b) if middle[1] < 0 else (b, a)
        pieces.append(TouchPiece("line", begin, end, geometry.height(begin), geometry.height(end)))
    return pieces


def _lowest_corner_and_slope(geometry: _Geometry, c: float) -> tuple[int, int] | None:
    """(lowest corner, sign of the height's slope); None where the joint jams or the held part touches."""
    lowest = geometry.lowest(c)
    slope = geometry.lever(lowest, c)
    if abs(slope) < _LEAST_LEVER or geometry.held_height > geometry.height(c):
        return None
    return lowest, int(np.sign(slope))


def _state_change(geometry: _Geometry, a: float, b: float, at_a: tuple[int, int] | None) -> float:
    """The point between a and b where the state of a ends, up to round-off."""
    while b - a > 1e-13:
        middle = (a + b) / 2
        if middle in (a, b):
            break
        a, b = (middle, b) if _lowest_corner_and_slope(geometry, middle) == at_a else (a, middle)
    return b


def _surface_piece(geometry: _Geometry, line: TouchPiece, limit: float) -> TouchPiece | None:
    """The surface contact after a line contact, where a face lies flush; None if pressing does not move the joint."""
    flat = line.end
    between = np.linspace(flat, limit, _SAMPLES)
    heights = np.array([geometry.flat_height(flat, c) for c in between])
    if abs(heights[0] - line.end_height) > 1e-6 or np.any(np.diff(heights) >= 0):
        return None
    lever = (heights[0] - heights[-1]) / abs(limit - flat)
    if lever < _LEAST_LEVER:
        return None
    return TouchPiece("surface", flat, limit, float(heights[0]), float(heights[-1]))
