"""The page of a tracked video: frames with tags, part frames and joints overlaid, beside the 3-D scene."""

from __future__ import annotations

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.graph import BASE, KinematicGraph
from micah_plan.automaton.joint import Joint, radius
from micah_plan.automaton.kinematics import forward
from micah_plan.view.learned import ColoredSegment, colored_segments, fits_no_joint
from micah_plan.view.palette import FRAME_AXES, INK, category
from micah_plan.view.recording_page import recording_page
from micah_plan.vision.pictures import Color, Stroke, drawn_pictures
from micah_plan.vision.track_tags import Tracked

_ARC_POINTS = 60
_LEAST_AXIS = 0.05  # m


def tracked_page(found: Tracked, graph: KinematicGraph | None = None, *, title: str = "Tracked parts") -> str:
    """The page as HTML text.

    Args:
        found: what was tracked; its video must still be there.
        graph: the segments learned from its recording; None shows the tracks alone.
    """
    segments = colored_segments(found.recording, graph)
    times = found.recording.time

    def color_of(part: str, time: float) -> Color:
        if part == found.base:
            return _rgb(INK)
        own = [each for each in segments if each.edge.child == part]
        now = [each for each in own if times[each.rows[0]] <= time] or own[:1]
        return _rgb(now[-1].color if now else category(found.footage.layout.parts.index(part)))

    strokes = [stroke for each in segments for stroke in _strokes(each, times)]
    pictures = drawn_pictures(found.footage, color_of, strokes, [_rgb(color) for color in FRAME_AXES])
    return recording_page(found.recording, graph, title=title, pictures=[(each.time, each.jpeg) for each in pictures])


def _rgb(color: str) -> Color:
    red, green, blue = (int(color[k : k + 2], 16) for k in (1, 3, 5))
    return red, green, blue


def _strokes(colored: ColoredSegment, times: Floats) -> list[Stroke]:
    """The joint's axis and the part's path on the base, during its segment."""
    segment = colored.segment
    if colored.edge.parent != BASE or not segment.joint.moves or fits_no_joint(segment):
        return []
    span = float(times[colored.rows[0]]), float(times[colored.rows[-1]])
    way = forward(segment.joint, np.linspace(*segment.configuration_range, _ARC_POINTS)).translation
    strokes = [Stroke(way, _rgb(colored.color), *span, width=3)]
    if segment.joint.turns:
        strokes.append(Stroke(_axis(segment.joint), _rgb(INK), *span, width=3))
    return strokes


def _axis(joint: Joint) -> Floats:
    """(n, 3) points on the axis of a joint that turns."""
    reach = max(0.6 * radius(joint), _LEAST_AXIS)
    along = np.linspace(-reach, reach, 20)[:, None] * np.array(joint.axis)
    return np.asarray(np.array(joint.center) + along)
