"""Closed-loop execution: measure, filter, decide, command and log, until the goal is believed reached or steps end.

`Episode` decides and logs; it calls neither a plant nor the filter. `execute_episode` connects it with both. Episodes
are independent, so many can share one batched step of the filter.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from micah_plan.arrays import Floats
from micah_plan.automaton.contacts.values import COLLIDED
from micah_plan.automaton.hybrid import HybridAutomaton, Mode
from micah_plan.belief.filter import explains, initial_belief, predict_each, update_each
from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.execution import messages
from micah_plan.execution.checked_plant import CheckedPlant
from micah_plan.execution.log import RunLog
from micah_plan.execution.pilot import MOST_REPLANS, Pilot, Replanning
from micah_plan.execution.plant import Command, Measurement, Plant, PlantError, Truth
from micah_plan.execution.pose import chain, command, configuration, moving_joints, reading
from micah_plan.execution.release import ReleaseController
from micah_plan.execution.watch import Watch
from micah_plan.message import Message
from micah_plan.planning.input_memories import after_memories_run_out, with_input_memory
from micah_plan.planning.path_constraints import PathRecord
from micah_plan.recording.value import Recording
from micah_plan.task.goal import Goal
from micah_plan.task.plan import ArmTrajectory, ReleasePlan, Trajectory
from micah_plan.task.problem import Problem
from micah_plan.task.release import pre_release_problem

_SPARE_STEPS = 20


@dataclass(frozen=True, eq=False)
class TrialResult:
    """One execution with its outcome.

    Attributes:
        recording: the log; `learn` and `predict` accept it.
        success: whether the state at the end is in the goal set, and no state before violated a constraint on the path:
            by the true states, or where these are unknown by the believed ones, at the end with the problem's
            confidence. False where the machine failed.
        believed: whether success and final values are from the belief, since the plant has no referee.
        reason: one sentence.
        final_error: largest distance of a constrained coordinate from its target at the end [rad or m].
        final_mode, final_x: the state at the end, in the model's terms; (n,) [rad or m].
        confidence: the belief's probability of the goal at the end.
        steps: control steps that were carried out and measured.
        replans: new plans followed.
        continuations: how often the rest of the plan was optimised again.
        refusals: why new plans were not followed.
        beliefs: after each measurement, steps + 1 of them.
        released: whether the object was released and stands in the goal on its own, where the problem requires it; then
            this is the success, and the final values are of the object at rest. None: it stays in the hand. Log, steps
            and beliefs end where the hand begins to put it down, since the model of an object in a hand ends there.
    """

    recording: Recording
    success: bool
    believed: bool
    reason: str
    final_error: float
    final_mode: str
    final_x: Floats
    confidence: float
    steps: int
    replans: int
    continuations: int
    refusals: tuple[str, ...]
    beliefs: tuple[HybridBelief, ...]
    released: bool | None = None


class Episode:
    """The decisions of one execution, independent of its plant and of the filter.

    A step of an execution is, for a belief b over the states of `automaton` that starts as `prior`:

        measurement = plant.reset(rng), later plant.apply(command)
        b = filter.update(automaton, b, episode.observed(b, measurement))
        command = episode.decide(b, measurement, truth)           # None: the execution has ended
        b = filter.predict(automaton, b, command.input)

    Every step the updated belief is evaluated. The execution stops when the plan is done and the belief is in the goal
    set with the problem's confidence: stopping earlier would end at its edge. A new plan is requested where a belief
    leaves it, misses a transition or ends short of the goal; if none is found, it stops. Where the problem releases the
    object, the hand then puts it down and withdraws, see `release`.
    """

    def __init__(
        self,
        problem: Problem,
        trajectory: Trajectory,
        *,
        arm: ArmTrajectory | None = None,
        replanning: Replanning | None = None,
        max_steps: int | None = None,
        run: int = 0,
        release: ReleasePlan | None = None,
    ) -> None:
        """Initial state of an episode.

        Args:
            problem: automaton, start belief, goal, confidence and input limits; of one with a release, the goal is of
                the object at rest.
            trajectory: the plan.
            arm: joints of the arm along the trajectory; None: there is no arm.
            replanning: source of new plans; None: none are requested.
            max_steps: control steps at most; None: twice the plan's plus 20.
            run: the run's number in the log.
            release: how the object is released in the end; None: it stays in the hand.
        """
        self._rest_goal, self._putting_down = problem.goal, False
        asked = problem.release
        self._release_controller = (
            None if asked is None or release is None else ReleaseController(problem, asked, release)
        )
        problem = pre_release_problem(problem)
        augmented = with_input_memory(problem)
        self.automaton: HybridAutomaton = augmented.automaton
        """Over whose states, memories of inputs among them, the belief is."""
        self._problem, self._run = problem, run
        self._start, self._start_mode = augmented.start, trajectory.modes[0]
        spare = 2 * int((~trajectory.is_transition).sum()) + _SPARE_STEPS
        self._longest = spare if max_steps is None else max_steps
        self._pilot = Pilot(augmented, trajectory, arm, replanning)
        self._log = RunLog(problem.automaton)
        self._beliefs: list[HybridBelief] = []
        self._confidence, self._is_lost = 0.0, False
        self._watch = Watch(self.automaton)
        self._truth: Truth | None = None
        self._path = PathRecord(problem, 1)
        self._commanded: Floats | None = None

    @property
    def prior(self) -> HybridBelief:
        """The belief before the first measurement."""
        return initial_belief(self.automaton, self._start.mean, self._start.std, self._start_mode)

    @property
    def recording(self) -> Recording | None:
        """The log so far; None before the first decision."""
        return self._log.recording(self._run) if len(self._log) else None

    def reading(self, belief: HybridBelief, measurement: Measurement) -> Floats:
        """(n,) the configuration in a measurement [rad or m]; NaN where it shows none.

        Args:
            belief: before it, to choose whole turns and the joints of the most likely mode.
        """
        if self._is_away:
            return np.full(self.automaton.n, np.nan)  # the parts are no longer where the hand is
        return reading(self._problem.automaton, belief, measurement)

    def observed(self, belief: HybridBelief, measurement: Measurement) -> Floats:
        """The `reading` of a measurement given the belief before it; the watch records the difference."""
        z = self.reading(belief, measurement)
        self._watch.record_innovation(belief, z)
        plain, mode = self._problem.automaton, belief.most_likely
        x = np.where(np.isfinite(z), z, belief.means[mode, : len(z)])[: plain.n]
        places = chain(plain, moving_joints(plain, plain.modes[mode].name), x)[:, :3, 3]
        shown = ~measurement.unseen if measurement.unseen is not None else np.ones(len(places), dtype=bool)
        off = np.linalg.norm(places - measurement.position, axis=1)[shown]
        if off.size and not self._is_away:
            self._watch.record_pose_error(belief, float(off.max()))
        return z

    def decide(self, belief: HybridBelief, measurement: Measurement, truth: Truth | None = None) -> Command | None:
        """The next command, or None if the execution has ended.

        Args:
            belief: after the measurement.
            truth: only for the log and the score; None in every step if it is unknown.
        """
        self._truth = truth
        if self._release_controller is not None and self._putting_down:
            return self._release_controller.command(belief, measurement)
        self._beliefs.append(belief)
        self._is_lost = not explains(self.automaton, belief, self.reading(belief, measurement))
        self._confidence = 0.0 if self._is_lost else lasting_probability(self.automaton, self._problem.goal, belief)
        plain, likely = self._problem.automaton, belief.most_likely
        mode, x = self._state(belief)
        if self._commanded is not None:
            arrived = plain.mode_index(mode) if mode in plain.mode_names else likely
            self._path.add(np.array([arrived]), x[None], self._commanded[None], belief.factors[[likely]])
        true_x = None if truth is None else x
        unseen, ends = measurement.unseen, self._is_done(belief)
        holds = self._watch.looks_again(belief, is_lost=self._is_lost, unseen=unseen, ends=ends)
        if self._is_over or (ends and not holds):
            self._log.add(measurement, belief, true_x, None)
            self._putting_down = self._release_controller is not None and self._is_confident
            return (
                self._release_controller.command(belief, measurement)
                if self._release_controller and self._putting_down
                else None
            )
        u = np.zeros(plain.m) if holds else self._pilot.input(belief, measurement.joints)
        self._commanded = u
        order = command(plain, plain.modes[likely].name, belief.means[likely, : plain.n], u)
        self._log.add(measurement, belief, true_x, order.origin)
        return replace(order, posture=self._pilot.posture)

    def result(self, failure: str = "") -> TrialResult:
        """The outcome of the execution.

        Args:
            failure: of the machine after the last command; empty without one.
        """
        pilot, truth, released = self._pilot, self._truth, self._is_released()
        goal = self._rest_goal if self._is_open else self._problem.goal
        mode, x = self._state(self._beliefs[-1])
        # A mode that the model does not have is a collision.
        in_goal = goal.contains(mode, x) and mode in self._problem.automaton.mode_names
        reached = (self._is_confident if truth is None else in_goal) and not self._path.is_broken.any()
        reached = reached and released is not False
        reason = self._ending()
        if failure:
            reason = messages.machine_failed(len(self._beliefs), failure)
        elif not reached:
            incident = [truth.incident] if truth is not None and truth.incident else []
            missed = self._misses(goal, mode, x)
            if self._putting_down and not self._is_open:  # the height of the hand is then meaningless
                missed = [messages.not_felt()]
            elif released is False:
                missed = missed or [messages.does_not_stand()]
            reason = messages.with_misses(reason, [*incident, *missed])
        return TrialResult(
            recording=self._log.recording(self._run),
            success=reached and not failure,
            believed=truth is None,
            reason=reason,
            final_error=goal.error(x),
            final_mode=mode,
            final_x=x,
            confidence=self._confidence,
            steps=len(self._beliefs) - 1,
            replans=pilot.replans,
            continuations=pilot.continuations,
            refusals=tuple(pilot.refusals),
            beliefs=tuple(self._beliefs),
            released=None if released is None else released and not failure,
        )

    @property
    def _is_away(self) -> bool:
        """Whether the hand has left the object, so that poses no longer follow the hand."""
        return self._release_controller is not None and self._release_controller.phase == "withdrawing"

    @property
    def _is_open(self) -> bool:
        """Whether the gripper was opened."""
        return self._release_controller is not None and self._release_controller.felt

    def _is_released(self) -> bool | None:
        """Whether the released object stands in the goal, as far as is known; None without a release."""
        if self._release_controller is None:
            return None
        if self._truth is None:  # it is put down from where it comes to rest in the goal
            return self._release_controller.felt and self._is_confident
        mode, x = self._state(self._beliefs[-1])
        return self._is_open and self._truth.stands and not self._truth.incident and self._rest_goal.contains(mode, x)

    def _state(self, belief: HybridBelief) -> tuple[str, Floats]:
        """(mode, x (n,)) of the model: true values where known, else believed ones."""
        plain, likely = self._problem.automaton, belief.most_likely
        if self._truth is not None:
            return true_state(plain, self._truth)
        return plain.modes[likely].name, belief.means[likely, : plain.n]

    @property
    def _is_confident(self) -> bool:
        return self._confidence >= self._problem.settings.confidence and not self._watch.failure

    @property
    def _is_over(self) -> bool:
        """Whether the plan or the parts are lost, or the steps are used up."""
        return len(self._beliefs) > self._longest or self._pilot.is_lost or bool(self._watch.failure)

    def _is_done(self, belief: HybridBelief) -> bool:
        """Whether the goal is believed reached at the end of the plan."""
        return self._is_confident and (len(self._beliefs) == 1 or self._pilot.is_finished(belief))

    def _ending(self) -> Message:
        """The reason for the end of the execution."""
        pilot, steps = self._pilot, len(self._beliefs) - 1
        lost = self._is_lost or any(belief.was_reinitialised for belief in self._beliefs)
        advice = messages.POSES_CONTRADICT if lost else messages.STEPS_CONTRADICT if self._watch.is_biased else ""
        if self._watch.failure:
            return messages.stopped_by_watch(steps, self._watch.failure, advice)
        if self._is_confident:
            return messages.stopped_confident(self._confidence)
        if pilot.refusals:
            advice += messages.refused_plans(pilot.refusals)
        if pilot.is_lost:
            mode = self._problem.automaton.modes[self._beliefs[-1].most_likely].name
            return messages.off_plan(steps, mode, MOST_REPLANS, advice)
        return messages.steps_used_up(steps, self._confidence, advice)

    def _misses(self, goal: Goal, mode: str, x: Floats) -> list[str]:
        """Violations of a goal set and of constraints by the true or believed state."""
        automaton = self._problem.automaton
        is_true, misses = self._truth is not None, list[str]()
        for (i, _, tolerance), away, missed in zip(goal.target, goal.distances(x), goal.misses(x), strict=True):
            name, unit = automaton.coordinates[i].name, automaton.coordinates[i].unit
            if missed:
                misses.append(messages.misses_target(name, float(away), tolerance, unit, is_true))
        if not goal.admits(mode):
            misses.append(messages.in_other_mode(mode, goal.modes, is_true))
        return [*misses, *self._path.sentences()]


def execute_episode(episode: Episode, plant: Plant | CheckedPlant, rng: np.random.Generator) -> TrialResult:
    """Execute an episode on a plant after a reset.

    If the plant is also a `Referee`, the result is scored by the truth; otherwise by the belief, and marked so.

    Args:
        rng: feeds the plant's start and noise.

    Raises:
        PlantError: if the machine cannot be reset. One that fails later ends the episode as a failure.
        InputError: if the plant's code raised another error, or its answer is not a usable measurement. The log until
            then is `episode.recording`.
    """
    return execute_batch([episode], [plant], [rng])[0]


def execute_batch(
    episodes: Sequence[Episode],
    plants: Sequence[Plant | CheckedPlant],
    rngs: Sequence[np.random.Generator],
    ended: Callable[[TrialResult], None] | None = None,
) -> list[TrialResult]:
    """Execute episodes of one model in lockstep, each on its own plant; equivalent to `execute_episode` for each.

    Filtering all of them at once takes little more time than one. Several only in simulations: a machine does not wait
    for others.

    Args:
        ended: called with each result when its episode ends.
    """
    automaton = episodes[0].automaton
    parts = [link.child for link in automaton.links]
    machines = [plant if isinstance(plant, CheckedPlant) else CheckedPlant(plant, parts) for plant in plants]
    results: dict[int, TrialResult] = {}
    beliefs = {number: episode.prior for number, episode in enumerate(episodes)}
    measurements = {
        number: machine.reset(rng) for number, (machine, rng) in enumerate(zip(machines, rngs, strict=True))
    }
    while beliefs:
        orders: dict[int, Command] = {}
        readings = {i: episodes[i].observed(belief, measurements[i]) for i, belief in beliefs.items()}
        by_missing: dict[bytes, list[int]] = {}  # numbers of the readings that show the same coordinates
        for i, z in readings.items():
            by_missing.setdefault(np.isnan(z).tobytes(), []).append(i)
        for rows in by_missing.values():
            z = np.array([readings[i] for i in rows])
            updated = update_each(automaton, [beliefs[i] for i in rows], z)
            beliefs.update(zip(rows, updated, strict=True))
        for i, belief in list(beliefs.items()):
            order, failed = episodes[i].decide(belief, measurements[i], machines[i].truth()), ""
            if order is not None:
                try:
                    measurements[i] = machines[i].apply(order)
                    orders[i] = order
                    continue
                except PlantError as failure:
                    failed = str(failure)
            results[i] = episodes[i].result(failed)
            if ended is not None:
                ended(results[i])
        inputs = np.array([order.input for order in orders.values()])
        after = predict_each(automaton, [beliefs[i] for i in orders], inputs) if orders else []
        beliefs = dict(zip(orders, after, strict=True))
    return [results[number] for number in range(len(episodes))]


def goal_probability(automaton: HybridAutomaton, goal: Goal, belief: HybridBelief) -> float:
    """A lower bound of the probability that the state is in the goal set.

    Within a mode, coordinates may be correlated; Bonferroni's bound 1 - Σ P(outside) holds for any correlation.
    """
    coordinates, values, tolerances = np.array(goal.target, dtype=float).reshape(-1, 3).T
    index = coordinates.astype(int)
    std = np.sqrt(np.maximum(np.square(belief.factors[:, index]).sum(axis=2), 1e-24))
    away = belief.means[:, index] - values
    outside = 1.0 - (ndtr((tolerances - away) / std) - ndtr((-tolerances - away) / std))
    admitted = np.array([goal.admits(name) for name in automaton.mode_names])
    return float(belief.weights @ (admitted * np.maximum(0.0, 1.0 - outside.sum(axis=1))))


def lasting_probability(automaton: HybridAutomaton, goal: Goal, belief: HybridBelief) -> float:
    """The smaller of the goal probabilities now and after all delayed commands."""
    now = goal_probability(automaton, goal, belief)
    if not automaton.input_memories:
        return now
    ends = [
        after_memories_run_out(automaton, mode.name, mean)
        for mode, mean in zip(automaton.modes, belief.means, strict=True)
    ]
    return min(now, goal_probability(automaton, goal, replace(belief, means=np.array(ends))))


def true_state(automaton: HybridAutomaton, truth: Truth) -> tuple[str, Floats]:
    """The truth in the terms of the executing side's model: its mode and x (n,).

    A plant may be another model or physics. Then x follows from the true poses by the model's inverse kinematics, and
    the mode is the one that pins the latched joints, with the largest margin inside its invariant among those. A
    collision remains one, though the model may have no mode for it.
    """
    if truth.mode in automaton.mode_names:
        return str(truth.mode), truth.x
    still = np.zeros(automaton.m)
    x = configuration(automaton, automaton.modes[0].name, truth.position, truth.quaternion, truth.x)
    x = np.where(np.isnan(x), truth.x, x)
    if truth.mode == COLLIDED:
        return COLLIDED, x

    def fit(mode: Mode) -> tuple[int, float, float]:
        distance = sum(abs(pin.value - float(x[pin.coordinate])) for pin in mode.pins)
        margin = float(mode.invariant.margins(x, still).min(initial=0.0))
        return -int((mode.free == truth.latched).sum()), -distance, margin

    return max(automaton.modes, key=fit).name, x
