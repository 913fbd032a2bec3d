"""Executed runs compared with their plan: positions at every step, deviations, outcomes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from micah_plan.arrays import SURE_STDS, Floats
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.kinematics import poses_of_states
from micah_plan.automaton.tracks import Track, tracks
from micah_plan.quantities import count, quantity
from micah_plan.recording.value import Recording
from micah_plan.task.plan import Trajectory
from micah_plan.task.problem import Problem
from micah_plan.view.learned_words import capital
from micah_plan.view.motion import step_times
from micah_plan.view.palette import EXECUTED, EXECUTED_BEFORE

TRUE_COLUMN = "true_{}"


@dataclass(frozen=True, eq=False)
class ExecutedRun:
    """A run in the coordinates of the plan.

    Attributes:
        run: its number in the recording.
        seconds: (T,) since its start, one for each step.
        x: (T, n) configurations, the true ones if the recording has them, else the measured [rad or m].
        modes: (T,) most probable modes as logged; empty if they were not.
        poses: (T,) of each part in the base frame.
        reached: whether it ended in the goal.
        ending: how it ended, in one sentence.
        leaving: where it left the plan, in one sentence; empty if it never did.
        recording: name of its recording, where runs of two are compared; else empty.
        number: among all runs on the page, the key of its curves.
        color: of its ghost and its curves.
    """

    run: int
    seconds: Floats
    x: Floats
    modes: tuple[str, ...]
    poses: Mapping[str, RigidTransform]
    reached: bool
    ending: str
    leaving: str
    recording: str = ""
    number: int = 0
    color: str = EXECUTED

    @property
    def name(self) -> str:
        """Its number, with its recording if there are two."""
        return f"{self.recording}, run {self.run}" if self.recording else f"run {self.run}"

    @property
    def label(self) -> str:
        """Its name and outcome."""
        return f"{self.name}, {'reached the goal' if self.reached else 'missed the goal'}"

    @property
    def words(self) -> tuple[str, ...]:
        """Its outcome, and the place where it left the plan."""
        return tuple(f"{capital(sentence)}." for sentence in (self.ending, self.leaving) if sentence)


def executed_runs(
    problem: Problem, trajectory: Trajectory, recording: Recording, failures: Mapping[int, str] | None = None
) -> tuple[ExecutedRun, ...]:
    """All runs of a recording, in order.

    Args:
        problem: of the plan.
        trajectory: the plan, of the object's coordinates alone.
        recording: with the parts of the problem's model.
        failures: reasons of failed runs from the execution, by run; None: success is judged by the last row.

    Raises:
        InputError: if the recording has other parts than the model.
    """
    tracks_read, values = tracks(problem.automaton, recording), []
    for track, x in zip(tracks_read, run_configurations(problem, recording, tracks_read), strict=True):
        rows = recording.select(run=track.run)
        modes = rows.select(part=rows.parts[0]).extra.get("mode", ())
        is_true = x is not track.x
        ending = _ending(problem, modes, x[-1]) if failures is None else failures.get(track.run, "")
        values.append(
            ExecutedRun(
                run=track.run,
                seconds=track.time - track.time[0],
                x=x,
                modes=modes,
                poses=poses_of_run(problem.automaton, rows, x, modes),
                reached=not ending,
                ending=ending or "reached the goal",
                leaving=_departure_step(problem, trajectory, x, modes, is_true),
            )
        )
    return tuple(values)


def runs_of_recordings(recordings: Mapping[str, Sequence[ExecutedRun]]) -> tuple[ExecutedRun, ...]:
    """Runs of several recordings with their names and colours, as one page shows them."""
    last, is_one = list(recordings)[-1], len(recordings) == 1
    every = [
        replace(run, recording="" if is_one else name, color=EXECUTED if name == last else EXECUTED_BEFORE)
        for name, runs in recordings.items()
        for run in runs
    ]
    return tuple(replace(run, number=k) for k, run in enumerate(every))


def run_configurations(problem: Problem, recording: Recording, tracks_read: tuple[Track, ...] = ()) -> list[Floats]:
    """(T, n) configurations [rad or m] of every run: the true ones if recorded, else the measured.

    Args:
        tracks_read: the tracks of the recording; empty: they are made.
    """
    tracks_read = tracks_read or tracks(problem.automaton, recording)
    names = [TRUE_COLUMN.format(name) for name in problem.automaton.coordinate_names]
    if any(name not in recording.extra for name in names):
        return [track.x for track in tracks_read]
    paths = []
    for track in tracks_read:
        rows = recording.select(run=track.run)
        rows = rows.select(part=rows.parts[0])
        paths.append(np.array([[float(text) if text else np.nan for text in rows.extra[name]] for name in names]).T)
    return paths


def poses_of_run(
    automaton: HybridAutomaton, rows: Recording, x: Floats, modes: tuple[str, ...]
) -> dict[str, RigidTransform]:
    """(T,) poses of each part in one run: as measured, or from configurations where orientation was not measured.

    Args:
        x: (T, n) configurations [rad or m].
        modes: (T,) in which they are; empty: unknown.
    """
    parts = [link.child for link in automaton.links]
    if rows.has_orientation:
        names = parts if len(rows.parts) > 1 or rows.parts[0] in parts else rows.parts
        return {part: rows.select(part=name).poses() for part, name in zip(parts, names, strict=True)}
    mode_names = [mode if mode in automaton.mode_names else automaton.mode_names[0] for mode in modes or ("",) * len(x)]
    single = [
        poses_of_states(automaton, automaton.mode(mode), state[None]) for mode, state in zip(mode_names, x, strict=True)
    ]
    return {part: RigidTransform.concatenate([poses[part] for poses in single]) for part in parts}


def _ending(problem: Problem, modes: tuple[str, ...], x: Floats) -> str:
    """Violations of the goal in the last row; empty if it is reached. Modes that were not logged are ignored."""
    automaton, goal, misses = problem.automaton, problem.goal, list[str]()
    for (i, _, room), away, missed in zip(goal.target, goal.distances(x), goal.misses(x), strict=True):
        if missed:
            name, unit = automaton.coordinates[i].name, automaton.coordinates[i].unit
            misses.append(
                f"{name} ends {quantity(float(away), unit)} from its target (tolerance {quantity(room, unit)})"
            )
    if modes and not goal.admits(modes[-1]):
        misses.append(f"it ends in {modes[-1]}, not {' or '.join(goal.modes)}")
    return "; ".join(misses)


def _spread(problem: Problem, trajectory: Trajectory) -> Floats:
    """(K, n) predicted std of the state around the plan's mean before measurements [rad or m].

    The belief's covariance P is around its estimate. The estimate deviates from the plan by measurement updates, S, and
    feedback brings it back: S⁺ = (1 + B K) S (1 + B K)' + (P + Q - P⁺), from S = 0. The sum P + S is the spread of
    roll-outs.
    """
    automaton, n = problem.automaton, problem.automaton.n
    process = np.diag(np.square(automaton.noise.process_std))
    covariances = trajectory.factors @ trajectory.factors.transpose(0, 2, 1)
    strayed, covariances_on = np.zeros((n, n)), [covariances[0]]
    for k, is_transition in enumerate(trajectory.is_transition):
        if not is_transition:
            back = np.eye(n) + automaton.mode(trajectory.modes[k]).B @ trajectory.gains[k]
            values, vectors = np.linalg.eigh(covariances[k] + process - covariances[k + 1])
            strayed = back @ strayed @ back.T + vectors @ np.diag(np.maximum(values, 0.0)) @ vectors.T
        covariances_on.append(covariances[k + 1] + strayed)
    return np.asarray(np.sqrt(np.diagonal(np.array(covariances_on), axis1=1, axis2=2)))


def _departure_step(problem: Problem, trajectory: Trajectory, x: Floats, modes: tuple[str, ...], is_true: bool) -> str:
    """The first step after which a run stays off the plan's belief for two steps, or in another mode."""
    steps, coordinates = step_times(trajectory), problem.automaton.coordinates
    knots = np.searchsorted(steps, np.arange(steps[-1] + 1), side="right") - 1  # after the transitions of that step
    rows = min(len(knots), len(x))
    noise = 0.0 if is_true else np.array(problem.automaton.noise.observation_std)
    std = np.hypot(_spread(problem, trajectory)[knots[:rows]], noise)
    away = x[:rows] - trajectory.means[knots[:rows]]
    far = np.abs(away) > SURE_STDS * np.maximum(std, 1e-9)
    stays = far & np.vstack([far[1:], far[-1:]])
    remaining = np.flatnonzero(stays.any(axis=1))
    if not len(remaining):
        more = len(x) - 1 - int(steps[-1])
        return f"it took {count(more, 'step')} more than the plan" if more > 0 else ""
    step = int(remaining[0])
    i = int(np.argmax(np.where(stays[step], np.abs(away[step]) / np.maximum(std[step], 1e-9), 0.0)))
    size, unit = quantity(abs(float(away[step, i])), coordinates[i].unit), coordinates[i].unit
    planned = trajectory.modes[knots[step]]
    believed = f"; believed {modes[step]}, planned {planned}" if modes and modes[step] != planned else ""
    beside = quantity(float(std[step, i]), unit, digits=2)
    return f"it left the plan at step {step}: {coordinates[i].name} {size} from the mean, σ {beside}{believed}"
