"""Fits of many joints at once: exact on exact rows, derivatives against differences, likelihoods at their optimum."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from planted import JOINTS, TRAVEL, Noise, moving_then_held, recorded

from micah_plan.automaton.joint import Joint, radius, rigid, screw
from micah_plan.automaton.kinematics import forward, inverse, jacobian
from micah_plan.learning.joints.joint_arrays import JointArrays, arrays_of
from micah_plan.learning.joints.linear_fits import linear_fits
from micah_plan.learning.joints.residuals import compare_arrays
from micah_plan.learning.segmenting.noise_fit import initial_noise
from micah_plan.learning.segmenting.pool_fits import fit_pool_likelihood, parameter_design
from micah_plan.learning.settings import LearnSettings
from micah_plan.learning.track import PartTrack, find_inliers, part_track

KINDS = ("rigid", "prismatic", "revolute", "screw")
ROWS = 60


def rows_of(kind: str, orientation: bool = True, noise: Noise | None = None) -> PartTrack:
    c = np.linspace(0, TRAVEL[kind], ROWS) if kind != "rigid" else np.zeros(ROWS)
    joint = JOINTS["prismatic" if kind == "rigid" else kind]
    recording = recorded([(joint, c)], np.random.default_rng(0), noise or Noise(0.0, 0.0), orientation=orientation)
    return part_track(recording, 0, recording.parts[0])


def assert_same_motion(found: Joint, truth: Joint, tolerance: float) -> None:
    assert abs(np.dot(found.axis, truth.axis)) > np.cos(max(tolerance, 1e-7))
    assert radius(found) == pytest.approx(radius(truth), abs=tolerance)
    assert found.pitch == pytest.approx(truth.pitch, abs=tolerance)


@pytest.mark.parametrize("kind", ["prismatic", "revolute", "screw"])
@pytest.mark.parametrize("rows", [slice(0, 60), slice(10, 30), slice(25, 35)])
def test_linear_fits_of_exact_poses_are_exact(kind: str, rows: slice) -> None:
    track, used = rows_of(kind), np.zeros((1, ROWS), dtype=bool)
    used[:, rows] = True
    joints, fixed = linear_fits([kind], used, track.position, track.quaternion)
    assert fixed.all()
    seen = compare_arrays(joints, track.position, track.quaternion, 0.2)
    assert np.abs(seen.error).max() < 1e-6
    assert_same_motion(joints.joint(0), JOINTS[kind], 1e-5)


def test_a_circle_through_exact_positions_is_exact() -> None:
    track = rows_of("revolute", orientation=False)
    joints, fixed = linear_fits(["revolute"], np.ones((1, ROWS), dtype=bool), track.position, None)
    assert fixed.all()
    assert_same_motion(joints.joint(0), JOINTS["revolute"], 1e-6)


@pytest.mark.parametrize("lead", [-50, -10, 0, 25, 60])
@pytest.mark.parametrize("travel", [0.5, 1.2, 2.5])
def test_a_helix_through_exact_positions_starts_near_the_truth(lead: float, travel: float) -> None:
    """Its axis and pitch follow from how the rows leave the plane of their circle; so does which way it winds."""
    c, pitch = np.linspace(0, travel, ROWS), 0.2 * np.tan(np.radians(lead))
    truth = screw((0.36, 0.48, 0.8), (0.4, 0.2, 0.2), pitch, (0.5, 0.1, 0.3))
    position = forward(truth, c).translation
    joints, fixed = linear_fits(["screw", "revolute"], np.ones((2, ROWS), dtype=bool), position, None)
    assert fixed.all()
    helix = joints.joint(0)
    winding = np.sign(np.dot(helix.axis, truth.axis))
    angle = np.degrees(np.arctan2(helix.pitch, radius(helix)))
    assert angle == pytest.approx(np.degrees(np.arctan2(pitch, radius(truth))), abs=12 if travel > 2 else 3)
    assert np.dot(helix.axis, truth.axis) * winding > np.cos(np.radians(12 if travel > 2 else 3))
    assert joints.joint(1).pitch == 0.0


def test_a_circle_through_noisy_positions_of_a_short_arc_is_not_too_small() -> None:
    """Least squares of the plain circle equation (Coope 1993) finds a quarter of this radius."""
    radii = []
    for seed in range(40):
        noise = 0.001 * np.random.default_rng(seed).standard_normal((ROWS, 3))
        position = forward(JOINTS["revolute"], np.linspace(0, 0.2, ROWS)).translation + noise
        found, fixed = linear_fits(["revolute"], np.ones((1, ROWS), dtype=bool), position, None)
        assert fixed[0]
        radii.append(radius(found.joint(0)))
    assert np.median(radii) == pytest.approx(radius(JOINTS["revolute"]), rel=0.2)


@pytest.mark.parametrize("orientation", [True, False])
def test_rows_without_motion_fix_no_moving_joint(orientation: bool) -> None:
    position = np.zeros((10, 3))
    quaternion = np.tile([0.0, 0.0, 0.0, 1.0], (10, 1)) if orientation else None
    _, fixed = linear_fits(KINDS, np.ones((4, 10), dtype=bool), position, quaternion)
    assert fixed.tolist() == [True, False, False, False]


def planted_arrays() -> JointArrays:
    first = JOINTS["prismatic"]
    return arrays_of([rigid(first.position, first.quaternion), *(JOINTS[kind] for kind in KINDS[1:])])


@pytest.mark.parametrize("orientation", [True, False])
def test_batches_see_rows_as_single_joints_do(orientation: bool) -> None:
    joints = planted_arrays()
    track = rows_of("screw", orientation, Noise(0.02, 0.1))
    seen = compare_arrays(joints, track.position, track.quaternion, 0.2)
    for i in range(len(joints)):
        joint = joints.joint(i)
        c = np.unwrap(inverse(joint, track.position, track.rotation, 0.2))
        assert np.allclose(seen.configuration[i], c, atol=1e-6)
        pose = forward(joint, c)
        assert np.allclose(seen.error[i, -3:].T, track.position - pose.translation, atol=1e-6)
        assert np.allclose(seen.direction[i].T, jacobian(joint, c)[:, -seen.direction.shape[1] :], atol=1e-6)
        if track.rotation is not None:
            assert np.allclose(seen.error[i, :3].T, (track.rotation * pose.rotation.inv()).as_rotvec(), atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("orientation", [True, False])
def test_the_design_is_the_derivative_of_the_errors_across_the_joint(kind: str, orientation: bool) -> None:
    joints = planted_arrays().take([KINDS.index(kind)])
    track = rows_of(kind, orientation)
    seen = compare_arrays(joints, track.position, track.quaternion, 0.2)
    design = parameter_design(joints, seen, track.position)[0]
    along = seen.direction[0] / np.maximum(np.linalg.norm(seen.direction[0], axis=0), 1e-12)
    step = 1e-6 * np.eye(13)
    for k in range(13):
        # A rigid part has one side, only a screw has a pitch, and positions do not see a part-side turn.
        if (kind == "rigid" and k >= 6) or (kind != "screw" and k == 12) or (not orientation and k in (6, 7, 8)):
            continue
        ahead, behind = (
            compare_arrays(joints.moved(sign * step[None, k]), track.position, track.quaternion, 0.2).error[0]
            for sign in (1.0, -1.0)
        )
        slope = (behind - ahead) / 2e-6
        slope = slope - along * np.sum(along * slope, axis=0)
        assert np.allclose(slope, design[:, k], atol=1e-5), k


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("orientation", [True, False])
def test_fits_of_a_batch_end_where_no_small_step_is_likelier(kind: str, orientation: bool) -> None:
    track = rows_of(kind, orientation, Noise(0.002, 0.01))
    noise = initial_noise(track, LearnSettings())
    used = np.ones((1, ROWS), dtype=bool)
    joints, _ = linear_fits([kind], used, track.position, track.quaternion)
    best = fit_pool_likelihood(joints, used, track, noise, 30)

    def cost(tried: JointArrays) -> float:
        error = compare_arrays(tried, track.position, track.quaternion, noise.rotation_length).error
        left = list(itertools.islice(noise.predicted_back(error), 4))
        rows = [left[min(row, 3)][0, :, row] / np.sqrt(noise.left[0, min(row, 3)]) for row in range(ROWS)]
        squared, heavy = (np.array(rows) ** 2).sum(axis=1), float(noise.dof[0]) + error.shape[1]
        return float(heavy * np.log1p(squared / heavy).sum())

    rng = np.random.default_rng(1)
    assert all(cost(best.moved(2e-3 * rng.standard_normal((1, 13)))) > cost(best) for _ in range(20))


def test_noise_scales_come_from_the_rows() -> None:
    recording = recorded(
        [(JOINTS["revolute"], moving_then_held("revolute", 150, 150))],
        np.random.default_rng(5),
        Noise(0.003, 0.02, 0.05),
    )
    track = part_track(recording, 0, recording.parts[0])
    inlier = find_inliers(track)
    noise = initial_noise(track.take(inlier.nonzero()[0]), LearnSettings())
    assert noise.of_rows(1.0).position_white == pytest.approx(0.003, rel=0.2)
    assert noise.of_rows(1.0).rotation_white == pytest.approx(0.02, rel=0.2)
    truth = np.linalg.norm(
        recording.position - forward(JOINTS["revolute"], moving_then_held("revolute", 150, 150)).translation, axis=1
    )
    assert not inlier[truth > 0.1].any()
    assert inlier[truth < 0.01].mean() > 0.95
