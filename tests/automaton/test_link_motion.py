"""Links that move along one joint after another: what poses and actions say of one configuration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.joint import prismatic, revolute
from micah_plan.automaton.kinematics import forward
from micah_plan.automaton.link_motion import link_motions
from micah_plan.automaton.region import Region, above, below, box

SLIDE, TURN = 0.3, 0.9


def segment(joint, start, end, row):
    return Segment(joint, 0, row, row + 9, start, end, (start, end), 0.001, 0.003, 0.0, 1.0)


def path_of(axis):
    """A slide along x, then an arc about `axis` through a point beside its end."""
    slide = prismatic((1.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    center = (SLIDE, -0.5, 0.0) if abs(axis[2]) > 0.5 else (SLIDE, 0.0, -0.5)
    plain = revolute(axis, center, (SLIDE, 0.0, 0.0))
    there = forward(plain, -SLIDE)[0]
    arc = revolute(axis, center, there.translation, there.rotation.as_quat())
    parts = (segment(slide, 0.0, SLIDE, 0), segment(arc, SLIDE, SLIDE + TURN, 10))
    (path,) = link_motions(build_automaton(KinematicGraph((KinematicEdge(BASE, "drawer", parts),))))
    return path


@pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (1.0, 0.0, 0.0)])
@pytest.mark.parametrize("with_rotation", [True, False])
def test_every_pose_of_the_path_has_its_configuration(axis, with_rotation):
    path = path_of(axis)
    c = np.linspace(-0.02, SLIDE + TURN + 0.02, 97)
    poses = path.poses(c)
    found = path.configurations(poses.translation, poses.rotation if with_rotation else None)
    assert found == pytest.approx(c, abs=1e-9)


@pytest.mark.slow
@given(start=st.floats(0.0, SLIDE + TURN), by=st.floats(-0.2, 0.2), across=st.booleans())
def test_a_displacement_along_the_path_is_read_back_from_its_chord_also_over_the_change(start, by, across):
    path = path_of((1.0, 0.0, 0.0) if across else (0.0, 0.0, 1.0))
    c = np.array([start])
    action = path.poses(c + by).translation - path.poses(c).translation
    assert path.commanded(c, action) == pytest.approx(by, abs=2e-3 + 0.03 * abs(by))
    assert path.aimed(c, action) == pytest.approx(by, abs=2e-3 + 0.03 * abs(by))


def test_at_the_change_noise_does_not_lose_a_command():
    path = path_of((1.0, 0.0, 0.0))  # the arc begins across the slide
    beyond = path.poses(np.array([SLIDE + 0.05])).translation - path.poses(np.array([SLIDE])).translation
    before = path.commanded(np.array([SLIDE - 1e-3]), beyond)
    after = path.commanded(np.array([SLIDE + 1e-3]), beyond)
    assert before == pytest.approx(0.05, abs=4e-3)
    assert after == pytest.approx(0.05, abs=4e-3)


def test_tangents_are_derivatives_of_poses():
    path = path_of((0.0, 0.0, 1.0))
    c = np.array([0.1, 0.29, 0.31, 1.0])
    change = path.poses(c + 1e-6).translation - path.poses(c - 1e-6).translation
    assert path.tangents(c)[:, 3:] == pytest.approx(change / 2e-6, abs=1e-6)


def test_joints_whose_ranges_meet_but_for_round_off_follow_each_other():
    slide = prismatic((1.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    arc = revolute((0.0, 0.0, 1.0), (SLIDE, -0.5, 0.0), (SLIDE, 0.0, 0.0))
    parts = (segment(slide, 0.0, SLIDE, 0), segment(arc, SLIDE, SLIDE + TURN, 10))
    automaton = build_automaton(KinematicGraph((KinematicEdge(BASE, "drawer", parts),)))
    first, second = automaton.modes
    longer = replace(first, invariant=box([0.0], [SLIDE + 1e-9], 1, ["drawer"]))
    (path,) = link_motions(replace(automaton, modes=(longer, second)))
    assert [joint.kind for joint in path.joints] == ["prismatic", "revolute"]


def hinge(low, high):
    """How a part turns about a hinge between `low` and `high`, infinite where nothing ends it."""
    turn = revolute((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (0.3, 0.0, 0.0))
    automaton = build_automaton(KinematicGraph((KinematicEdge(BASE, "lid", (segment(turn, 0.0, 1.0, 0),)),)))
    ends = [one for one in ((above, low), (below, high)) if np.isfinite(one[1])]
    region = Region(tuple(side(0, end, 1, 1, name="lid") for side, end in ends))
    (mode,) = automaton.modes
    (motion,) = link_motions(replace(automaton, modes=(replace(mode, invariant=region),), edges=()))
    return motion


@pytest.mark.parametrize(
    ("low", "high", "start", "end"),
    [
        (0.0, 1.2, 1.2, 0.0),
        (0.0, 3.9, 0.0, 3.9),
        (0.0, 3.9, 3.9, 3.3),  # begins beyond half a turn
        (-4.0, 0.0, -3.5, -0.1),
        (0.0, 20.0, 0.0, 20.0),
        (-20.0, 0.0, 0.0, -19.0),
        (0.0, 20.0, 19.0, 0.5),  # only one turn keeps all of it in the range
        (2.0, 30.0, 2.5, 11.0),
        (0.0, np.inf, 0.2, 40.0),
        (-np.inf, 3.0, 2.0, -9.0),
        (-np.inf, np.inf, -1.0, 17.0),
    ],
)
@pytest.mark.parametrize("with_rotation", [True, False])
def test_a_run_of_a_hinge_continues_from_row_to_row_for_any_range(low, high, start, end, with_rotation):
    path, c = hinge(low, high), np.linspace(start, end, 60)
    there_and_back = np.concatenate([c, c[::-1]])
    seen = there_and_back + 0.003 * np.sin(17.0 * np.arange(120))  # beyond an end by noise
    poses = path.poses(seen)
    assert path.configurations(poses.translation, poses.rotation if with_rotation else None) == pytest.approx(seen)


def test_a_row_that_was_read_wrongly_does_not_turn_those_after_it_where_the_range_is_short():
    path, c = hinge(0.0, 3.9), np.linspace(0.0, 3.8, 50)
    c[20] += 3.0
    assert np.delete(path.configurations(path.poses(c).translation, None) - c, 20) == pytest.approx(0.0, abs=1e-9)


def test_turns_that_are_known_from_elsewhere_are_kept():
    path, c = hinge(0.0, 40.0), np.linspace(14.0, 16.0, 20)
    assert path.configurations(path.poses(c).translation, None, c + 0.5) == pytest.approx(c)


def test_no_rows_have_no_configurations():
    assert hinge(0.0, 40.0).configurations(np.zeros((0, 3)), None).shape == (0,)
