"""How well `explore` opens objects that MuJoCo simulates: hand compliance, friction, latches, inertia, tracker noise.

    python -m benchmarks explore_physics [--objects 100] [--first-seed 10000] [--plant own|mujoco] [--json FILE]

`own`: a world of this file for ten families: chains of slides and hinges, latches that a pull opens, panels that bend,
pulled by a damped spring. `mujoco`: the plant of that name that the package has, for the nine of them that it can
build. Objects are those of `explore_plants.py` without play and stick-slip. Forces are the largest of any physics step.
"""

from __future__ import annotations

import argparse
import warnings
from dataclasses import replace
from itertools import count
from typing import Any

import mujoco
import numpy as np
from explore_plants import LATCHED, Floats, Thing, drawn
from saving import add_json, save_json
from scipy.spatial.transform import Rotation

from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.hybrid import Part
from micah_plan.automaton.joint import prismatic, revolute, rigid
from micah_plan.execution.handle import HANDLE, make_handle_plant
from micah_plan.execution.handle import HandlePlant as Checked
from micah_plan.execution.plant import Command, Measurement
from micah_plan.explore.run import explore
from micah_plan.task.experiment import Scene
from micah_plan.task.goal import Goal
from micah_plan.task.problem import Problem
from micah_plan.task.start import Start

HINGES = ("hinge_left", "hinge_right", "hinge_above", "hinge_below")
SHIPPED = (*HINGES, "drawer", "sliding", *LATCHED, "locked")
FAMILIES = (*SHIPPED, "two_stage", "locked_flex")
_STEP, _MOVING, _RESTING = 0.002, 200, 400  # s, and physics steps of a command
_MASS, _DAMPING = 2.0, 2.0  # kg, N s/m at the handle
_ENOUGH, _NEAR = 0.19, 0.001


class Physical:
    """A plant made for a scene, which it ignores: the world of an object, and a hand that is a damped spring."""

    def __init__(self, _scene: object, thing: Thing) -> None:
        self.thing, self.largest_force = thing, 0.0
        self.model = _world(thing).compile()
        self.data = mujoco.MjData(self.model)
        self.arms = np.array([1.0 / (float(np.linalg.norm(stage.turn)) or 1.0) for stage in thing.stages])
        self.damping = 2.0 * np.sqrt(thing.stiffness * _MASS)
        self.released = thing.latch == 0.0

    def reset(self, rng: np.random.Generator) -> Measurement:
        self.rng = rng
        mujoco.mj_resetData(self.model, self.data)
        if not self.thing.is_locked:
            self.data.qpos[0] = self.thing.start / self.arms[0]
        self._fix()
        mujoco.mj_forward(self.model, self.data)
        return self._measure(np.zeros(3))

    def close(self) -> None:
        """Nothing to free."""

    @property
    def travelled(self) -> float:
        """True way of the handle since the start [m]."""
        return 0.0 if self.thing.is_locked else abs(float(self.data.qpos @ self.arms) - self.thing.start)

    def apply(self, command: Command) -> Measurement:
        model, data, site = self.model, self.data, 0
        begin, end = data.site_xpos[site].copy(), data.site_xpos[site] + np.asarray(command.handle)[0]
        jacobian, force = np.zeros((3, model.nv)), np.zeros(3)
        for number in range(_MOVING + _RESTING):
            mujoco.mj_step1(model, data)
            mujoco.mj_jacSite(model, data, jacobian, None, site)
            target = begin + (end - begin) * min(1.0, (number + 1) / _MOVING)
            spring = self.thing.stiffness * (target - data.site_xpos[site])
            force = spring - self.damping * (jacobian @ data.qvel)
            self.largest_force = max(self.largest_force, float(np.linalg.norm(spring)))
            data.qfrc_applied[:] = jacobian.T @ force - self._holds(spring, jacobian)
            mujoco.mj_step2(model, data)
        mujoco.mj_kinematics(model, data)
        return self._measure(self.thing.stiffness * (end - data.site_xpos[site]))

    def _holds(self, spring: Floats, jacobian: Floats) -> Floats:
        """Of a closer, per joint; sets dry friction, which grows with the side force, and what is locked or latched."""
        thing, way = self.thing, float(self.data.qpos @ self.arms) if not self.thing.is_locked else 0.0
        self._fix()
        if thing.is_locked:
            return np.zeros(self.model.nv)
        along = (jacobian / self.arms[None]).T
        pulls = along @ spring
        if not self.released and pulls[0] > thing.latch + thing.friction:
            self.released = True
        side = np.sqrt(np.maximum(spring @ spring - pulls**2, 0.0))
        self.model.dof_frictionloss[:] = (thing.friction + thing.jam * side) * self.arms
        closing = thing.closer[0] + thing.closer[1] * way if way > _NEAR else 0.0
        return closing * self.arms

    def _fix(self) -> None:
        """A latched first joint is fixed; a second one until the first is at its end, which it then fixes."""
        thing, active = self.thing, self.data.eq_active
        if not thing.is_locked:
            active[0] = not self.released
            if len(thing.stages) == 2:
                length = thing.stages[0].length
                turned = self.data.qpos[1] * self.arms[1] > _NEAR
                active[1] = turned  # the first stays at its end
                active[2] = not turned and self.data.qpos[0] < length - _NEAR

    def _measure(self, force: Floats) -> Measurement:
        thing, rng = self.thing, self.rng
        seen = self.data.site_xpos[0] + thing.position_noise * rng.standard_normal(3)
        turn = Rotation.from_matrix(self.data.site_xmat[0].reshape(3, 3).copy())
        turned = Rotation.from_rotvec(thing.rotation_noise * rng.standard_normal(3)) * turn
        felt = force + thing.force_noise * rng.standard_normal(3)
        return Measurement(float(self.data.time), seen[None], turned.as_quat()[None], felt[None])


