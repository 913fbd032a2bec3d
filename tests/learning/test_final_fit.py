"""The final fit: the truth, its laws, the optimum of an independent solver, and data that determine little."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planted import AXIS, JOINTS, TRAVEL
from rebased_joints import rebased
from scipy.optimize import least_squares
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.automaton.joint import Joint, JointKind, radius, revolute, rigid, screw
from micah_plan.automaton.kinematics import forward, inverse, shifted
from micah_plan.learning.joints.final_fit import FittedJoint, fit_joint
from micah_plan.learning.joints.helix import NUMBERS, chart_slopes, helix_of
from micah_plan.learning.joints.likelihood import fit_likelihood, seen_with
from micah_plan.learning.joints.parametrization import chart_of, stepped
from micah_plan.learning.joints.tracker_noise import white_noise

TRUTHS: dict[str, Joint] = {"rigid": rigid((0.5, 0.1, 0.3), JOINTS["revolute"].quaternion), **JOINTS}
KINDS = tuple(TRUTHS)
RATE = 18.0
POSITION_STD, ROTATION_STD = 0.001, 0.006
BOTH = pytest.mark.parametrize("has_orientation", [True, False])
EVERY = pytest.mark.parametrize("kind", KINDS)


def rows_of(
    kind: str, n: int = 80, scale: float = 1.0, outliers: float = 0.0, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, 3) and quaternions (n, 4) with noise."""
    rng = np.random.default_rng(seed)
    poses = forward(TRUTHS[kind], np.linspace(0, TRAVEL.get(kind, 0.0), n))
    wrong = (rng.random(n) < outliers)[:, None]
    position = poses.translation + scale * POSITION_STD * rng.standard_normal((n, 3))
    position += wrong * rng.uniform(-0.5, 0.5, (n, 3))
    turn = Rotation.from_rotvec(scale * ROTATION_STD * rng.standard_normal((n, 3)))
    turn = Rotation.from_rotvec(wrong * rng.uniform(-1.5, 1.5, (n, 3))) * turn
    return position, (turn * poses.rotation).as_quat()


def guessed(kind: str, by: float = 0.01, seed: int = 9) -> Joint:
    """The truth, moved a little."""
    chart = chart_of(TRUTHS[kind], True)
    moved = stepped(TRUTHS[kind], chart, by * np.random.default_rng(seed).standard_normal(chart.free.shape[1]))
    assert moved is not None
    return moved


def fitted(
    guess: Joint, position: np.ndarray, quaternion: np.ndarray | None, weight: np.ndarray | None = None
) -> FittedJoint:
    n = len(position)
    given = np.ones(n) if weight is None else weight
    return fit_joint(guess, position, quaternion, np.arange(n) / RATE, given)


def stds_of(joint: Joint) -> np.ndarray:
    assert joint.covariance is not None
    matrix = np.array(joint.covariance.matrix)
    assert np.isfinite(matrix).all()
    np.testing.assert_allclose(matrix, matrix.T, rtol=1e-9, atol=1e-12)
    assert np.linalg.eigvalsh(matrix).min() > -1e-9 * np.diag(matrix).max()
    return np.sqrt(np.diag(matrix))


def closest(truth: Joint, found: Joint) -> Joint:
    """The truth, counted from where it comes closest to the origin found."""
    if truth.kind == "rigid":
        return truth
    rotation = Rotation.from_quat(found.quaternion)
    return shifted(truth, float(inverse(truth, found.position, rotation, near=0.0)[0]))


@EVERY
@BOTH
def test_every_parameter_is_within_what_the_covariance_allows(kind: str, has_orientation: bool) -> None:
    position, quaternion = rows_of(kind)
    fit = fitted(guessed(kind), position, quaternion if has_orientation else None)
    assert fit.joint.kind == kind
    assert ("rotation_1" in fit.joint.covariance.names) == has_orientation  # type: ignore[union-attr]
    stds = dict(zip(fit.joint.covariance.names, stds_of(fit.joint), strict=True))  # type: ignore[union-attr]
    if kind != "rigid":
        tilt = np.linalg.norm(np.cross(fit.joint.axis, AXIS))
        assert tilt < 4 * np.hypot(stds["axis_1"], stds["axis_2"])
    if kind in ("revolute", "screw"):
        assert abs(radius(fit.joint) - radius(TRUTHS[kind])) < 5 * (stds["center_1"] + stds["center_2"])
        assert stds["center_1"] < 0.03
    if kind == "screw":
        assert abs(fit.joint.pitch - TRUTHS["screw"].pitch) < 4 * stds["pitch"]
    assert fit.position_std == pytest.approx(POSITION_STD, rel=0.35)
    assert fit.rotation_std == pytest.approx(ROTATION_STD if has_orientation else 0.0, rel=0.35)
    assert fit.inlier.min() > 0.9


