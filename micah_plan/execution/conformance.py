"""Conformance of plants; run `check_plant` on yours before executing plans on it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.arrays import SURE_STDS, Floats
from micah_plan.automaton.kinematics import placements
from micah_plan.automaton.tracks import read_by_sensors
from micah_plan.automaton.transition import step
from micah_plan.errors import InputError, together
from micah_plan.execution import messages
from micah_plan.execution.checked_plant import CheckedPlant, check_methods
from micah_plan.execution.nominal import pose_noise
from micah_plan.execution.plant import Measurement, Plant, Truth
from micah_plan.execution.pose import command, configuration, moving_joints, relative
from micah_plan.planning.input_memories import with_input_memory
from micah_plan.planning.limits import limits_of
from micah_plan.task.problem import Problem
from micah_plan.task.start import start_mode

# Errors granted beyond that: of a tracker [m], [rad], and of a start in its coordinates [rad or m].
_PLACE, _TURN, _START = 0.05, 0.3, 0.05
# A motion may differ by this share of the command: friction and compliance.
_SHARE = 0.5
# A motion of this many standard deviations differs from none; it is made in at most this many steps.
_CLEAR_STDS, _MOST_STEPS = 10.0, 8
_FIRST_SECONDS = 60.0


def check_plant(plant: Plant, problem: Problem, seed: int = 0) -> tuple[str, ...]:
    """Refuse a plant that violates an assumption of executions.

    It is reset twice, moved along every input by the fewest steps that exceed the noise, if the start's mode allows
    them, and commanded to stand still. On a real machine, stand by. Checked: methods, types, shapes, unit quaternions,
    time; that poses fit the model's joints and the problem's start; that commands move the parts as intended; that
    nothing moves by itself; and for a simulation (a `Referee`) that measurements match its truth, and that the same
    seed gives the same start.

    Args:
        plant: stays open.
        problem: for which it was made.
        seed: of the start and noise of a simulation.

    Returns:
        What could not be tested, one sentence each.

    Raises:
        InputError: with the fault; its `each()` gives all of them.
        PlantError: if the machine failed.
    """
    check_methods(plant, type(plant).__name__)
    trial = _Trial(plant, problem, seed)
    faults = list(trial.faults())
    if faults:
        raise together([InputError(f"{type(plant).__name__}: {sentence}") for sentence in faults])
    return tuple(trial.untried)


class _Trial:
    """A plant under test, with the model's prediction of its state."""

    def __init__(self, plant: Plant, problem: Problem, seed: int) -> None:
        augmented = with_input_memory(problem)
        self._problem, self._seed = problem, seed
        self._plain, self._augmented = problem.automaton, augmented.automaton
        self._limits = limits_of(augmented)
        self._parts = [link.child for link in self._plain.links]
        self._plant = CheckedPlant(plant, self._parts)
        mode, reason = start_mode(self._plain, problem.start)
        if mode is None:
            raise InputError(str(reason))
        self._mode = mode
        self._x: Floats = np.array(augmented.start.mean, dtype=float)
        """State with the memory of inputs: measured where it can be, else as the model predicts."""
        self.untried: list[str] = []
        self._steps, self._hidden = 0, np.zeros(len(self._parts), dtype=int)
        """Commands, and after how many of them each part was not seen."""

    def faults(self) -> Iterator[str]:
        """One sentence per fault."""
        first = self._plant.reset(np.random.default_rng(self._seed))
        if abs(first.time) > _FIRST_SECONDS:
            yield messages.clock_not_from_reset(first.time)
        misplaced = list(self._pose_faults(first))
        yield from misplaced
        if misplaced:
            return  # motions would be uninformative
        yield from self._start_faults(first)
        truth = self._plant.truth()
        if truth is not None:
            yield from self._truth_faults(first, truth)
        self._x[: self._plain.n] = self._measured(first)
        for j in range(self._plain.m):
            yield from self._direction_faults(j)
        yield from self._drift_faults()
        for part, hidden in zip(self._parts, self._hidden, strict=True):
            if hidden:
                self.untried.append(messages.part_unseen(part, int(hidden), self._steps))
        again = self._plant.reset(np.random.default_rng(self._seed))
        if truth is not None and not np.array_equal(first.position, again.position):
            yield messages.resets_differ()

    def _pose_faults(self, measurement: Measurement) -> Iterator[str]:
        """Faults: parts at poses that no configuration of their joints allows."""
        joints, x = moving_joints(self._plain, self._mode), self._measured(measurement)
        allowed = [placements(j, x[link.coordinate])[0] for j, link in zip(joints, self._plain.links, strict=True)]
        rolled = replace(measurement, quaternion=np.roll(measurement.quaternion, -1, axis=1))
        scalar_last = self._pose_deviations(rolled, allowed, self._x)
        for (part, away, angle), (*_, rolled_angle) in zip(
            self._pose_deviations(measurement, allowed, self._x), scalar_last, strict=True
        ):
            if away:
                yield messages.part_off_joint(part, away)
            if angle:
                yield messages.part_turned(part, angle, not rolled_angle)

    def _pose_deviations(
        self, measurement: Measurement, expected: Sequence[Floats], x: Floats
    ) -> Iterator[tuple[str, float, float]]:
        """(part, distance [m], angle [rad]) of each part off an expected relative pose (4, 4); 0 within noise at x."""
        noise = pose_noise(self._plain, self._noise(x))
        measured = relative(self._plain, measurement.position, measurement.quaternion)
        for row, part in enumerate(self._parts):
            place, turn = (SURE_STDS * float(np.ravel(std)[row]) for std in (noise.position, noise.rotation))
            between = np.linalg.solve(expected[row], measured[row])
            away = float(np.linalg.norm(between[:3, 3]))
            angle = float(Rotation.from_matrix(between[:3, :3]).magnitude())
            lever = float(np.linalg.norm(expected[row][:3, 3]))
            is_away, is_turned = away > place + _PLACE + turn * lever, angle > turn + _TURN
            yield part, away if is_away else 0.0, angle if is_turned else 0.0

    def _start_faults(self, measurement: Measurement) -> Iterator[str]:
        start, noise, x = self._problem.start, self._noise(self._x), self._measured(measurement)
        for i, coordinate in enumerate(self._plain.coordinates):
            if abs(x[i] - start.mean[i]) > SURE_STDS * float(np.hypot(start.std[i], noise[i])) + _START:
                believed = start.mean[i], start.std[i]
                yield messages.starts_elsewhere(coordinate.name, float(x[i]), believed, coordinate.unit)

    def _truth_faults(self, measurement: Measurement, truth: Truth) -> Iterator[str]:
        """Faults of a referee whose truth contradicts the tracker."""
        rows, n = len(self._parts), self._plain.n
        shapes = {"position": (rows, 3), "quaternion": (rows, 4), "x": (n,), "latched": (n,)}
        shapes_given = {name: np.shape(getattr(truth, name)) for name in shapes}
        for name, shape in shapes.items():
            if shapes_given[name] != shape:
                yield messages.truth_of_wrong_shape(name, shape, shapes_given[name])
        if shapes_given == shapes:
            for part, away, _ in self._pose_deviations(
                measurement, relative(self._plain, truth.position, truth.quaternion), truth.x
            ):
                if away:
                    yield messages.truth_elsewhere(part, away)

    def _direction_faults(self, j: int) -> Iterator[str]:
        """Faults along one input, in the direction that keeps the mode: motion other than commanded."""
        name = self._plain.inputs[j].name
        for sign in (1.0, -1.0):
            u = np.zeros(self._plain.m)
            u[j] = sign * self._limits.max_step[j]
            steps = self._visible_steps(u)
            if not steps:
                continue
            before = self._x[: self._plain.n].copy()
            asked, moved, std = self._commanded(u, steps) - before, self._x[: self._plain.n] - before, self._std(steps)
            for i in np.flatnonzero(np.abs(asked) >= _CLEAR_STDS * std):
                if abs(moved[i] - asked[i]) > _SHARE * abs(asked[i]) + SURE_STDS * std[i]:
                    coordinate = self._plain.coordinates[i]
                    commanded, unit = float(asked[i]), coordinate.unit
                    yield messages.moves_otherwise(coordinate.name, commanded, float(moved[i]), unit)
            return
        self.untried.append(messages.input_untried(name, self._mode))

    def _visible_steps(self, u: Floats) -> int:
        """The fewest steps of an input that exceed the noise within the mode; 0 if there are none."""
        x = self._x
        for steps in range(1, _MOST_STEPS + 1):
            after = step(self._augmented, self._mode, x, u)
            if after.mode != self._mode:
                return 0
            x = after.x
            if (np.abs(x - self._x)[: self._plain.n] >= _CLEAR_STDS * self._std(steps)).any():
                return steps
        return 0

    def _drift_faults(self) -> Iterator[str]:
        n, expected = self._plain.n, self._commanded(np.zeros(self._plain.m), 1)
        room = SURE_STDS * self._std(1) + _SHARE * self._limits.speed[:n]
        for i in np.flatnonzero(np.abs(self._x[:n] - expected) > room):
            coordinate = self._plain.coordinates[i]
            yield messages.moves_without_command(coordinate.name, float(self._x[i] - expected[i]), coordinate.unit)

    def _commanded(self, u: Floats, steps: int) -> Floats:
        """Repeat a command and measure; returns the expected configuration (n,)."""
        n, expected = self._plain.n, self._x.copy()
        for _ in range(steps):
            order = command(self._plain, self._mode, self._x[:n], u)
            self._x = np.array(step(self._augmented, self._mode, self._x, u).x)
            expected = step(self._augmented, self._mode, expected, u).x
            measurement = self._plant.apply(order)
            self._x[:n], self._steps = self._measured(measurement), self._steps + 1
            self._hidden += 0 if measurement.unseen is None else measurement.unseen
        return np.asarray(expected[:n])

    def _measured(self, measurement: Measurement) -> Floats:
        """(n,) the measured configuration; the predicted one where nothing was measured."""
        n = self._plain.n
        z = configuration(
            self._plain, self._mode, measurement.position, measurement.quaternion, self._x[:n], measurement.unseen
        )
        z = read_by_sensors(self._plain, z[None], np.array([measurement.time]))[0]
        return np.where(np.isfinite(z), z, self._x[:n])

    def _noise(self, x: Floats) -> Floats:
        """(n,) std of a measured coordinate at a state; huge where none is measured."""
        return np.nan_to_num(self._plain.sensing(self._plain.mode(self._mode)).std_at(x[: self._plain.n]), posinf=1e9)

    def _std(self, steps: int) -> Floats:
        """(n,) std of a displacement measured over some steps."""
        process = np.array(self._plain.noise.process_std)
        return np.asarray(np.sqrt(2.0 * self._noise(self._x) ** 2 + steps * process**2))
