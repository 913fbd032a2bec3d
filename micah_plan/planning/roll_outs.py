"""Closed-loop roll-outs of a trajectory, all trials at once: true states, noisy measurements, filters and feedback.

The code is independent of the transcription. True states move as in `automaton.transition`, with events within a step;
thresholds and gains are drawn for each roll-out from their uncertainty. Measurements are noisy, the estimate is that of
the hybrid filter, and the inputs follow from it by the plan's feedback.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from micah_plan.arrays import Booleans, Floats, Ints, rows_by_number
from micah_plan.automaton.drawn_thresholds import drawn_shifts, threshold_stds
from micah_plan.automaton.input_memory import InputChannel, towards
from micah_plan.automaton.memo import sharing_motion
from micah_plan.automaton.step_noise import drawn_gains
from micah_plan.automaton.transition import TransitionBatch
from micah_plan.belief.filter import initial_belief, predict_belief, repeated_belief, update
from micah_plan.belief.hybrid_belief import BeliefBatch
from micah_plan.planning import messages
from micah_plan.planning.avoided_inputs import cut_off
from micah_plan.planning.feedback import feedback_input, time_knots
from micah_plan.planning.input_memories import steps_of_memory, with_input_memory, without_input_memory
from micah_plan.planning.limits import limited_input, limits_of
from micah_plan.planning.path_constraints import PathRecord
from micah_plan.task.deadline import NEVER, Deadline
from micah_plan.task.plan import Trajectory
from micah_plan.task.problem import Problem
from micah_plan.task.release import pre_release_problem
from micah_plan.task.start import draw_states

# With more modes than this only those near a shortest sequence of transitions are searched first, as roadmaps of so
# many take a second or two, and only those near a plan are rolled out, so many transitions away.
FEW_MODES, _NEAR = 32, 2
# Of the noise, where there is none: what moves may not be known exactly.
_HARDLY = 1e-6


@dataclass(frozen=True, eq=False)
class Chances:
    """The random numbers of t roll-outs of T steps.

    Attributes:
        objects: t of them, each with its own true thresholds and gains.
        starts: (t, n) true states at first [rad or m].
        process: (T, t, n) noise of the steps [rad or m].
        observation: (T, t, n) noise of the measurements, in standard deviations, which depend on mode and place; NaN
            where a coordinate is not measured.
    """

    objects: TransitionBatch
    starts: Floats
    process: Floats
    observation: Floats


@dataclass(frozen=True, eq=False)
class RollOuts:
    """Final states of t roll-outs.

    Attributes:
        modes: (t,) indices of the true modes.
        states: (t, n) true states [rad or m].
        beliefs: of the filters, after the last measurement.
        path: margins of the problem's constraints on the path.
        visited: (T, t) indices of the true modes after each step of the plan.
    """

    modes: Ints
    states: Floats
    beliefs: BeliefBatch
    path: PathRecord
    visited: Ints


def draw_chances(problem: Problem, trajectory: Trajectory, trials: int, seed: int | tuple[int, ...]) -> Chances:
    """The random numbers of `trials` roll-outs, determined by the seed."""
    problem = without_input_memory(problem)
    automaton, rng = problem.automaton, np.random.default_rng(seed)
    shifts = drawn_shifts(automaton, rng, trials)
    objects = TransitionBatch(automaton, shifts, drawn_gains(automaton, rng, trials))
    mode = automaton.mode(trajectory.modes[0])
    drawn = draw_states(automaton, mode, problem.start, rng, shifts)
    shape = (time_knots(trajectory).size, trials, automaton.n)
    process = np.array(automaton.noise.process_std) * rng.standard_normal(shape)
    is_measured = np.where(np.isfinite(automaton.noise.observation_std), 1.0, np.nan)
    return Chances(objects, drawn, process, is_measured * rng.standard_normal(shape))


def roll_out(problem: Problem, trajectory: Trajectory, chances: Chances, deadline: Deadline = NEVER) -> RollOuts:
    """Execute a trajectory in every roll-out, then wait for delayed commands.

    Raises:
        TimeLimitError: if the deadline passes.
    """
    whole_problem, problem = with_input_memory(problem), without_input_memory(problem)
    automaton, whole, limits = problem.automaton, whole_problem.automaton, limits_of(problem)
    start, trials = whole_problem.start, len(chances.starts)
    channel = InputChannel(
        automaton, {effect_state.effect: start.mean[effect_state.coordinates] for effect_state in whole.input_memories}
    )
    unseen, everyone = np.full((trials, whole.n - automaton.n), np.nan), np.arange(trials)
    modes, x = np.full(trials, automaton.mode_index(trajectory.modes[0])), chances.starts
    beliefs = repeated_belief(whole, initial_belief(whole, start.mean, start.std, trajectory.modes[0]), trials)
    knots, path, visited = time_knots(trajectory), PathRecord(problem, trials), list[Ints]()
    for step, knot in enumerate(knots):
        deadline.check("verification", messages.roll_outs_at(step, len(knots)), "verification_trials")
        believed = beliefs.most_likely
        estimate = beliefs.means[everyone, believed]
        u = feedback_input(trajectory, int(knot), estimate)
        for number, rows in rows_by_number(believed):
            u[rows] = limited_input(whole.modes[number], estimate[rows], u[rows], limits.max_step)
        u = cut_off(whole, beliefs.weights, u, limits.max_step, trajectory.inputs[knot])
        commanded = channel.pass_on(towards(automaton, estimate, x, u), modes, x)
        modes, x = chances.objects.step(modes, x, commanded, chances.process[step])
        visited.append(modes)
        measured = x + measurement_std(problem, modes, x) * chances.observation[step]
        beliefs = update(whole, predict_belief(whole, beliefs, u), np.hstack([measured, unseen]))
        if problem.constraints:
            path.add(modes, x, u, beliefs.factors[everyone, beliefs.most_likely])
    nothing = np.zeros((trials, automaton.m))
    for _ in range(steps_of_memory(whole, limits.max_step)[1]):
        modes, x = chances.objects.step(modes, x, channel.pass_on(nothing, modes, x), np.zeros_like(x))
        beliefs = predict_belief(whole, beliefs, nothing)
        if problem.constraints:
            path.add(modes, x, nothing, beliefs.factors[everyone, beliefs.most_likely])
    return RollOuts(modes, x, beliefs, path, np.array(visited).reshape(len(knots), trials))


def restricted_to_nearby_modes(problem: Problem, trajectory: Trajectory) -> tuple[Problem, frozenset[str]]:
    """The problem restricted to modes near those of a plan, and the names of the outermost; unrestricted if few.

    A belief moves to at most one neighbour per event, so roll-outs reach few of hundreds of modes. A roll-out that
    reaches an outermost mode would continue from there, and must be repeated among all modes.
    """
    automaton, near = problem.automaton, set(trajectory.modes)
    if len(automaton.modes) <= FEW_MODES:
        return problem, frozenset()
    for _ in range(_NEAR):
        inner = frozenset(near)
        near |= {edge.target for name in inner for edge in automaton.edges_from(name)}
    modes = tuple(mode for mode in automaton.modes if mode.name in near)
    edges = tuple(edge for edge in automaton.edges if edge.source in near and edge.target in near)
    part = sharing_motion(replace(automaton, modes=modes, edges=edges), automaton)
    return replace(problem, automaton=part), frozenset(near - inner)


@dataclass(frozen=True)
class Departure:
    """The knot where a noise-free replay leaves the planned modes.

    Attributes:
        knot: of the plan, at the end of the step.
        planned, visited: the modes there.
    """

    knot: int
    planned: str
    visited: str


def departure(problem: Problem, trajectory: Trajectory) -> Departure | None:
    """Where the noise-free plan leaves its own mode sequence; None if it reaches the goal or keeps to the sequence.

    The pilot knows that, so its estimates are the true states.
    """
    problem, _ = restricted_to_nearby_modes(problem, trajectory)
    noise = problem.automaton.noise
    still = replace(noise, process_std=tuple(_HARDLY * std for std in noise.process_std))
    sharp = replace(problem.start, std=tuple(_HARDLY * std for std in problem.start.std))
    problem = replace(problem, automaton=replace(problem.automaton, noise=still), start=sharp)
    plain = without_input_memory(problem)
    automaton, knots = plain.automaton, time_knots(trajectory)
    nothing = np.zeros((knots.size, 1, automaton.n))
    is_measured = np.where(np.isfinite(automaton.noise.observation_std), 0.0, np.nan)
    start = trajectory.means[0, : automaton.n][None]
    objects = TransitionBatch(automaton, np.zeros((1, threshold_stds(automaton).size)))
    ends = roll_out(problem, trajectory, Chances(objects, start, nothing, nothing + is_measured))
    if are_in_goal(problem, ends)[0]:
        return None
    for knot, mode in zip((knots + 1).tolist(), ends.visited[:, 0].tolist(), strict=True):
        if (name := automaton.modes[mode].name) != trajectory.modes[knot]:
            return Departure(knot, trajectory.modes[knot], name)
    return None


def measurement_std(problem: Problem, modes: Ints, x: Floats) -> Floats:
    """(t, n) std of a measurement in the true modes (t,), by index, and states (t, n)."""
    automaton, stds = problem.automaton, np.empty_like(x)
    for index, rows in rows_by_number(modes):
        stds[rows] = automaton.sensing(automaton.modes[index]).std_at(x[rows])
    # An infinite std means not measured: the noise there is NaN already, and infinity times zero would warn.
    return np.asarray(np.where(np.isfinite(stds), stds, 1.0))


def are_in_goal(problem: Problem, ends: RollOuts) -> Booleans:
    """(t,) whether each true end lies in the goal set without a violated path constraint.

    With a release, the plan ends where the hand is at the place to release.
    """
    goal = pre_release_problem(problem).goal
    admitted = goal.admitted(problem.automaton.mode_names)
    return np.asarray(admitted[ends.modes] & goal.holds(ends.states) & ~ends.path.is_broken)
