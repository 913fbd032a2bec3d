"""An object that stands, in MuJoCo: rigid bodies, friction, end stops, latches, and a hand that pulls at each part.

The plant uses the model's geometry, but none of its dynamics: motion, sticking, latching and springing back are
physics.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.arrays import EQUAL, Floats
from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import HybridAutomaton, Primitive
from micah_plan.automaton.joint import Joint, Vector3
from micah_plan.automaton.kinematics import forward
from micah_plan.errors import InputError
from micah_plan.execution.mujoco.core import LONGEST_STEP, PhysicalPlant
from micah_plan.execution.mujoco.guide import RUNS_ALONG, Guide, handle_velocity
from micah_plan.execution.mujoco.parameters import PhysicalParameters
from micah_plan.execution.mujoco.world import NOTHING, STOPS, Flags, LatchState, World, WorldJoint, pose
from micah_plan.execution.plant import Command, Measurement, Truth
from micah_plan.quantities import quantity
from micah_plan.task.body import vector3
from micah_plan.task.start import Start, sample_start

_ORIGIN = "/origin"
_STEPS_PER_RADIAN = 5.0
_SHORTEST_ARM = 0.005
_PANEL = 0.02
_UNLIMITED = 1e3


class StandingPlant(PhysicalPlant):
    """Any automaton with one moving joint per part, as a mechanism in MuJoCo.

    Each part's handle is pulled by a compliant hand (spring, critical damping, limited force), commanded by
    displacements relative to its place. Within a control step its target moves on a straight line and then rests. Its
    law is that of motors in the world, so that the engine can take steps alone as long as no hand exceeds its limit.
    """

    def __init__(self, automaton: HybridAutomaton, start: Start, parameters: PhysicalParameters | None = None) -> None:
        """Build the simulation.

        Args:
            automaton: the object, with its shapes or else boxes.
            start: the belief from which true starts are drawn.
            parameters: of the physics; None: the defaults.

        Raises:
            MissingDependencyError: if MuJoCo is not installed.
            InputError: if the automaton cannot be built as a mechanism.
        """
        parameters = parameters or PhysicalParameters()
        world, arms, self._guides = standing_world(automaton, parameters)
        model = world.spec.compile()
        for guide in self._guides:
            guide.find(world.mujoco, model)
        super().__init__(automaton, parameters, model, world.joints)
        self.start = start
        self._bodies = [model.body(link.child).id for link in automaton.links]
        self._still: Floats = np.zeros(automaton.n)
        self._motors = 3 * len(self._bodies)
        self._targets = np.zeros((1, self._motors))
        self._damping = self._tuned(arms)
        # By a latching joint's address: its first sensor's column, whether it is a hinge, and which hands pull at it.
        latching = [(model.joint(joint.name), joint.name) for joint, _ in self._shown if joint.latches]
        guided = {guide.address: guide for guide in self._guides}
        self._levers = {
            int(joint.qposadr[0]): (
                -1 if joint.qposadr[0] in guided else int(model.sensor(_lever(name)).adr[0]),
                joint.type[0] == self.mujoco.mjtJoint.mjJNT_HINGE,
                self._moved_with(model.body(name).id),
            )
            for joint, name in latching
        }
        self._guided = guided

    def reset(self, rng: np.random.Generator) -> Measurement:
        """Start a trial: a start sampled from the belief, at rest, latched if the start mode pins it."""
        mode, x = sample_start(self.automaton, self.start, rng)
        self._still = x.copy()
        for joint, _ in self._shown:
            if joint.is_shown:
                x[joint.coordinate] = np.clip(x[joint.coordinate], *self.model.joint(joint.name).range)
        self._place(x)
        for guide in self._guides:
            guide.put(self.model, self.data.qpos)
        free = self.automaton.mode(mode).free
        for latch in self.latches:
            position = x[latch.coordinate]
            closed = not free[latch.coordinate] and abs(position - latch.position) < 1e-9
            latch.armed = closed or not latch.is_near(position)
            self.data.eq_active[latch.equality] = closed
        # The hands take hold of the handles where they are, without a force.
        self.mujoco.mj_fwdPosition(self.model, self.data)
        self._targets = self.data.actuator_length[None].copy()
        self.data.ctrl[:] = self.parameters.stiffness * self._targets[0]
        self._begin(rng)
        return self._measure(0.0, np.zeros((len(self._bodies), 3)))

    def apply(self, command: Command) -> Measurement:
        """One control step: every hand moves by the commanded displacement from its handle's true position."""
        begin, end = self._targets[-1], self.data.actuator_length + command.handle.ravel()
        speed = (end - begin) / (self._moving_steps * self.model.opt.timestep)
        self._targets = begin + self.shares[:, None] * (end - begin)
        controls = self.parameters.stiffness * self._targets
        controls[: self._moving_steps] += self._damping * speed
        self._run(controls)
        self.mujoco.mj_fwdPosition(self.model, self.data)  # places of now; a step leaves those of its beginning
        return self._measure(self.parameters.control_period, np.array(self.data.actuator_force).reshape(-1, 3))

    def truth(self) -> Truth:
        """The true configuration, poses and latches."""
        x = self._still.copy()
        latched = self._show(x)
        return Truth(None, x, *self._poses(self._bodies), latched)

    def _measure(self, elapsed: float, force: Floats) -> Measurement:
        return Measurement(float(self.data.time), *self._tracked(*self._poses(self._bodies), elapsed), force)

    def _suspects(self, measured: Floats) -> Flags:
        """Flags of a hand force above its limit, or of a part on a path that enters the next stretch."""
        forces = measured[:, self._motors : 2 * self._motors].reshape(len(measured), -1, 3)
        suspects = np.asarray((self._limited(forces) != forces).any(axis=(1, 2)))
        for guide in self._guides:
            suspects |= guide.leaves(measured[:, guide.sensor])
        return suspects

    def _follow(self) -> bool:
        came = [guide.follow(self.model, self._positions.item(guide.address)) for guide in self._guides]
        return any(came)

    def _limit_hands(self) -> bool:
        data, limit, stiffness = self.data, self.parameters.max_force, self.parameters.stiffness
        passive = stiffness * data.actuator_length + self._damping * data.actuator_velocity
        forces, too_strong = (data.ctrl - passive).tolist(), False
        for i in range(0, self._motors, 3):  # in plain floats, which is faster
            size = math.hypot(*forces[i : i + 3])
            if size > limit:
                data.ctrl[i : i + 3] += np.multiply(forces[i : i + 3], limit / size - 1.0)
                too_strong = True
        return too_strong

    def _limited(self, forces: Floats) -> Floats:
        """Forces (..., 3) limited to the hand's strength [N]."""
        size = np.sqrt(np.square(forces).sum(axis=-1, keepdims=True))
        return np.asarray(forces * (self.parameters.max_force / np.maximum(size, self.parameters.max_force)))

    def _pull(self, latch: LatchState, begin: int, measured: Floats) -> Floats:
        """(k,) pull of the hands' springs without damping, whose impulse at a latch must not open it."""
        column, turns, hands = self._levers[latch.joint]
        places = measured[:, : self._motors].reshape(len(measured), -1, 3)[:, hands]
        targets = self._targets[begin : begin + len(measured)].reshape(len(measured), -1, 3)[:, hands]
        pulls = self._limited(self.parameters.stiffness * (targets - places))
        if latch.joint in self._guided:
            guide = self._guided[latch.joint]
            above = self.data.xmat[self.model.body(guide.part).parentid[0]].reshape(3, 3)
            return np.asarray(pulls.sum(axis=1) @ above @ guide.lever(latch.position))
        if turns:
            pulls = np.cross(places - measured[:, None, column : column + 3], pulls)
        return np.asarray((measured[:, None, column + 3 : column + 6] * pulls).sum(axis=(1, 2)))

    def _tuned(self, arms: Floats) -> Floats:
        """(3 l,) the motors' critical damping [N s/m]; sets them and a pace that resolves their springs."""
        model, stiffness = self.model, self.parameters.stiffness
        dofs = model.body_dofadr[self._bodies]
        carried = np.where(dofs < 0, 0.0, model.dof_M0[dofs])
        for guide in self._guides:
            carried[self._bodies.index(model.body(guide.part).id)] = guide.inertia
        masses = carried / np.square(arms)
        if masses.any():
            fastest = float(np.sqrt(stiffness / masses[masses > 0].min()))
            self._set_pace(min(LONGEST_STEP, 1 / (_STEPS_PER_RADIAN * fastest)))
        damping = np.repeat(2 * np.sqrt(stiffness * masses), 3)
        model.actuator_biasprm[:, 1], model.actuator_biasprm[:, 2] = -stiffness, -damping
        return np.asarray(damping)

    def _moved_with(self, body: int) -> list[int]:
        """Numbers of the parts that a body's joint moves: its own, and those attached to it."""
        moved = {body}
        moved.update(body for body in self._bodies if self.model.body_parentid[body] in moved)
        return [number for number, body in enumerate(self._bodies) if body in moved]