@EVERY
@BOTH
def test_the_design_is_the_derivative_of_the_errors(kind: str, has_orientation: bool) -> None:
    position, quaternion = rows_of(kind, 20, 0.0)
    given = quaternion if has_orientation else None
    noise = white_noise((1e-6, 2e-7))  # next to none: then no curvature is corrected for
    at = seen_with(TRUTHS[kind], position, given, noise)
    h = 1e-6
    for i, step in enumerate(h * np.eye(at.chart.free.shape[1])):
        ends = [stepped(TRUTHS[kind], at.chart, sign * step) for sign in (1, -1)]
        after, before = (seen_with(end, position, given, noise) for end in ends if end is not None)
        for contrast, high, low in zip(at.contrasts, after.contrasts, before.contrasts, strict=True):
            slope = (high.error - low.error) / (2 * h)
            np.testing.assert_allclose(slope, -(contrast.design @ at.chart.in_frame)[..., i], atol=1e-8)


@EVERY
def test_steps_move_the_parameters_they_are_named_after(kind: str) -> None:
    joint, h = TRUTHS[kind], 1e-6
    chart = chart_of(joint, True)
    moved = stepped(joint, chart, h * np.linalg.pinv(chart.free) @ np.arange(1.0, len(chart.names) + 1))
    assert moved is not None
    asked = dict(
        zip(chart.names, chart.free @ np.linalg.pinv(chart.free) @ np.arange(1.0, len(chart.names) + 1), strict=True)
    )
    shift = np.subtract(moved.position, joint.position) / h
    np.testing.assert_allclose(shift, [asked[f"position_{i}"] for i in (1, 2, 3)], atol=1e-4)
    turn = (Rotation.from_quat(moved.quaternion) * Rotation.from_quat(joint.quaternion).inv()).as_rotvec() / h
    np.testing.assert_allclose(turn, [asked[f"rotation_{i}"] for i in (1, 2, 3)], atol=1e-4)
    if kind == "screw":
        assert (moved.pitch - joint.pitch) / h == pytest.approx(asked["pitch"], abs=1e-4)
    if kind != "rigid":
        tilt = chart.basis @ np.cross(joint.axis, moved.axis) / h
        np.testing.assert_allclose(tilt, [asked["axis_1"], asked["axis_2"]], atol=1e-4)
    if kind in ("revolute", "screw"):
        drift = chart.basis @ np.subtract(moved.center, joint.center) / h
        np.testing.assert_allclose(drift, [asked["center_1"], asked["center_2"]], atol=1e-4)


@pytest.mark.sweep
@pytest.mark.parametrize("kind", ["prismatic", "revolute", "screw"])
@BOTH
def test_it_ends_where_an_independent_solver_ends(kind: str, has_orientation: bool) -> None:
    position, quaternion = rows_of(kind, 25, 0.02, seed=2)
    stds = (0.02 * ROTATION_STD, 0.02 * POSITION_STD)
    given = quaternion if has_orientation else None
    ours = fit_likelihood(TRUTHS[kind], position, given, white_noise(stds), 1e-12)
    start, chart = ours.joint, ours.chart
    p = chart.free.shape[1]

    def cost(numbers: np.ndarray) -> np.ndarray:
        # Every configuration is a parameter of its own here; nothing is profiled out.
        joint = stepped(start, chart, numbers[:p] * stds[1])
        assert joint is not None
        poses = forward(joint, ours.seen.configuration + numbers[p:] * stds[1])
        across = (position - poses.translation) / stds[1]
        if not has_orientation:
            return across.ravel()
        turn = (Rotation.from_quat(quaternion) * poses.rotation.inv()).as_rotvec() / stds[0]
        return np.concatenate([across.ravel(), turn.ravel()])

    theirs = least_squares(cost, np.zeros(p + 25), method="trf", xtol=1e-12, ftol=1e-12, gtol=1e-12)
    # Closer than a hundredth of what the rows can tell.
    information = np.linalg.inv(theirs.jac.T @ theirs.jac)[:p, :p]
    assert np.abs(theirs.x[:p] / np.sqrt(np.diag(information))).max() < 0.02


