"""A released object in MuJoCo: a free body, held by friction until the fingers open.

While a hand carries an object, the object is a part of the hand. To release it, the world is built a second time with
the object free and the fingers on motors. It starts from the current state, the fingers close until they press on the
object, then they open, not quite at once, and the object's motion is physics.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.arrays import Floats
from micah_plan.automaton.contacts.touch import box_corners
from micah_plan.automaton.contacts.values import AXES, Grip
from micah_plan.automaton.hybrid import Primitive
from micah_plan.automaton.kinematics import part_poses
from micah_plan.errors import InputError
from micah_plan.execution.mujoco.core import Carrier, PhysicalPlant
from micah_plan.execution.mujoco.held_object import HeldObject
from micah_plan.execution.mujoco.incidents import LARGEST_TILT, IncidentWatch
from micah_plan.execution.mujoco.parameters import PhysicalParameters
from micah_plan.execution.mujoco.world import (
    ARM_MEETS,
    ARM_TYPE,
    OBJECT,
    SCENE,
    World,
    add_finger_motor,
    add_hand,
    contact_surface,
    scene_world,
)
from micah_plan.task.problem import Problem
from micah_plan.task.release import resting_place

# Fingers of a hand without an arm [m], and the gap that is left to the object until they close.
_PAD, _GAP = (0.02, 0.01, 0.03), 0.002
# Seconds in which fingers close and hold, and in which they open; further than an object is wide they never close [m].
_CLOSING, _OPENING, _FURTHEST = 0.2, 0.3, 0.05
# What moves less than this in a control step rests [m and rad]: the engine's contacts tremble by some hundredths of it.
_STILL = 0.001
_PADS = ("left pad", "right pad")
_FREE = "free/"


class Support:
    """The support of a release, whose height varies between trials."""

    def __init__(self, problem: Problem, model: Any) -> None:
        """Args: model: of a world with the problem's scene."""
        release = problem.release
        self._std = 0.0 if release is None else release.support_std
        self.raised = 0.0
        body = model.body(SCENE + release.support).id if release is not None else -1
        self._geoms = np.flatnonzero(model.geom_bodyid == body)
        self._model = model
        self._nominal = model.geom_size.copy(), model.geom_pos.copy()

    def draw(self, rng: np.random.Generator) -> None:
        """Sample the error of the height."""
        if len(self._geoms):
            self.set(self._std * float(rng.standard_normal()))

    def set(self, raised: float) -> None:
        """Raise the upper side by a length [m]; the lower side stays in place."""
        (size, position), geoms, self.raised = self._nominal, self._geoms, raised
        for number in geoms:
            along = Rotation.from_quat(self._model.geom_quat[number], scalar_first=True).inv().apply([0.0, 0.0, 1.0])
            axis = int(np.argmax(np.abs(along)))
            self._model.geom_size[number] = size[number]
            if size[number][axis] > abs(raised):
                self._model.geom_size[number, axis] = size[number, axis] + raised / 2
            upright = Rotation.from_quat(self._model.body_quat[self._model.geom_bodyid[number]], scalar_first=True)
            self._model.geom_pos[number] = position[number] + upright.inv().apply([0.0, 0.0, raised / 2])
            self._model.geom_sameframe[number] = 0  # the engine would take the body's place for that of the geom
            self._model.geom_rbound[number] = np.linalg.norm(self._model.geom_size[number])
            self._model.geom_aabb[number, 3:] = self._model.geom_size[number]


@dataclass(frozen=True, eq=False)
class Handover:
    """The state of the world in which the hand still holds the object.

    Attributes:
        world, carrier: the world, and the mover of its hand.
        held: number of the body of the part in the hand.
        raised: how much higher the support is than in the problem [m].
        weight, roughness: factors of the object's mass and of friction in this trial.
    """

    world: PhysicalPlant
    carrier: Carrier
    held: int
    raised: float
    weight: float
    roughness: float