def standing_world(automaton: HybridAutomaton, parameters: PhysicalParameters) -> tuple[World, Floats, list[Guide]]:
    """The world of a standing object whose joint positions are the configurations, without collisions.

    Each part has a hand: three motors along the axes of the base frame, whose lengths are the place of its handle [m].
    Sensors are the lengths of all motors, then their forces [N], then of each joint that can latch position, anchor and
    axis.

    Returns:
        the world, how far each part's handle moves per unit of its joint (l,) [m/rad], or 1 for a slide, and the guides
        of the parts that move along paths.

    Raises:
        InputError: if the automaton cannot be a mechanism of one joint per part, a hand could not turn a part, or a
            shape has an unknown kind or size.
    """
    if len({link.coordinate for link in automaton.links}) != automaton.n:
        raise InputError(
            "physics needs one link per coordinate of the model", remedy="use the nominal plant for this model"
        )
    world = World()
    spec, kinds = world.spec, world.mujoco
    spec.option.gravity = (0.0, 0.0, -parameters.gravity)
    spec.option.disableflags = int(kinds.mjtDisableBit.mjDSBL_CONTACT)
    spec.worldbody.add_site(name=_ORIGIN)
    world.solids(spec.worldbody, automaton.part(BASE).shapes, 0.0, NOTHING)
    motors = [(link.child, f"{link.child}/{axis}", axis) for link in automaton.links for axis in range(3)]
    at_site, affine = kinds.mjtTrn.mjTRN_SITE, kinds.mjtBias.mjBIAS_AFFINE
    for site, name, axis in motors:
        gear = np.eye(6)[axis]
        spec.add_actuator(name=name, trntype=at_site, target=site, refsite=_ORIGIN, gear=gear, biastype=affine)
    for kind in (kinds.mjtSensor.mjSENS_ACTUATORPOS, kinds.mjtSensor.mjSENS_ACTUATORFRC):
        for _, name, _ in motors:
            spec.add_sensor(type=kind, objtype=kinds.mjtObj.mjOBJ_ACTUATOR, objname=name)
    bodies, arms, guides = {BASE: spec.worldbody}, list[float](), list[Guide]()
    for number, link in enumerate(automaton.links):
        joint, part = _only_moving_joint(automaton, number), automaton.part(link.child)
        handle = part.handle or (0.0, 0.0, 0.0)
        arms.append(_arm(link.child, joint, handle))
        above = bodies.get(link.parent, spec.worldbody)
        body = bodies[link.child] = above.add_body(name=link.child, **pose(joint.position, joint.quaternion))
        world.solids(body, part.shapes or (_default_box(joint),), parameters.mass, NOTHING)
        body.add_site(name=link.child, pos=handle)
        if joint.moves and not joint.has_axis:
            if not joint.knots:
                problem = f"physics cannot build the {joint.kind} joint of part '{link.child}'"
                raise InputError(problem, remedy="use the nominal plant for this model")
            guides.append(Guide(link.child, joint, handle))
            runner = guides[-1].build(world, above, body, parameters.mass)
            _add_joint(world, runner, automaton, number, arms[-1], parameters)
            guides[-1].tie(world)
        elif joint.moves:
            _add_joint(world, body, automaton, number, arms[-1], parameters)
    return world, np.array(arms), guides


