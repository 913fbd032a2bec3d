"""When a learned graph is right about a simulated demonstration, and what the demonstration can tell at best.

The paper calls a result correct "if the number of detected changepoints matches the ground truth and the estimated
local model parameters are within an epsilon-radius ball of the ground truth parameters" with epsilon = 0.05 rad or m (a
footnote in the source of its Table I). Here are three counts:

* structure: number of changepoints and kinds of joint match;
* correct: structure, and within epsilon are the axis, as the paper measures it (1 - |cos| of the angle, so 0.05
  forgives 0.32 rad), the centre and the radius [m] of a revolute joint, and the configurational changepoint [rad],
  which is where the automaton will put its guard;
* strict: correct, and the angle between the axes, with their sense, is within epsilon too [rad].

And two limits:

* `expected_correct`, `expected_strict`: the probability that an efficient, unbiased estimator is correct, if it is told
  the rows, the kinds and the tracker's noise (Cramér-Rao, with the configurations as nuisance parameters). No
  unbiased estimator has a smaller variance.
* `actions_tell`, `poses_tell`: whether the data show that a rest on the way is not a stop. Actions do unless the hand
  moved in vain along the joint (in the air, or taking up slack) for half as long as it pressed on the shut door
  or, for a drawer, for 15 rows of its typical step. Poses alone do not once a rest lasts 10 rows (0.55 s): it looks
  as the shut door does. Neither considers the tracker's noise. Where data do not tell, a method can still be right by
  convention, such as "a rest after which the part moves on along the same joint is a pause, a last one is a stop".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.spatial.transform import Rotation
from simulated_demonstrations import RATE, Demonstration, Tracker

from micah_plan.automaton.graph import KinematicEdge
from micah_plan.automaton.joint import Joint, axis_basis, prismatic, radius, revolute
from micah_plan.automaton.kinematics import forward, jacobian

Floats = NDArray[np.float64]

EPSILON = 0.05
_VAIN_ROWS = 15.0
_REST_ROWS = 10
_DRAWS = 400


@dataclass(frozen=True)
class Errors:
    """Of a joint's parameters: axis [rad], centre and radius [m]; 0 where the joint has none."""

    axis: float
    center: float
    radius: float

    def correct(self, epsilon: float) -> bool:
        """Within epsilon as the paper measures."""
        return bool(max(1.0 - abs(np.cos(self.axis)), self.center, self.radius) <= epsilon)

    def strict(self, epsilon: float) -> bool:
        """Within epsilon, the axis in rad."""
        return bool(max(self.axis, self.center, self.radius) <= epsilon)


@dataclass(frozen=True)
class Score:
    """One learned graph against the truth.

    Attributes:
        kinds, changepoints: as learned.
        structure, correct, strict: see the module.
        rows: distance of the changepoint from the true row; None without structure or changepoint.
        configuration: distance of the rigid joint's configuration from the true one [rad]; None as above.
        errors: of the moving joint; None without structure.
    """

    kinds: tuple[str, ...]
    changepoints: tuple[int, ...]
    structure: bool
    correct: bool
    strict: bool
    rows: int | None
    configuration: float | None
    errors: Errors | None


@dataclass(frozen=True)
class Limits:
    """What could be known at best about one demonstration."""

    expected_correct: float
    expected_strict: float
    actions_tell: bool
    poses_tell: bool


def score(edge: KinematicEdge, truth: Demonstration, epsilon: float = EPSILON) -> Score:
    """Judge the segments that were learned for the moving part."""
    kinds = tuple(segment.joint.kind for segment in edge.segments)
    if kinds != truth.kinds:
        return Score(kinds, edge.changepoints, False, False, False, None, None, None)
    errors = parameter_errors(edge.segments[0].joint, truth.scene.joint)
    if not truth.scene.stops:
        correct, strict = errors.correct(epsilon), errors.strict(epsilon)
        return Score(kinds, edge.changepoints, True, correct, strict, None, None, errors)
    rows = abs(int(edge.changepoints[0]) - truth.changepoints[0])
    configuration = float(abs(edge.segments[-1].joint.fixed_at - truth.scene.travel))
    near = configuration <= epsilon
    correct, strict = near and errors.correct(epsilon), near and errors.strict(epsilon)
    return Score(kinds, edge.changepoints, True, correct, strict, rows, configuration, errors)


def parameter_errors(found: Joint, true: Joint) -> Errors:
    """Distances between the parameters of two joints of one kind."""
    a, b = np.array(found.axis), np.array(true.axis)
    axis = float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))
    center = float(np.linalg.norm(np.subtract(found.center, true.center)))
    return Errors(axis, center, abs(radius(found) - radius(true)))