class ReleasedPlant(PhysicalPlant):
    """The world with the object free and motorised fingers, compiled on demand.

    Attributes:
        incident: a forbidden event; empty without one.
    """

    def __init__(self, problem: Problem, parameters: PhysicalParameters, posture: Floats | None) -> None:
        """Args: posture: as in `held.HeldPlant`.

        Raises:
            InputError: if the problem does not define how the robot's gripper opens.
        """
        self._problem, self._own, self._posture = problem, parameters, posture
        if problem.robot is not None and problem.release is not None and not problem.release.fingers:
            text = "release.fingers: a robot releases by joints that open its gripper, found none"
            raise InputError(text, remedy="name them, with where they are when open")
        self._is_built, self.incident = False, ""

    def _build(self) -> None:
        problem, parameters = self._problem, self._own
        if problem.hold is None or problem.release is None:  # it was asked for
            raise RuntimeError("nothing is released")
        scene, carried, grip = scene_world(problem.scene, parameters), World(), problem.hold.grip
        has_arm, fingers = problem.robot is not None, [name for name, _ in problem.release.fingers]
        hand = add_hand(carried, parameters, slides=not has_arm)
        if has_arm:
            from micah_plan.execution.mujoco.arm import attach_arm  # Pinocchio is loaded only where there is an arm

            carry: Callable[[PhysicalPlant], Carrier] = attach_arm(
                scene, hand, problem, parameters, self._posture, fingers
            )
            prefix = "robot/"
            self._goals = [(prefix + name, value) for name, value in problem.release.fingers]
        else:
            _add_pads(carried, hand, grip, parameters)
            scene.spec.worldbody.add_frame().attach_body(hand, OBJECT, "")
            carry = partial(Carrier, joints=[OBJECT + axis for axis in AXES])
            self._goals = [(OBJECT + name, 0.015) for name in _PADS]
        free = World()
        HeldObject(problem.automaton, grip, parameters).build(free, free.spec.worldbody, is_free=True)
        body = free.spec.body(grip.held.name)
        scene.spec.worldbody.add_frame().attach_body(body, _FREE, "")
        super().__init__(problem.automaton, parameters, scene.spec.compile())
        model = self.model
        self._nominal = model.geom_friction.copy(), model.body_mass.copy(), model.body_inertia.copy()
        self._bodies = [model.body(_FREE + part.name).id for part in (grip.held, grip.moving)]
        self._hand = model.body(OBJECT + "hand").id
        self._support, self._carrier = Support(problem, model), carry(self)
        self._watch = IncidentWatch(self, frozenset())
        self._fingers = [int(model.actuator(name).id) for name, _ in self._goals]
        self._finger_places = [int(model.joint(name).qposadr[0]) for name, _ in self._goals]
        self._point, self._is_built = np.array(grip.point), True
        rest = resting_place(problem)
        mode = problem.automaton.mode(rest.mode)
        in_hand = part_poses(problem.automaton, mode, np.zeros(problem.automaton.n))[grip.held.name].rotation
        self._upright = Rotation.from_rotvec(rest.turn) * in_hand

    def take_over(self, before: Handover, rng: np.random.Generator) -> None:
        """Continue from the state of another world; rng: of this trial."""
        if not self._is_built:
            self._build()
        model, data = self.model, self.data
        world, was = before.world.model, before.world.data
        self.mujoco.mj_resetData(model, data)
        friction, mass, inertia = self._nominal
        model.geom_friction[:] = friction * before.roughness
        model.body_mass[self._bodies] = mass[self._bodies] * before.weight
        model.body_inertia[self._bodies] = inertia[self._bodies] * before.weight
        self._support.set(before.raised)
        self._carrier.put_like(before.carrier)
        data.ctrl[self._fingers] = data.qpos[self._finger_places]
        for number in range(model.nbody):
            name = model.body(number).name
            if name.startswith(SCENE) and model.body_jntnum[number]:
                here = int(model.jnt_qposadr[model.body_jntadr[number]])
                partner = world.body(name).id
                there = int(world.jnt_qposadr[world.body_jntadr[partner]])
                data.qpos[here : here + 7] = was.qpos[there : there + 7]
        held = before.held
        here = int(model.jnt_qposadr[model.body_jntadr[self._bodies[0]]])
        data.qpos[here : here + 3], data.qpos[here + 3 : here + 7] = was.xpos[held], was.xquat[held]
        for number in range(model.neq):
            name = model.equality(number).name
            if name.startswith(_FREE):
                data.eq_active[number] = was.eq_active[world.equality(OBJECT + name.removeprefix(_FREE)).id]
        if model.body_jntnum[self._bodies[1]]:
            there = int(world.joint(f"{OBJECT}joint").qposadr[0])
            data.qpos[int(model.joint(f"{_FREE}joint").qposadr[0])] = was.qpos[there]
        self._begin(rng)
        self.data.time = was.time
        self.incident = ""
        self._watch.begin()
        self._rng, self._last, self._moved = rng, (self.place, self._turn), 0.0

    def open(self) -> None:
        """Close the fingers until they press, wait, and open them with a small delay between them."""
        data, period = self.data, self.model.opt.timestep
        places = data.qpos[self._finger_places]
        opening = np.sign([goal - at for (_, goal), at in zip(self._goals, places, strict=True)])
        self._hold(places - opening * _FURTHEST, _CLOSING)
        pressed = data.qpos[self._finger_places] - opening * self._own.grip_deflection
        late = np.zeros(len(opening))
        late[int(self._rng.integers(len(late)))] = self._rng.uniform(0.0, self._own.grip_unevenness)
        goals = np.array([goal for _, goal in self._goals])
        steps = round((_OPENING + self._own.grip_unevenness) / period)
        orders = np.tile(data.ctrl, (steps, 1))
        times = period * np.arange(steps)
        for column, motor in enumerate(self._fingers):
            share = np.clip((times - late[column]) / (_OPENING / 2), 0.0, 1.0)
            orders[:, motor] = pressed[column] + share * (goals[column] - pressed[column])
        self._run(orders)
        self._hold(goals, self.parameters.control_period)
        self._look_around()

    def move(self, displacement: Floats, posture: Floats | None) -> None:
        """One control step of the hand."""
        self._run(self._carrier.orders(displacement, posture))
        self._look_around()

    @property
    def place(self) -> Floats:
        """(3,) position of the grasped point of the object [m]."""
        held = self._bodies[0]
        return np.asarray(self.data.xpos[held] + self.data.xmat[held].reshape(3, 3) @ self._point)

    @property
    def stands(self) -> bool:
        """Whether the object rests upright, without contact to the arm or hand."""
        turned = self._turn * self._upright.inv()
        if turned.magnitude() > LARGEST_TILT or self._moved > _STILL:
            return False
        return not any(self._touches_arm(number) for number in range(self.data.ncon))

    @property
    def _turn(self) -> Rotation:
        """Orientation of the part that was in the hand."""
        return Rotation.from_matrix(self.data.xmat[self._bodies[0]].reshape(3, 3))

    @property
    def parts(self) -> tuple[Floats, Floats]:
        """(2, 3) positions [m] and (2, 4) quaternions of the two parts."""
        return self._poses(self._bodies)

    @property
    def hand(self) -> Floats:
        """(3,) place of the hand [m]."""
        return np.asarray(self.data.xpos[self._hand])

    @property
    def time(self) -> float:
        return float(self.data.time)

    @property
    def joints(self) -> Floats | None:
        """(J,) of the arm; None without one."""
        return self._carrier.joints

    @property
    def complaint(self) -> str:
        """The reason why the hand could not reach its command; empty if it could."""
        return self._carrier.complaint

    def _hold(self, fingers: Floats, seconds: float) -> None:
        orders = np.tile(self.data.ctrl, (round(seconds / self.model.opt.timestep), 1))
        orders[:, self._fingers] = fingers
        self._run(orders)

    def _look_around(self) -> None:
        self.mujoco.mj_forward(self.model, self.data)
        (place, turn), self._last = self._last, (self.place, self._turn)
        moved, turned = np.linalg.norm(self._last[0] - place), (self._last[1] * turn.inv()).magnitude()
        self._moved = max(float(moved), float(turned))
        self._watch.look_at_loose_bodies()
        self.incident = self.incident or self._watch.incident

    def _touches_arm(self, number: int) -> bool:
        contact, model = self.data.contact[number], self.model
        owners = {int(model.geom_bodyid[geom]) for geom in (contact.geom1, contact.geom2)}
        others = [model.body(owner).name for owner in owners - set(self._bodies)]
        return len(others) == 1 and not others[0].startswith(SCENE) and others[0] != "world"