def _only_moving_joint(automaton: HybridAutomaton, link: int) -> Joint:
    """The joint that moves a link in all modes that do not hold it."""
    joint = automaton.moving_joint(link)
    places = forward(joint, [0.0, 0.5]).as_matrix()
    for other in (mode.joints[link] for mode in automaton.modes if mode.joints[link].moves):
        if other.kind != joint.kind or not np.allclose(places, forward(other, [0.0, 0.5]).as_matrix(), atol=EQUAL):
            name = automaton.links[link].child
            raise InputError(
                f"part '{name}' moves by different joints in different modes, which physics cannot build",
                remedy="use the nominal plant for this model",
            )
    return joint


def _add_joint(
    world: World, body: Any, automaton: HybridAutomaton, number: int, arm: float, parameters: PhysicalParameters
) -> None:
    """Add a slide, a hinge, or a hinge with a coupled slide for a screw, with latches where a mode pins it."""
    joint, link = automaton.moving_joint(number), automaton.links[number]
    axis, position = RUNS_ALONG, np.zeros(3)
    if joint.has_axis:
        to_part = Rotation.from_quat(joint.quaternion).inv()
        axis, position = to_part.apply(joint.axis), to_part.apply(np.subtract(joint.center, joint.position))
    intervals = [mode.interval(link.coordinate) for mode in automaton.modes]
    lower, upper = min(low for low, _ in intervals), max(high for _, high in intervals)
    pins = {pin.value for mode in automaton.modes for pin in mode.pins if pin.coordinate == link.coordinate}
    capture, release = parameters.latch_capture / arm, parameters.latch_force * arm
    latches = [
        LatchState(pin, pin - capture, pin + capture, release, pin - lower > capture, upper - pin > capture)
        for pin in sorted(pins)
    ]
    attributes = {
        "pos": position,
        "axis": axis,
        # A hinge's moment is the force at the handle times the arm; its damping relates moment to angular velocity.
        "damping": parameters.damping * arm**2,
        "frictionloss": parameters.friction * arm,
        "range": np.clip([lower, upper], -_UNLIMITED, _UNLIMITED),
        **STOPS,
    }
    world.joint(body, "hinge" if joint.turns else "slide", link.child, **attributes)
    world.show(WorldJoint(link.child, link.coordinate, latches=latches))
    if joint.climbs:
        slide = WorldJoint(f"{link.child}/slide", link.coordinate, joint.pitch, is_shown=False)
        world.joint(body, "slide", slide.name, axis=axis)
        world.show(slide)
        world.tie(slide.name, (0.0, joint.pitch), link.child)
    if latches and joint.has_axis:
        name, kinds = _lever(link.child), world.mujoco.mjtSensor
        at = {"objtype": world.mujoco.mjtObj.mjOBJ_SITE, "objname": name}
        along = body.add_site(name=name, pos=position).alt
        along.type, along.zaxis = world.mujoco.mjtOrientation.mjORIENTATION_ZAXIS, axis
        world.spec.add_sensor(name=name, type=kinds.mjSENS_FRAMEPOS, **at)
        world.spec.add_sensor(type=kinds.mjSENS_FRAMEZAXIS, **at)