@EVERY
def test_a_fifth_of_outliers_does_not_move_the_fit(kind: str) -> None:
    position, quaternion = rows_of(kind, 100, outliers=0.2, seed=4)
    fit = fitted(guessed(kind, 0.1), position, quaternion)
    far = np.linalg.norm(
        position - forward(TRUTHS[kind], np.linspace(0, TRAVEL.get(kind, 0.0), 100)).translation, axis=1
    )
    assert fit.inlier[far > 0.02].max() < 0.5
    assert fit.inlier[far < 0.004].min() > 0.5
    assert 0.05 < fit.outlier_ratio < 0.3
    truth = closest(TRUTHS[kind], fit.joint)
    error = np.abs(np.subtract(truth.position, fit.joint.position))
    assert (error < 4.5 * stds_of(fit.joint)[-3:]).all()
    assert fit.position_std == pytest.approx(POSITION_STD, rel=0.4)


@pytest.mark.sweep
@EVERY
@BOTH
def test_the_answer_does_not_depend_on_the_base(kind: str, has_orientation: bool) -> None:
    position, quaternion = rows_of(kind, 60, outliers=0.05, seed=5)
    base = RigidTransform.from_components([1.0, -2.0, 0.5], Rotation.from_rotvec([0.3, 1.1, -0.7]))
    here = fitted(guessed(kind), position, quaternion if has_orientation else None)
    turned = (base.rotation * Rotation.from_quat(quaternion)).as_quat()
    there = fitted(rebased(guessed(kind), base), base.apply(position), turned if has_orientation else None)
    expected = rebased(here.joint, base)
    # What stopping the iterations leaves is far below what the rows can tell.
    stds = stds_of(expected)
    assert np.linalg.norm(np.subtract(there.joint.position, expected.position)) < 0.1 * stds[-3:].max()
    if kind != "rigid":
        assert np.linalg.norm(np.subtract(there.joint.axis, expected.axis)) < 0.05 * stds[:2].max()
    if kind in ("revolute", "screw"):
        assert np.linalg.norm(np.subtract(there.joint.center, expected.center)) < 0.05 * stds[2:4].max()
    np.testing.assert_allclose(stds_of(there.joint), stds, rtol=2e-2)
    np.testing.assert_allclose(there.inlier, here.inlier, atol=1e-3)


@EVERY
def test_units_of_time_and_signs_of_quaternions_do_not_matter(kind: str) -> None:
    position, quaternion = rows_of(kind, 60, seed=6)
    weight, time = np.ones(60), np.cumsum(np.random.default_rng(1).uniform(0.5, 1.5, 60))
    signs = np.random.default_rng(2).choice([-1.0, 1.0], (60, 1))
    one = fit_joint(guessed(kind), position, quaternion, time, weight)
    two = fit_joint(guessed(kind), position, signs * quaternion, 1e3 * time, weight)
    np.testing.assert_allclose(two.joint.position, one.joint.position, atol=1e-8)
    np.testing.assert_allclose(two.joint.axis, one.joint.axis, atol=1e-8)
    np.testing.assert_allclose(stds_of(two.joint), stds_of(one.joint), rtol=1e-5)


def test_the_same_seed_gives_the_same_joint_and_the_order_of_rows_none_other() -> None:
    position, quaternion = rows_of("revolute", 60, outliers=0.1)
    time = np.arange(60) / RATE
    guess = guessed("revolute")
    one = fit_joint(guess, position, quaternion, time, np.ones(60))
    two = fit_joint(guess, position, quaternion, time, np.ones(60))
    assert one.joint == two.joint
    order = np.roll(np.arange(60), 25)
    three = fit_joint(guess, position[order], quaternion[order], time[order], np.ones(60))
    np.testing.assert_allclose(three.joint.center, one.joint.center, atol=1e-6)
    np.testing.assert_allclose(three.inlier, one.inlier[order], atol=1e-3)


def test_rows_without_weight_are_not_looked_at() -> None:
    position, quaternion = rows_of("revolute", 60)
    weight = np.ones(60)
    weight[20:30] = 0.0
    plain = fitted(guessed("revolute"), position, quaternion, weight)
    position[20:30] += 0.003
    changed = fitted(guessed("revolute"), position, quaternion, weight)
    np.testing.assert_allclose(changed.joint.center, plain.joint.center, atol=1e-9)
    assert not changed.inlier[20:30].any()


