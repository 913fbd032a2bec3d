"""Motion along paths in MuJoCo, which offers only hinges and slides.

A runner slides as far as the configuration. The part has three slides and three hinges, and each is tied to the runner
by a polynomial, one set of them for every interval between knots of the path; as the runner goes from one interval to
the next, the plant sets the next polynomials. Positions are exact, since a path is a cubic between its knots; for
angles the polynomials interpolate at five places, continuous at the knots.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial
from scipy.spatial.transform import Rotation

from micah_plan.arrays import Floats, Ints
from micah_plan.automaton.joint import Joint, Vector3
from micah_plan.automaton.kinematics import forward, jacobian
from micah_plan.execution.mujoco.world import Flags, World

_PLACES = 0.5 - 0.5 * np.cos(np.pi * np.arange(5) / 4)  # Chebyshev's, of the second kind, in shares of a stretch
_AROUND = 33  # places at which the axis is looked for that a part turns about most
_INERTIA = 1e-3  # of the runner, in masses of the part
_RUNNER = "/runner"
RUNS_ALONG = (0.0, 0.0, 1.0)


class Guide:
    """A part's path as constraints between its six joints and a runner.

    Attributes:
        part: name of its body; the runner's joint has the same.
        address, sensor: in the compiled world, of the runner's joint, and the column that shows its position.
        inertia: of the part as the runner feels it at c = 0 [kg m^2 per unit of c squared].
    """

    def __init__(self, part: str, joint: Joint, handle: Vector3) -> None:
        self.part, self.joint, self.handle = part, joint, handle
        self.knots = np.array(joint.knots)[:, 0]
        self._axes = _turned_about(joint, self.knots)
        self._ties = np.stack([self._between(low, high) for low, high in pairwise(self.knots.tolist())])
        self.address, self.sensor, self.inertia = -1, -1, 0.0
        self._equalities: Ints = np.zeros(6, dtype=np.int64)
        self._addresses = self._equalities
        self._stretch = 0

    def build(self, world: World, above: Any, body: Any, mass: float) -> Any:
        """Add the six joints of a body and a runner in the same frame; returns the runner's body, without joints.

        Args:
            body: at its pose at c = 0.
            mass: of the part [kg].
        """
        runner = above.add_body(name=self.part + _RUNNER)
        runner.mass, runner.inertia, runner.explicitinertial = _INERTIA * mass, 3 * [_INERTIA * mass], True
        for kind, axes in (("slide", np.eye(3)), ("hinge", self._axes.T)):
            for axis in axes:
                world.joint(body, kind, f"{self.part}/{len(body.joints)}", axis=axis)
        return runner

    def tie(self, world: World) -> None:
        """Add the constraints, and show the runner's position."""
        for number in range(6):
            name = f"{self.part}/{number}"
            world.tie(name, self._ties[0, number], self.part, name=name)
        kinds = world.mujoco
        reference = {"objtype": kinds.mjtObj.mjOBJ_JOINT, "objname": self.part}
        world.spec.add_sensor(name=self.part + _RUNNER, type=kinds.mjtSensor.mjSENS_JOINTPOS, **reference)

    def find(self, mujoco: Any, model: Any) -> None:
        """Look up the addresses in the compiled world.

        The engine scales constraints on a joint by the joint's own inertia; the runner has the part's.
        """
        names = [f"{self.part}/{number}" for number in range(6)]
        self._equalities = np.array([model.equality(name).id for name in names])
        self._addresses = np.array([model.joint(name).qposadr[0] for name in names])
        self.address = int(model.joint(self.part).qposadr[0])
        self.sensor = int(model.sensor(self.part + _RUNNER).adr[0])
        self.inertia = self._carried(mujoco, model)
        model.dof_invweight0[model.joint(self.part).dofadr[0]] = 1 / self.inertia

    def put(self, model: Any, qpos: Floats) -> None:
        """Set the part's joints to where the runner is."""
        c = float(qpos[self.address])
        self.follow(model, c)
        qpos[self._addresses] = self._ties[self._stretch] @ c ** np.arange(5)

    def follow(self, model: Any, c: float) -> bool:
        """Switch to the constraints of the stretch at c; returns whether it changed."""
        stretch = int(self._stretches(np.array(c)))
        changed = stretch != self._stretch or not np.array_equal(
            model.eq_data[self._equalities, :5], self._ties[stretch]
        )
        if changed:
            self._stretch = stretch
            model.eq_data[self._equalities, :5] = self._ties[stretch]
        return changed

    def leaves(self, c: Floats) -> Flags:
        """(k,) whether configurations lie outside the active stretch."""
        return np.asarray(self._stretches(c) != self._stretch)

    def lever(self, c: float) -> Floats:
        """(3,) factor from a force on the handle to one on the runner, in the frame of the parent.

        Along the path, and as long as at c = 0: a latch resists a force at the handle.
        """
        velocity, arm = handle_velocity(self.joint, self.handle, c), handle_velocity(self.joint, self.handle, 0.0)
        return np.asarray(velocity * (np.linalg.norm(arm) / np.linalg.norm(velocity)))

    def _carried(self, mujoco: Any, model: Any) -> float:
        """Effective mass at c = 0 of what the runner moves [kg m^2 per unit of c squared]."""
        data, velocity, momentum = mujoco.MjData(model), np.zeros(model.nv), np.zeros(model.nv)
        mujoco.mj_forward(model, data)
        joints = [int(model.joint(f"{self.part}/{number}").dofadr[0]) for number in range(6)]
        velocity[joints] = self._ties[int(self._stretches(np.zeros(())))][:, 1]
        mujoco.mj_mulM(model, data, momentum, velocity)
        return float(velocity @ momentum)

    def _stretches(self, c: Floats) -> Ints:
        """(k,) interval between knots of each configuration."""
        return np.clip(np.searchsorted(self.knots, c, side="right") - 1, 0, len(self._ties) - 1)

    def _between(self, low: float, high: float) -> Floats:
        """(6, 5) coefficients of 1, c, ..., c^4 for the joints between two knots."""
        c = low + _PLACES * (high - low)
        joints = self._joints(c)
        ties = [Polynomial.fit(c, values, 4, domain=[low, high]).convert().coef for values in joints.T]
        return np.stack([np.pad(coefficients, (0, 5 - len(coefficients))) for coefficients in ties])

    def _joints(self, c: Floats) -> Floats:
        """(k, 6) positions of the three slides and the three hinges."""
        start = forward(self.joint, 0.0)[0]
        there = forward(self.joint, np.append(self.knots[0], c))
        shift = start.rotation.inv().apply(there.translation[1:] - start.translation)
        angles = _angles(start.rotation.inv() * there.rotation, self._axes)
        # Whole turns are counted from the first knot on.
        fine = np.linspace(self.knots[0], self.knots[-1], 8 * len(self.knots))
        first = _angles(start.rotation.inv() * forward(self.joint, fine).rotation, self._axes)
        near = np.stack([np.interp(c, fine, column) for column in np.unwrap(first, axis=0).T], axis=1)
        return np.hstack([shift, angles[1:] + 2 * np.pi * np.round((near - angles[1:]) / (2 * np.pi))])


def handle_velocity(joint: Joint, handle: Vector3, c: float) -> Floats:
    """(3,) velocity of a handle [m], in the part's frame, per unit of the configuration."""
    rotation, translation = np.split(jacobian(joint, c)[0], 2)
    return np.asarray(translation + np.cross(rotation, forward(joint, c)[0].rotation.apply(handle)))


def _turned_about(joint: Joint, knots: Floats) -> Floats:
    """(3, 3) axes of the hinges as columns, the first along the part's main rotation, at c = 0."""
    c = np.linspace(knots[0], knots[-1], _AROUND)
    turns = forward(joint, 0.0)[0].rotation.inv() * forward(joint, c).rotation
    steps = (turns[:-1].inv() * turns[1:]).as_rotvec()
    axes = np.linalg.svd(steps)[2].T
    return np.asarray(axes * np.sign(np.linalg.det(axes)))


def _angles(turns: Rotation, axes: Floats) -> Floats:
    """(k, 3) angles of hinges about successively rotated axes."""
    frame = Rotation.from_matrix(axes)
    return np.asarray((frame.inv() * turns * frame).as_euler("XYZ"))