def _lever(joint: str) -> str:
    """Name of the sensor of a latching joint's anchor; that of its axis follows."""
    return f"{joint}/lever"


def _arm(name: str, joint: Joint, handle: Vector3) -> float:
    """Length of the handle's path per unit of the coordinate [m/rad or 1]."""
    if not joint.moves:
        return 1.0
    arm = float(np.linalg.norm(handle_velocity(joint, handle, 0.0)))
    if arm < _SHORTEST_ARM:
        raise InputError(
            f"the handle of part '{name}' lies on its axis (distance {quantity(arm, 'm')}), so no hand can turn it",
            remedy="give the part a handle away from the axis",
        )
    return arm


def _default_box(joint: Joint) -> Primitive:
    """A default shape: a panel between the axis and the part's origin (hinge), or a box around it (slide)."""
    if not joint.turns:
        return Primitive("box", (0.3, 0.3, 0.15))
    reach = np.array(joint.position) - np.array(joint.center)
    length = float(np.linalg.norm(reach))
    if length < _SHORTEST_ARM:
        return Primitive("box", (0.1, 0.1, _PANEL))
    along, axis = reach / length, np.array(joint.axis)
    to_part = forward(joint, 0.0)[0].rotation.inv()
    frame = to_part.as_matrix() @ np.column_stack([along, np.cross(axis, along), axis])
    x, y, z, w = Rotation.from_matrix(frame).as_quat(canonical=True).tolist()
    return Primitive("box", (length, _PANEL, length), vector3(to_part.apply(-reach / 2)), (x, y, z, w))