def limits(truth: Demonstration, epsilon: float, rng: np.random.Generator) -> Limits:
    """What the demonstration could tell at best; `rng` draws the errors of the ideal estimator."""
    joint = truth.scene.joint
    bound = ideal_covariance(truth)
    draws = rng.multivariate_normal(np.zeros(len(bound)), bound, size=_DRAWS, method="cholesky")
    errors = [parameter_errors(_moved(joint, one), joint) for one in draws]
    correct = float(np.mean([one.correct(epsilon) for one in errors]))
    strict = float(np.mean([one.strict(epsilon) for one in errors]))
    return Limits(correct, strict, *_rests_tell(truth))


def ideal_covariance(truth: Demonstration) -> Floats:
    """Cramér-Rao bound of the joint's parameters.

    Returns:
        (k, k) for tilts of the axis (2) [rad], shifts of the centre (2, revolute only) [m], of the origin (3) [m], and
        turns of the part (3) [rad].
    """
    joint, tracker, c = truth.scene.joint, truth.scene.tracker, truth.motion.configuration
    n, k = len(c), 10 if joint.kind == "revolute" else 8
    by_parameter, step = np.empty((n, 6, k)), 1e-6
    for j in range(k):
        ahead, behind = (forward(_moved(joint, sign * step * np.eye(k)[j]), c) for sign in (1.0, -1.0))
        by_parameter[:, :3, j] = (ahead.translation - behind.translation) / (2 * step)
        by_parameter[:, 3:, j] = (ahead.rotation * behind.rotation.inv()).as_rotvec() / (2 * step)
    # The configuration of the first row is 0 by definition; a part that is shut has one configuration.
    free = np.eye(n)[:, 1:]
    if truth.scene.stops:
        first = truth.changepoints[0]
        free = np.concatenate([np.eye(n)[:, 1:first], (np.arange(n) >= first)[:, None].astype(float)], axis=1)
    slope = jacobian(joint, c)[:, [3, 4, 5, 0, 1, 2]]
    information = np.zeros((k + free.shape[1],) * 2)
    for axis in range(6):
        design = np.concatenate([by_parameter[:, axis], slope[:, axis, None] * free], axis=1)
        white = solve_triangular(_noise_root(tracker, n, axis), design, lower=True)
        information += white.T @ white
    # Parameters and configurations have unlike units: scaled for the inverse.
    size = 1.0 / np.sqrt(np.diag(information))
    covariance = size[:, None] * np.linalg.inv(size[:, None] * information * size) * size
    bound = covariance[:k, :k]
    return np.asarray((bound + bound.T) / 2)


def _noise_root(tracker: Tracker, rows: int, axis: int) -> Floats:
    """Cholesky factor of the covariance of one component's errors over time."""
    if axis < 3:
        white, wander = tracker.position_white, tracker.position_wander
    else:
        white, wander = tracker.rotation_white, tracker.rotation_wander
    lag = np.abs(np.subtract.outer(np.arange(rows), np.arange(rows)))
    covariance = wander**2 * np.exp(-lag / (tracker.memory * RATE)) + white**2 * np.eye(rows)
    return np.asarray(tracker.scale[axis % 3] * np.linalg.cholesky(covariance))


def _moved(joint: Joint, by: Floats) -> Joint:
    """The joint with its parameters moved, in the order of `ideal_covariance`."""
    basis = axis_basis(joint.axis)
    axis = np.array(joint.axis) + by[:2] @ basis
    position = np.array(joint.position) + by[-6:-3]
    quaternion = (Rotation.from_rotvec(by[-3:]) * Rotation.from_quat(joint.quaternion)).as_quat()
    if joint.kind == "prismatic":
        return prismatic(axis, position, quaternion)
    return revolute(axis, np.array(joint.center) + by[2:4] @ basis, position, quaternion)


def _rests_tell(truth: Demonstration) -> tuple[bool, bool]:
    """(actions tell, poses tell) rests from stops; see the module."""
    steps, asked = np.diff(truth.motion.configuration), truth.motion.command
    typical = truth.scene.travel / np.count_nonzero(steps)
    resting = steps < 0.05 * typical
    edges = np.flatnonzero(np.diff(np.concatenate([[False], resting, [False]]).astype(int)))
    rests = [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    stop = truth.changepoints[0] if truth.scene.stops else len(steps)
    vain = [float(asked[a:b].sum()) / typical for a, b in rests if a < stop]
    allowed = 0.5 * float(asked[stop:].sum()) / typical if truth.scene.stops else _VAIN_ROWS
    longest = max((b - a for a, b in rests if a < stop), default=0)
    return bool(max(vain, default=0.0) < allowed), longest < _REST_ROWS
