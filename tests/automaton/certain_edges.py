"""Hand-made kinematic edges that say how sure they are, for the tests of what is made of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from automaton_examples import chain

from micah_plan.automaton.certainty import ActionChannel, EdgeCertainty, NoSingleJoint, RowPosterior, SegmentCertainty
from micah_plan.automaton.graph import KinematicEdge, KinematicGraph

CHANNEL = ActionChannel(
    frame_rotation=(0.0, 0.0, 0.2),
    gain=0.94,
    delay=0.11,
    covariance=tuple(map(tuple, np.diag(np.square([0.1, 0.1, 0.05, 0.02, 0.03])).tolist())),
    explained=0.87,
)
NO_SINGLE_JOINT = NoSingleJoint(
    position=0.023, rotation=0.31, position_noise=0.002, rotation_noise=0.012, log_odds=120.0
)


def sure_door(start: RowPosterior) -> KinematicGraph:
    """A door that turns over rows 0 to 19 by 1.2 rad and is shut from row 20, which has the posterior `start`."""
    edge = chain("door", [0, 1.2, 1.2], ["revolute", "rigid"])
    turning, shut = edge.segments
    turning = replace(turning, certainty=SegmentCertainty(None, (("revolute", 0.98), ("screw", 0.015))))
    shut = replace(shut, certainty=SegmentCertainty(start, (("rigid", 1.0),)))
    certainty = EdgeCertainty(812.5, ((0.0, 0.97, 0.03),), CHANNEL)
    return KinematicGraph((replace(edge, segments=(turning, shut), certainty=certainty),))


def unfit(edge: KinematicEdge, index: int, no_single_joint: NoSingleJoint = NO_SINGLE_JOINT) -> KinematicEdge:
    """The edge with a segment that no single joint explains."""
    segments = list(edge.segments)
    segments[index] = replace(segments[index], certainty=SegmentCertainty(None, (), no_single_joint))
    return replace(edge, segments=tuple(segments))
