"""Act-CHAMP and CHAMP beside the paper's equations (`tests/reference/act_champ.py`)."""

from __future__ import annotations

import numpy as np
import planted
import pytest
from reference import act_champ
from scipy.spatial.transform import Rotation

from micah_plan.learning.learn import learn_graph

NOISE = planted.Noise(0.002, 0.01)
# An action reaches the next row with the noise of two rows.
MODEL = act_champ.Observed(0.003, 0.012)


def demonstration(kind: str, *, rest: int, seed: int = 1):
    """45 rows of motion, with that many rows of rest in the middle, then 24 rows of pushing against the end."""
    c = planted.moving_then_held(kind, 45, 24)
    u = np.diff(c, append=c[-1])
    u[44:-1] = u[22]
    c = np.concatenate([c[:22], np.full(rest, c[22]), c[22:]])
    u = np.concatenate([u[:22], np.zeros(rest), u[22:]])
    return planted.recorded([(planted.JOINTS[kind], c)], np.random.default_rng(seed), NOISE, commanded=[u])


def of_paper(recording, method) -> list[act_champ.Segment]:
    poses = act_champ.Poses(recording.position, Rotation.from_quat(recording.quaternion))
    return act_champ.segments(poses, np.nan_to_num(recording.action), MODEL, method)


@pytest.mark.parametrize("rest", [0, 20])
@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_kinds_changepoints_and_axes_are_those_of_the_paper(kind, rest) -> None:
    recording = demonstration(kind, rest=rest)
    theirs, (edge,) = of_paper(recording, act_champ.act_champ), learn_graph(recording).edges
    ours = edge.segments
    assert [segment.joint.kind for segment in ours] == [segment.joint.name for segment in theirs] == [kind, "rigid"]
    # The paper's model looks at every third row, and knows no row that is half motion and half rest.
    assert ours[1].start == pytest.approx(theirs[1].start, abs=4)
    assert abs(np.dot(ours[0].joint.axis, theirs[0].joint.axis)) > 0.999


def test_poses_alone_take_a_rest_for_a_joint_that_holds() -> None:
    """The paper's reason for actions (Sec. V-A): a hand that stops on the way is no changepoint."""
    resting = demonstration("prismatic", rest=20)
    names = [segment.joint.name for segment in of_paper(resting, act_champ.champ)]
    assert names == ["prismatic", "rigid", "prismatic", "rigid"]
    at_once = [segment.joint.name for segment in of_paper(demonstration("prismatic", rest=0), act_champ.champ)]
    assert at_once == ["prismatic", "rigid"]