def contact_force(plant: PhysicalPlant, bodies: Sequence[int]) -> Floats:
    """(3,) force on some bodies by all others that they touch [N], base frame."""
    model, data, total, velocity = plant.model, plant.data, np.zeros(3), np.zeros(6)
    for number in range(data.ncon):
        contact = data.contact[number]
        inside = [int(model.geom_bodyid[geom]) in bodies for geom in (contact.geom1, contact.geom2)]
        if inside[0] != inside[1]:
            plant.mujoco.mj_contactForce(model, data, number, velocity)
            force = (
                contact.frame.reshape(3, 3).T @ velocity[:3]
            )  # on the second of the two, along the normal from the first
            total += force if inside[1] else -force
    return total


def _add_pads(world: World, hand: Any, grip: Grip, parameters: PhysicalParameters) -> None:
    """Add two fingers beside the held part, on slides along the hinge's direction."""
    rotation = Rotation.from_rotvec(grip.rotation)
    wide = box_corners(grip.held.shapes)[:, 1]
    for name, sign, edge in zip(_PADS, (1.0, -1.0), (wide.max(), wide.min()), strict=True):
        middle = np.array([0.0, edge - grip.point[1] + sign * (_GAP + _PAD[1] / 2), 0.0])
        turn = rotation.as_quat()
        pad = hand.add_body(name=name, pos=rotation.apply(middle), quat=np.roll(turn, 1), gravcomp=1)
        world.joint(pad, "slide", name, axis=(0.0, sign, 0.0))
        surface = contact_surface({"contype": ARM_TYPE, "conaffinity": ARM_MEETS}, parameters)
        world.solids(pad, (Primitive("box", _PAD),), 0.05, surface)
        add_finger_motor(world.spec, name, parameters)