def _world(thing: Thing) -> Any:
    """A chain of bodies with a slide or a hinge each; what bends hangs on three springy slides."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.gravity, spec.option.timestep = (0.0, 0.0, 0.0), _STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    x, y, z, w = Rotation.from_rotvec(thing.frame[:3]).as_quat()
    body = spec.worldbody.add_body(pos=thing.frame[3:], quat=[w, x, y, z])
    slide, hinge, fixed = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtEq.mjEQ_JOINT
    if thing.is_locked:
        panel = body.add_body(mass=_MASS, inertia=[0.1] * 3)
        for axis in np.eye(3):
            panel.add_joint(type=slide, axis=axis, stiffness=thing.flex or 1e6, damping=100.0 if thing.flex else 3000.0)
        panel.add_site()
        return spec
    for number, stage in enumerate(thing.stages):
        turn, direction = np.array(stage.turn), np.array(stage.direction)
        rate = float(np.linalg.norm(turn))
        body = body.add_body(mass=_MASS / len(thing.stages), inertia=[0.02] * 3)
        place = {"pos": np.cross(turn, direction) / rate**2, "axis": turn / rate} if rate else {"axis": direction}
        arm = 1.0 / rate if rate else 1.0
        body.add_joint(
            name=f"stage{number}", type=hinge if rate else slide, **place, damping=_DAMPING * arm**2,
            frictionloss=thing.friction * arm, limited=True, range=[0.0, stage.length / arm], solref_limit=[0.01, 1.0],
        )  # fmt: skip
    body.add_site()
    fixes = [("stage0", 0.0), ("stage0", thing.stages[0].length), ("stage1", 0.0)]
    for name, where in fixes[: 3 if len(thing.stages) == 2 else 1]:
        equality = spec.add_equality(type=fixed, name1=name, active=False, solref=[0.01, 1.0])
        equality.data[:5] = [where, 0.0, 0.0, 0.0, 0.0]
    return spec


def shipped_scene(thing: Thing) -> Scene:
    """A scene that names the object, for the package's own plant; what is locked has a latch of 1 kN."""
    frame, shift = Rotation.from_rotvec(thing.frame[:3]), np.array(thing.frame[3:])
    (stage,) = thing.stages
    direction, turn = frame.apply(stage.direction), frame.apply(stage.turn)
    rate = float(np.linalg.norm(turn))
    pose = shift, frame.as_quat()
    hinge = revolute(turn / rate, shift + np.cross(turn, direction) / rate**2, *pose) if rate else None
    joints = [(hinge or prismatic(direction, *pose), (0.0, stage.length * (rate or 1.0)))]
    latch = 1000.0 if thing.is_locked else thing.latch
    if latch:
        joints.insert(0, (rigid(*pose), (0.0, 0.0)))
    segments = tuple(
        Segment(joint, 0, 10 * i, 10 * i + 9, *reach, reach, 1e-4, 1e-3, 0.0, 1.0)
        for i, (joint, reach) in enumerate(joints)
    )
    graph = KinematicGraph((KinematicEdge(BASE, HANDLE, segments),))
    automaton = build_automaton(graph, parts=(Part(HANDLE, handle=(0.0, 0.0, 0.0)),), release=0.001)
    start = Start((thing.start * (rate or 1.0),), (1e-6,))
    plant = {
        "stiffness": thing.stiffness, "friction": thing.friction, "latch_force": latch or 1.0, "latch_capture": 0.002,
        "position_noise": thing.position_noise, "rotation_noise": thing.rotation_noise, "control_period": 1.0,
    }  # fmt: skip
    return Scene(simulated=Problem(automaton, start, Goal({}), plant=plant))


