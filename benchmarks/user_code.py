"""What a user would write instead of a planner: two short programmes, run on the same true objects as its plans.

`open loop` is a deterministic plan (CasADi and IPOPT) over x⁺ = x + B u from the start's mean to the goal, carried out
as it is. `filter` is a Kalman filter, and every step pushes its estimate towards the goal, as far as a step reaches.
Where the goal is latched, both aim two steps past the latch, as a person does who shuts a door.

B is that of the mode whose inputs move most. None of them plans through modes that move differently.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from micah_plan.arrays import Floats, Ints
from micah_plan.automaton.drawn_thresholds import drawn_shifts
from micah_plan.automaton.transition import TransitionBatch
from micah_plan.planning.limits import limits_of
from micah_plan.planning.roll_outs import Chances, measurement_std
from micah_plan.task.problem import Problem

# Steps that a filter may take more than the straight way needs.
SPARE_STEPS = 20
# How far past a latch is pushed, in steps.
PAST = 2.0
# Share of the largest step that an open-loop plan uses, as those of the planner do.
PACE = 0.6


@dataclass(frozen=True, eq=False)
class Reader:
    """What a user reads out of a problem file."""

    problem: Problem

    @cached_property
    def max_step(self) -> Floats:
        """(m,) largest input."""
        return limits_of(self.problem).max_step

    @cached_property
    def moving(self) -> int:
        """Index of the mode whose inputs move most."""
        return int(np.argmax([np.count_nonzero(mode.B) for mode in self.problem.automaton.modes]))

    @cached_property
    def B(self) -> Floats:  # noqa: N802 - as in the docs
        """(n, m) its input matrix."""
        return self.problem.automaton.modes[self.moving].B

    @cached_property
    def start(self) -> Floats:
        """(n,) the start's mean."""
        return np.array(self.problem.start.mean)

    @cached_property
    def aim(self) -> Floats:
        """(n,) where to go: the goal, past its latch if it has one."""
        goal = self.problem.goal
        aim = goal.reached_from(self.start)
        modes = [mode for mode in self.problem.automaton.modes if goal.modes and goal.admits(mode.name)]
        for pin in (pin for mode in modes for pin in mode.pins):
            i = pin.coordinate
            way = np.sign(pin.value - self.start[i])
            aim[i] = pin.value + way * PAST * float(np.abs(self.B[i]) @ self.max_step)
        return aim

    @cached_property
    def steps(self) -> int:
        """Steps of the straight way."""
        u = np.linalg.pinv(self.B) @ (self.aim - self.start)
        return max(1, math.ceil(float(np.max(np.abs(u) / self.max_step)) / PACE))

    def can_move(self) -> bool:
        """Whether inputs move every coordinate of the goal, so that there is something to write."""
        if self.problem.hold is not None or not self.problem.goal.target:
            return False
        return bool(self.B[list(self.problem.goal.indices)].any(axis=1).all())


def open_loop(reader: Reader, chances: Chances) -> tuple[Ints, Floats]:
    """Modes (t,) and states (t, n) in which the inputs of a deterministic plan end."""
    import casadi as ca

    count, (n, m) = reader.steps, reader.B.shape
    opti = ca.Opti()
    x, u = opti.variable(n, count + 1), opti.variable(m, count)
    opti.subject_to(x[:, 0] == reader.start)
    opti.subject_to(x[:, 1:] == x[:, :-1] + ca.DM(reader.B) @ u)
    limit = ca.repmat(ca.DM(reader.max_step), 1, count)
    opti.subject_to(opti.bounded(-limit, u, limit))
    moved = np.flatnonzero(reader.B.any(axis=1)).tolist()
    opti.subject_to(x[moved, count] == reader.aim[moved])
    opti.minimize(ca.sumsqr(u / limit))
    opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes"})
    inputs = np.array(opti.solve().value(u)).reshape(m, count).T
    modes, x_true = begun(reader, chances)
    for step, one in enumerate(inputs):
        modes, x_true = chances.objects.step(modes, x_true, np.tile(one, (len(x_true), 1)), chances.process[step])
    return modes, x_true


def begun(reader: Reader, chances: Chances) -> tuple[Ints, Floats]:
    """Modes (t,) and states (t, n) at the start."""
    automaton = reader.problem.automaton
    mode = automaton.mode_index(reader.problem.start.mode or automaton.modes[0].name)
    return np.full(len(chances.starts), mode), chances.starts.copy()


def filtered(reader: Reader, chances: Chances) -> tuple[Ints, Floats]:
    """The same of a Kalman filter and clipped pushes towards the aim."""
    automaton, trials = reader.problem.automaton, len(chances.starts)
    sensing = automaton.sensing(automaton.modes[reader.moving])
    process = np.square(automaton.noise.process_std)
    back = np.linalg.pinv(reader.B)
    modes, x = begun(reader, chances)
    estimate = np.tile(reader.start, (trials, 1))
    variance = np.tile(np.square(np.array(reader.problem.start.std, dtype=float)), (trials, 1))
    for step in range(reader.steps + SPARE_STEPS):
        u = np.clip((reader.aim - estimate) @ back.T, -reader.max_step, reader.max_step)
        modes, x = chances.objects.step(modes, x, u, chances.process[step])
        estimate, variance = estimate + u @ reader.B.T, variance + process
        z = x + measurement_std(reader.problem, modes, x) * chances.observation[step]
        noise = np.square(sensing.std_at(estimate))
        seen = np.isfinite(z) & np.isfinite(noise)
        gain = np.where(seen, variance / (variance + np.where(seen, noise, 1.0)), 0.0)
        estimate = estimate + gain * np.where(seen, z - estimate, 0.0)
        variance = (1.0 - gain) * variance
    return modes, x


def chances_for(reader: Reader, trials: int, seed: int) -> Chances:
    """Everything random of that many true objects, for as many steps as these programmes may take."""
    from micah_plan.automaton.step_noise import drawn_gains
    from micah_plan.task.start import draw_states

    problem, rng = reader.problem, np.random.default_rng(seed)
    automaton = problem.automaton
    shifts = drawn_shifts(automaton, rng, trials)
    objects = TransitionBatch(automaton, shifts, drawn_gains(automaton, rng, trials))
    mode = automaton.mode(problem.start.mode or automaton.modes[0].name)
    starts = draw_states(automaton, mode, problem.start, rng, shifts)
    shape = (reader.steps + SPARE_STEPS, trials, automaton.n)
    process = np.array(automaton.noise.process_std) * rng.standard_normal(shape)
    seen = np.where(np.isfinite(automaton.noise.observation_std), 1.0, np.nan)
    return Chances(objects, starts, process, seen * rng.standard_normal(shape))


def share_in_goal(problem: Problem, modes: Ints, x: Floats) -> float:
    """Share of true ends in the goal set."""
    admitted = problem.goal.admitted(problem.automaton.mode_names)
    return float((admitted[modes] & problem.goal.holds(x)).mean())
