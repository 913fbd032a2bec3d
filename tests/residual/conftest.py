"""What tests of residuals share."""

from __future__ import annotations

import planted_effects as plants
import pytest

from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.joint import revolute, rigid
from micah_plan.automaton.kinematics import forward


@pytest.fixture(scope="module")
def door():
    """Swings from 0 to 1.2 rad and is rigid there."""
    end = plants.LENGTH
    swing = revolute((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (plants.RADIUS, 0.0, 0.1))
    shut = forward(swing, end)[0]
    held = rigid(shut.translation, shut.rotation.as_quat(), end)
    rows = [(swing, 0.0, 0), (held, end, 10)]
    segments = [Segment(j, 0, k, k + 9, at, end, (at, end), 0.001, 0.003, 0.0, 1.0) for j, at, k in rows]
    return build_automaton(KinematicGraph((KinematicEdge(BASE, "door", tuple(segments)),)))
