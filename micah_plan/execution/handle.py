"""Plants with a handle for explorations: the built-in ones, and the check of their answers.

The part that is measured is the handle itself: its place is where the hand holds it, its orientation turns with the
part that it is fixed to. A command displaces the equilibrium of the hand, a spring, from where the handle is; the force
is the one that the hand exerts at the handle when all rests again, base frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import TracebackType
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.arrays import Floats
from micah_plan.automaton.kinematics import jacobian
from micah_plan.automaton.transition import step
from micah_plan.errors import InputError
from micah_plan.execution.checked_plant import CheckedPlant, check_methods, checked_measurement, plant_of
from micah_plan.execution.mujoco.parameters import parameters_of
from micah_plan.execution.plant import Command, Measurement, Plant, PlantError
from micah_plan.execution.pose import chain, components, moving_joints
from micah_plan.execution.tracker import PoseTracker, TrackerNoise
from micah_plan.task.exploration_scene import Scene
from micah_plan.task.problem import Problem
from micah_plan.task.start import sample_start

HANDLE = "handle"
_SOFTEST, _STIFFEST = 600.0, 2500.0
_SMALL = 0.00025  # m, way of the handle per step of the physics


def make_handle_plant(scene: Scene, kind: str | Callable[[Any], Plant]) -> Plant:
    """A plant for a scene.

    Args:
        kind: ``"nominal"`` or ``"mujoco"``, with the object of the scene's `simulated`; or a function that is called
            with the scene.

    Raises:
        InputError: if the scene names no object, it cannot be made, or the result is not a plant.
        MissingDependencyError: if it needs a library that is not installed.
    """
    if not isinstance(kind, str):
        return plant_of(kind, scene, "scene")
    if scene.simulated is None:
        problem = f"the plant '{kind}' needs an object to put into the hand, and the scene names none"
        raise InputError(problem, remedy="add the key 'simulated' with a problem file, or give --plant FILE.py:CLASS")
    if kind == "nominal":
        return NominalHandle(scene.simulated)
    if kind == "mujoco":
        from micah_plan.execution.mujoco.standing import StandingPlant

        simulated = scene.simulated
        standing = StandingPlant(simulated.automaton, simulated.start, parameters_of(simulated))
        return PhysicalHandle(simulated, standing)
    raise InputError(f"unknown plant '{kind}'", remedy="choose nominal or mujoco")


class HandlePlant:
    """A plant with checked answers that may lack a pose: a tracker may lose the handle or be late.

    As a context manager it closes the plant at its end in any case.
    """

    def __init__(self, plant: Plant) -> None:
        check_methods(plant, type(plant).__name__)
        self._plant = CheckedPlant(plant, [HANDLE])

    def reset(self, rng: np.random.Generator) -> Measurement:
        """The first measurement with a pose."""
        return self._plant.reset(rng)

    def apply(self, command: Command) -> Measurement:
        """The measurement after a command; NaN where the handle was not seen or the force not measured.

        Raises:
            PlantError: if the machine failed, or its line is dead.
            InputError: for an answer that is no measurement, or without a force.
        """
        try:
            return checked_handle_measurement(self._plant.ask("apply", command))
        except InputError as error:
            if isinstance(error.__cause__, OSError | EOFError):  # the line to the machine, not its code
                raise PlantError(error.problem) from error
            raise

    def __enter__(self) -> HandlePlant:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self._plant.__exit__(kind, error, _)


def checked_handle_measurement(answer: object) -> Measurement:
    """A validated answer; poses or forces with a NaN become NaN throughout.

    Raises:
        InputError: if it has any other fault.
    """
    if not isinstance(answer, Measurement):
        return checked_measurement(answer, [HANDLE])
    if answer.force is None:
        remedy = "put into Measurement.force what the hand exerts at the handle [N], base frame"
        raise InputError("an exploration needs measured forces. Got None", remedy=remedy)
    blind, numb = _missing(answer.position) or _missing(answer.quaternion), _missing(answer.force)
    whole = answer
    if blind:
        whole = replace(whole, position=np.zeros((1, 3)), quaternion=np.array([[0.0, 0.0, 0.0, 1.0]]))
    if numb:
        whole = replace(whole, force=np.zeros((1, 3)))
    whole = checked_measurement(whole, [HANDLE])
    if blind:
        whole = replace(whole, position=np.full((1, 3), np.nan), quaternion=np.full((1, 4), np.nan))
    return replace(whole, force=np.full((1, 3), np.nan)) if numb else whole


def _missing(value: object) -> bool:
    if value is None:
        return True
    try:
        return bool(np.isnan(np.asarray(value, dtype=float)).any())
    except (TypeError, ValueError):
        return False  # no numbers: the check reports it


class NominalHandle:
    """The object of a problem moved by a spring: quasi-static, with dry friction, latches and a noisy tracker.

    The hand's stiffness is drawn at every reset, from 600 to 2,500 N/m.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem, self._parameters = problem, parameters_of(problem)
        self._handle = np.array(problem.automaton.part(problem.automaton.links[0].child).handle or (0.0, 0.0, 0.0))

    def reset(self, rng: np.random.Generator) -> Measurement:
        """A start drawn from the problem's belief."""
        automaton, parameters = self._problem.automaton, self._parameters
        self._mode, self._x = sample_start(automaton, self._problem.start, rng)
        self._stiffness = float(np.exp(rng.uniform(np.log(_SOFTEST), np.log(_STIFFEST))))
        noise = TrackerNoise(parameters.position_noise, parameters.rotation_noise)
        self._tracker, self._time, self._force = PoseTracker(noise, 1, rng), 0.0, np.zeros(3)
        return self._measure()

    def apply(self, command: Command) -> Measurement:
        """Move along the joint in small steps while the spring's pull exceeds friction and latch."""
        automaton, parameters = self._problem.automaton, self._parameters
        target = self._place()[0] + np.asarray(command.handle)[0]
        coordinate = automaton.links[0].coordinate
        for _ in range(4000):
            place, along = self._place()
            rate = float(np.linalg.norm(along))
            pull = self._stiffness * float((target - place) @ along) / rate
            caught = not automaton.mode(self._mode).free[coordinate]
            if abs(pull) <= (parameters.latch_force if caught else 0.0) + parameters.friction:
                break
            given = np.zeros(automaton.m)
            given[coordinate] = np.sign(pull) * _SMALL / rate
            after = step(automaton, self._mode, self._x, given)
            if after.mode == self._mode and abs(after.x[coordinate] - self._x[coordinate]) < 1e-9:
                break
            self._mode, self._x = after.mode, np.asarray(after.x)
        self._force = self._stiffness * (target - self._place()[0])
        self._time += parameters.control_period
        return self._measure()

    def close(self) -> None:
        """No resources to release."""

    def _place(self) -> tuple[Floats, Floats]:
        """(3,) position of the handle [m], and its derivative by the coordinate."""
        automaton = self._problem.automaton
        joints = moving_joints(automaton, self._mode)
        pose = chain(automaton, joints, self._x)[0]
        lever = pose[:3, :3] @ self._handle
        rate = jacobian(joints[0], self._x[automaton.links[0].coordinate])[0]
        return pose[:3, 3] + lever, rate[3:] + np.cross(rate[:3], lever)

    def _measure(self) -> Measurement:
        automaton = self._problem.automaton
        pose = chain(automaton, moving_joints(automaton, self._mode), self._x)
        _, quaternion = components(pose)
        measurement = self._tracker.measure(self._place()[0][None], quaternion, self._parameters.control_period)
        return Measurement(self._time, *measurement, self._force[None])


class PhysicalHandle:
    """Adapter of a plant that measures a part's origin to one that measures its handle."""

    def __init__(self, problem: Problem, plant: Plant) -> None:
        self._plant = plant
        self._handle = np.array(problem.automaton.part(problem.automaton.links[0].child).handle or (0.0, 0.0, 0.0))

    def reset(self, rng: np.random.Generator) -> Measurement:
        return self._shown(self._plant.reset(rng))

    def apply(self, command: Command) -> Measurement:
        return self._shown(self._plant.apply(command))

    def close(self) -> None:
        self._plant.close()

    def _shown(self, measurement: Measurement) -> Measurement:
        lever = Rotation.from_quat(measurement.quaternion).apply(self._handle[None])
        return replace(measurement, position=measurement.position + lever)
