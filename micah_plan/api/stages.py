"""The stages joined: recording -> model -> plan -> execution -> prediction. The only file that knows both ends.

Every function takes values or paths and returns values; writing files is the caller's choice, except where a path is
asked for. Stages are imported when they are used, so that reading a recording does not load a planner.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from micah_plan import __version__
from micah_plan.automaton.graph import BASE
from micah_plan.errors import InputError
from micah_plan.learn.settings import FEWEST_ROWS, LearnSettings
from micah_plan.quantities import Progress, quantity
from micah_plan.task.plan import Plan
from micah_plan.task.plants import DEFAULT_PLANT
from micah_plan.task.settings import Deadline

if TYPE_CHECKING:
    from micah_plan.automaton.graph import KinematicEdge, KinematicGraph
    from micah_plan.automaton.hybrid import HybridAutomaton, Part
    from micah_plan.execution.plant import Plant, PlantMaker
    from micah_plan.execution.trials import Keep, TrialStatistics
    from micah_plan.explore.run import Exploration
    from micah_plan.recording.conventions import Conventions
    from micah_plan.recording.value import Recording
    from micah_plan.task.experiment import Scene
    from micah_plan.task.problem import Problem

Method = Literal["act-champ", "champ"]


@dataclass(frozen=True, eq=False)
class Learned:
    """What `learn` returns: the segments as measured, the automaton made of them, and how long it took.

    Attributes:
        automaton: None if some rows follow no single joint; `graph` says which.
        seconds: wall-clock time.
        reason: why there is no automaton and what to do; empty if there is one.
        warnings: what looks like a mistake in the recording (units, order of columns), or too little, one line each.
        base: what poses are relative to: the part that was taken for the base, else "base".
    """

    recording: Recording
    graph: KinematicGraph
    automaton: HybridAutomaton | None
    seconds: float
    reason: str = ""
    warnings: tuple[str, ...] = ()
    base: str = BASE

    def heading(self, edge: KinematicEdge) -> str:
        """Which part moves relative to which."""
        return f"{edge.child} relative to {self.base if edge.parent == BASE else edge.parent}"


def read(path: str | Path, *, minimum_rows: int = 1, conventions: Conventions | None = None) -> Recording:
    """A recording from a file of any format, by the conventions that are given or lie beside it.

    Raises:
        InputError: if it cannot be used; the message names file, row and remedy.
    """
    from micah_plan.exchange.load import load_recording

    return load_recording(Path(path), minimum_rows=minimum_rows, conventions=conventions)


def read_problem(path: str | Path, overrides: Mapping[str, Any] | None = None) -> tuple[Problem, tuple[str, ...]]:
    """A problem from its file, and what to know of it, one line each; of the file of a model that which
    `micah-plan new problem` writes for it.

    Args:
        path: of the problem or model.
        overrides: values to take instead of the file's, by dotted key.

    Raises:
        InputError: if it cannot be used.
    """
    from micah_plan.documents.kind import kind_of
    from micah_plan.documents.problem import load_problem

    overrides = overrides or {}
    if kind_of(path) != "model":
        from micah_plan.checking import suspicions_of

        problem = load_problem(path, overrides)
        return problem, suspicions_of(problem)
    from micah_plan.documents.model import load_model
    from micah_plan.templates.first_problem import problem_for

    if overrides:
        raise InputError("a model is solved as it is", source=path, remedy="give a problem, or leave out the model")
    problem = problem_for(load_model(path), str(path))
    return problem, (_of_model(problem),)


def _of_model(problem: Problem) -> str:
    """What is asked where only a model is given."""
    aims = []
    for i, value, _ in problem.goal.target:
        coordinate = problem.automaton.coordinates[i]
        begin, end = (quantity(float(number), coordinate.unit) for number in (problem.start.mean[i], value))
        aims.append(f"{coordinate.name} from {begin} to {end}")
    asked = f"no problem is given, so the model is moved most of its way: {', '.join(aims)}"
    return f"{asked}; `micah-plan new problem FOLDER --model MODEL` writes a problem to edit"


def is_long_enough(recording: Recording) -> bool:
    """Whether every run has the rows of each of its parts that `learn` needs."""
    rows = Counter(zip(recording.run.tolist(), recording.part, strict=True))
    return min(rows.values(), default=0) >= FEWEST_ROWS


def learn(
    recording: Recording,
    *,
    method: Method = "act-champ",
    seed: int = 0,
    parts: Sequence[Part] = (),
    settings: LearnSettings | None = None,
    base: str | None = None,
    progress: Progress | None = None,
) -> Learned:
    """Segment a recording, fit its joints and build the hybrid automaton, or say why there is none.

    Args:
        recording: at least `learn.settings.FEWEST_ROWS` rows per run of one or several parts.
        method: Act-CHAMP uses the actions, CHAMP only the poses.
        seed: of MLESAC and of the resampling.
        parts: shapes and handles of the object's bodies, for drawing and physics.
        settings: of the learner; None: the defaults, which are meant for every recording.
        base: a tracked part on which the object stands, as a door on a cart that is pushed: the model is in its frame,
            and the rows that are returned are those of the other parts.
        progress: called with a message and the fraction done.

    Raises:
        InputError: if the recording cannot be learned from.
    """
    from micah_plan.automaton.build import build_automaton, no_single_joint_error
    from micah_plan.learn.learn import learn_graph, small_motions
    from micah_plan.learn.parts.relative import relative_to
    from micah_plan.recording.suspicion import suspicions

    begin = time.perf_counter()
    if base is not None:
        recording = relative_to(recording, base)
    graph = learn_graph(recording, method=method, settings=settings, seed=seed, progress=progress)
    provenance = {"recording": recording.digest(), "method": method, "seed": str(seed), "micah_plan": __version__}
    if base is not None:
        provenance["frame"] = f"part {base}"
    if recording.conventions:
        provenance["conventions"] = "; ".join(f"{name} {text}" for name, text in recording.conventions.items())
    bodies, refusal = _matched_parts(graph, parts), no_single_joint_error(graph)
    warnings = recording.notes + suspicions(recording) + small_motions(recording, settings or LearnSettings())
    automaton = None if refusal is not None else build_automaton(graph, parts=bodies, provenance=provenance)
    reason = "" if refusal is None else str(refusal)
    return Learned(recording, graph, automaton, time.perf_counter() - begin, reason, warnings, base or BASE)


def _matched_parts(graph: KinematicGraph, parts: Sequence[Part]) -> tuple[Part, ...]:
    names = {name for edge in graph.edges for name in (edge.parent, edge.child)}
    for part in parts:
        if part.name not in names:
            raise InputError(
                f"the shapes are of a part '{part.name}', the recording has {', '.join(sorted(names))}",
                remedy="rename the part in the shapes file",
            )
    return tuple(parts)


def solve(
    problem: Problem,
    *,
    seed: int = 0,
    progress: Progress | None = None,
    advise: bool = True,
    planner: Callable[..., Plan] | None = None,
) -> Plan:
    """Plan by POMDP-HD and check the plan by rolling out the true hybrid system from sampled states.

    Where the roll-outs fail too often, it plans again with more room (`planning.tightening`).

    Args:
        planner: another one, whose plans are checked alike and as they are: called with the problem, and with `seed`,
            `progress` and `deadline` by name (see `planning.attempt`).
        advise: if it fails, try what its remedies propose, so that they name numbers that help (`planning.remedies`):
            up to eight more solutions. False: remedies without numbers.

    Returns:
        A plan whose outcome says whether it solves the problem; it is never silently worse than it claims.
    """
    from micah_plan.automaton.graph import low_probability_warnings
    from micah_plan.automaton.input_memory import left_out
    from micah_plan.automaton.plausible import never_taken
    from micah_plan.planning.cuts import unchecked
    from micah_plan.planning.tightening import verified_plan
    from micah_plan.planning.with_arm import planned_with_arm

    planner_of_problem, rounds = (
        _pomdp_hd() if planner is None else planner,
        problem.settings.tightening_rounds * (planner is None),
    )
    planned_by = partial(planner_of_problem, seed=seed, progress=progress)
    if problem.robot is not None:
        import micah_plan.robot.along_plan  # noqa: F401
    # Only now: what it takes to load libraries says nothing about the problem.
    deadline = Deadline(problem.settings.solve_time_limit_s)

    def planned(asked: Problem) -> Plan:
        return verified_plan(asked, planned_by, seed, rounds, deadline)

    with_arm = planned_with_arm(problem, planned, seed, deadline)
    warnings = (*low_probability_warnings(problem.automaton.learned), *left_out(problem.automaton, planner is not None))
    warnings += (*never_taken(problem.automaton), *unchecked(problem))
    answer = replace(with_arm, warnings=warnings)
    if not advise or answer.outcome == "solved":
        return answer
    from micah_plan.planning.remedies import advised

    return advised(problem, answer, partial(solve, advise=False, planner=planner), seed)


def _pomdp_hd() -> Callable[..., Plan]:
    """The planner, loaded only now: it brings heavy libraries along."""
    from micah_plan.planning.pomdp_hd import plan

    return plan


def execute(
    problem: Problem,
    plan: Plan,
    *,
    plant: str | PlantMaker | Plant = DEFAULT_PLANT,
    trials: int = 1,
    seed: int = 0,
    replan_every: int | None = None,
    progress: Progress | None = None,
    keep: Keep | None = None,
) -> TrialStatistics:
    """Execute a plan in closed loop, with the belief filter, feedback and replanning, over seeded trials.

    Args:
        plant, keep: as of `execution.trials.run_trials`: a name, a class that is called with the problem, or a plant.
        replan_every: steps after which the rest of the plan is optimised again from the belief, 0: never; None: as the
            problem's settings say.

    Raises:
        InputError: if the plan is not a solution, or the plant's code cannot be used.
        MissingDependencyError: if the plant needs a library that is not installed.
        PlantError: if the machine cannot be reset.
    """
    from micah_plan.execution.trials import run_trials
    from micah_plan.planning.replanning import RecedingHorizon, replan

    if replan_every is not None:
        problem = replace(problem, settings=replace(problem.settings, replan_every=replan_every))
    run = partial(run_trials, replan=replan, continuation=RecedingHorizon)
    return run(problem, plan, plant=plant, trials=trials, seed=seed, progress=progress, keep=keep)


def for_demonstrations(automaton: HybridAutomaton, recording: Recording) -> HybridAutomaton:
    """The model for a recording whose actions were given like those of the demonstration that it was learned from.

    Raises:
        InputError: if learning found nothing about the actions.
    """
    from micah_plan.automaton.effects.add import with_learned_channel

    steps = [np.diff(recording.select(run=run, part=recording.parts[0]).time) for run in recording.runs]
    return with_learned_channel(automaton, float(np.median(np.concatenate(steps))))


def explore(
    scene: Scene,
    *,
    plant: str | Callable[[Any], Plant] = DEFAULT_PLANT,
    seed: int = 0,
    progress: Progress | None = None,
) -> Exploration:
    """Open what a hand holds without a model of it, and learn one.

    Args:
        plant: ``"nominal"`` or ``"mujoco"``, with the object that the scene names; or what makes a plant of the scene.
        seed: of the plant's start and noise; decisions draw nothing.
        progress: called with a message and the fraction done.

    Raises:
        InputError: if there is no such plant, its code fails, or an answer is no usable measurement.
        PlantError: if the machine cannot be made or reset.
    """
    from micah_plan.execution.handle import HandlePlant, make_handle_plant
    from micah_plan.explore.run import explore as run

    with HandlePlant(make_handle_plant(scene, plant)) as machine:
        return run(scene, machine, np.random.default_rng(seed), progress)