class Shipped:
    """The package's plant, and what it truly did."""

    def __init__(self, scene: Scene, thing: Thing) -> None:
        self.plant, self.thing, self.largest_force = make_handle_plant(scene, "mujoco"), thing, 0.0
        rate = float(np.linalg.norm(thing.stages[0].turn)) or 1.0
        self.arm = 1.0 / rate

    def reset(self, rng: np.random.Generator) -> Measurement:
        return self.plant.reset(rng)

    def apply(self, command: Command) -> Measurement:
        seen = self.plant.apply(command)
        self.largest_force = max(self.largest_force, float(np.linalg.norm(seen.force)))
        return seen

    def close(self) -> None:
        self.plant.close()

    @property
    def travelled(self) -> float:
        truth = self.plant._plant.truth()
        return abs(float(truth.x[0]) * self.arm - self.thing.start)


def main() -> None:
    parser = argparse.ArgumentParser(description="Exploring objects that MuJoCo simulates.")
    parser.add_argument("--objects", type=int, default=100)
    parser.add_argument("--first-seed", type=int, default=10000)
    parser.add_argument("--plant", choices=("own", "mujoco"), default="own")
    add_json(parser)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    families = FAMILIES if options.plant == "own" else SHIPPED
    rows = []
    for number, seed in zip(range(options.objects), count(options.first_seed)):
        thing = replace(drawn(seed, families[number % len(families)]), from_measured=False)
        scene = Scene() if options.plant == "own" else shipped_scene(thing)
        plant = Physical(scene, thing) if options.plant == "own" else Shipped(scene, thing)
        found = explore(scene, Checked(plant), np.random.default_rng(seed))
        opened, outcome = plant.travelled >= _ENOUGH, "held" if thing.is_locked else "opened"
        right = (found.outcome, found.kinds, opened) == (outcome, thing.kinds, not thing.is_locked)
        rows.append((thing.family, right, plant.largest_force, found.steps, found.outcome, thing.is_locked))
        if not right:
            told = f"{found.outcome} {found.kinds} {plant.travelled:.3f} m: {found.reason}"
            print(f"not right: {seed} {thing.family}: {told}", flush=True)
    print(f"{'family':16}{'objects':>8}{'right':>7}{'median N':>10}{'max N':>8}{'steps':>7}")
    for family in (*families, "all"):
        own = [row for row in rows if family in ("all", row[0])]
        if own:
            _, right, force, steps, _, _ = zip(*own, strict=True)
            print(
                f"{family:16}{len(own):8}{sum(right):7}{np.median(force):10.1f}{max(force):8.1f}{np.median(steps):7.0f}"
            )
    print("locked ones called opened:", sum(row[4] == "opened" and row[5] for row in rows))
    save_json({"rows": rows}, options.json)


if __name__ == "__main__":
    main()