def test_configurations_count_from_where_the_guess_counts() -> None:
    position, quaternion = rows_of("revolute", 60)
    flipped = replace(guessed("revolute", 0.002), covariance=None)
    flipped = shifted(flipped, 0.4)
    fit = fitted(flipped, position, quaternion)
    np.testing.assert_allclose(fit.joint.position, flipped.position, atol=0.01)
    assert np.dot(fit.joint.axis, flipped.axis) > 0.99


@pytest.mark.sweep
@EVERY
@BOTH
@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 8])
def test_a_few_rows_give_a_finite_answer(kind: str, has_orientation: bool, n: int) -> None:
    position, quaternion = rows_of(kind, 8)
    fit = fitted(guessed(kind), position[:n], quaternion[:n] if has_orientation else None)
    assert np.isfinite([*fit.joint.position, *fit.joint.axis, *fit.joint.center, fit.log_likelihood]).all()
    assert fit.inlier.shape == (n,)
    if fit.joint.covariance is not None:
        assert stds_of(fit.joint).max() > 1e-4


@pytest.mark.sweep
@EVERY
@BOTH
@pytest.mark.parametrize("data", ["constant", "resting", "line", "nothing"])
def test_rows_that_determine_no_such_joint_give_a_wide_answer(
    kind: JointKind, has_orientation: bool, data: str
) -> None:
    n, rng = 40, np.random.default_rng(0)
    position, quaternion = np.zeros((n, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (n, 1))
    if data == "resting":
        position = POSITION_STD * rng.standard_normal((n, 3))
        quaternion = Rotation.from_rotvec(ROTATION_STD * rng.standard_normal((n, 3))).as_quat()
    if data == "line":
        position = np.linspace(0, 1, n)[:, None] * np.array([0.3, 0.1, 0.2]) + 1e-3 * rng.standard_normal((n, 3))
    weight = np.zeros(n) if data == "nothing" else np.ones(n)
    fit = fitted(guessed(kind), position, quaternion if has_orientation else None, weight)
    # What poses do not tell from a hinge is one: screws are rare.
    assert fit.joint.kind == ("revolute" if (kind, has_orientation) == ("screw", True) and data != "nothing" else kind)
    assert np.isfinite([*fit.joint.position, *fit.joint.axis, *fit.joint.center, fit.log_likelihood]).all()
    if data == "nothing":
        assert fit.joint.covariance is None
    else:
        assert fit.inlier.min() > 0.5 or (kind, data) == ("rigid", "line")
        stds = stds_of(fit.joint)
        if data == "resting" and kind != "rigid":
            assert stds[:2].max() > 0.05  # rad: a part at rest does not tell an axis


def test_pauses_between_segments_forget_the_wander() -> None:
    truth = TRUTHS["rigid"]
    kept, rng = np.exp(-1 / 15), np.random.default_rng(0)
    wander = 0.004 * rng.standard_normal((12, 15, 3))
    for i in range(1, 15):
        wander[:, i] = kept * wander[:, i - 1] + np.sqrt(1 - kept**2) * wander[:, i]
    position = np.array(truth.position) + wander.reshape(180, 3) + 0.0005 * rng.standard_normal((180, 3))
    time = np.arange(180) / RATE + 100.0 * np.repeat(np.arange(12), 15)
    fit = fit_joint(rigid(truth.position), position, None, time, np.ones(180))
    # The mean of 12 visits, each of 4 mm with the correlation of its rows: 0.98 mm; white noise would say 0.3 mm.
    row = np.arange(15)
    expected = 0.004 * np.sqrt(np.exp(-np.abs(row[:, None] - row) / 15).mean() / 12)
    assert stds_of(fit.joint).mean() == pytest.approx(expected, rel=0.35)


def test_a_circle_is_fitted_to_positions_with_an_orientationless_guess() -> None:
    position, _ = rows_of("revolute")
    guess = revolute((0, 0, 1), (0, 0, 0), (0.3, 0.3, 0.3))
    fit = fitted(guess, position, None)
    assert abs(np.dot(fit.joint.axis, AXIS)) > 0.999
    assert radius(fit.joint) == pytest.approx(radius(TRUTHS["revolute"]), abs=0.01)


def test_a_short_helix_seen_by_positions_alone_is_fitted_from_any_start() -> None:
    """Its axis, centre and pitch run along a bent valley with several bottoms."""
    truth = screw(AXIS, (0.35, 0.1, 0.3), 0.12, (0.4, 0.1, 0.3))
    rng = np.random.default_rng(4)
    position = forward(truth, np.linspace(0, 1.2, 100)).translation + 0.001 * rng.standard_normal((100, 3))
    chart = chart_of(truth, False)
    starts = [stepped(truth, chart, 0.01 * rng.standard_normal(chart.free.shape[1])) for _ in range(3)]
    starts.append(replace(truth, pitch=-0.02))
    found = []
    for start in starts:
        assert start is not None
        found.append(fitted(start, position, None).joint)
    for one in found:
        assert found[0].covariance is not None
        std = dict(zip(found[0].covariance.names, stds_of(found[0]), strict=True))
        assert abs(one.pitch - found[0].pitch) < 0.1 * std["pitch"]
        assert np.linalg.norm(np.cross(one.axis, found[0].axis)) < 0.1 * np.hypot(std["axis_1"], std["axis_2"])
        assert abs(one.pitch - truth.pitch) < 3 * std["pitch"]


@pytest.mark.slow
def test_poses_separate_a_screw_from_a_hinge_for_any_guess() -> None:
    """Beside a slow tracker a tilted hinge explains the places of a screw, and another one its turns: not one both."""
    rng, right = np.random.default_rng(5), 0
    kept = np.exp(-1 / 40)
    for kind in ("revolute", "screw"):
        for number in range(8):
            pitch = 0.09 if kind == "screw" else 0.0
            truth = screw(AXIS, (0.35, 0.1, 0.3), pitch, (0.5, 0.1, 0.3))
            poses = forward(truth, np.linspace(0, 1.2, 150))
            error = rng.standard_normal((150, 6))
            for i in range(1, 150):
                error[i] = kept * error[i - 1] + np.sqrt(1 - kept**2) * error[i]
            error += 0.5 * rng.standard_normal((150, 6))
            position = poses.translation + 0.0015 * error[:, :3]
            quaternion = (Rotation.from_rotvec(0.009 * error[:, 3:]) * poses.rotation).as_quat()
            hinge = revolute(truth.axis, truth.center, truth.position)
            kinds = {fitted(guess, position, quaternion).joint.kind for guess in (hinge, truth)}
            assert len(kinds) == 1, (kind, number)
            right += kinds == {kind}
    assert right >= 15


def test_where_an_arc_does_not_determine_a_lead_the_interval_holds_every_lead() -> None:
    """A short piece of a wide screw may as well be a circle, or turn the other way."""
    truth = screw(AXIS, (0.2, 0.3, 0.1), 0.03, (0.5, 0.1, 0.3))
    rng = np.random.default_rng(1)
    position = forward(truth, np.linspace(0, 0.4, 60)).translation + 0.001 * rng.standard_normal((60, 3))
    found = fitted(truth, position, None).joint
    assert found.covariance is not None
    std = dict(zip(found.covariance.names, stds_of(found), strict=True))
    for pitch in (truth.pitch, 0.0, -truth.pitch):
        assert abs(found.pitch - pitch) < 1.96 * std["pitch"]
    # But where the path is, its rows tell.
    assert max(std[name] for name in std if name.startswith("position")) < 0.002


def test_slopes_of_a_helix_are_those_of_its_rows() -> None:
    """Errors of rows on the path change with the helix's numbers as the chart says."""
    helix = helix_of(TRUTHS["screw"], 0.05)
    assert helix is not None
    joint = helix.joint(0.03, TRUTHS["screw"])
    again = helix_of(joint, 0.03)
    assert again is not None
    np.testing.assert_allclose(again.point, helix.point, atol=1e-12)
    np.testing.assert_allclose(again.frame, helix.frame, atol=1e-12)
    position = forward(joint, np.linspace(-0.3, 0.7, 20)).translation
    noise = white_noise((1.0, 0.001))
    fit = seen_with(joint, position, None, noise)
    slopes = fit.chart.in_frame @ chart_slopes(helix, 0.03, joint, fit.chart)
    for number in range(NUMBERS):
        step = np.zeros(NUMBERS)
        step[number] = 1e-5
        errors = []
        for moved in (helix.moved(step), helix.moved(-step)):
            assert moved is not None
            errors.append(seen_with(moved.joint(0.03, joint), position, None, noise).contrasts[0].error)
        expected = (fit.contrasts[0].design @ slopes)[..., number]
        np.testing.assert_allclose((errors[1] - errors[0]) / 2e-5, expected, atol=2e-6)
