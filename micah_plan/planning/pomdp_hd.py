"""POMDP-HD: mode sequences from a search, a belief trajectory through each, the cheapest with feedback around it.

Source: Jain and Niekum, "Efficient hierarchical robot motion planning under uncertainty and hybrid dynamics", CoRL
2018.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from time import perf_counter

import numpy as np

from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.planning.feedback import belief_lqr
from micah_plan.planning.limits import Limits, limits_of
from micah_plan.planning.mode_search import ModeSequence, search_modes
from micah_plan.planning.plan import Candidate, Plan, Trajectory
from micah_plan.planning.problem import Problem, Start
from micah_plan.planning.start_state import start_mode
from micah_plan.planning.transcription import transcribe
from micah_plan.planning.transcription_guess import guess
from micah_plan.planning.transcription_solve import BeliefPath, solve, unmet
from micah_plan.symbolic.compiled import CompiledAutomaton, compile_automaton

Progress = Callable[[str, float], None]

# How much longer than its length asks for a path may take, tried in turn: slow inputs, more measurements at a guard.
_STRETCHES = (1.0, 2.0, 4.0)
# Inputs below this share of the largest step are the solver's rounding; on a guard like u < 0 they would matter.
_INPUT_ROUNDING = 1e-6


def plan(problem: Problem, seed: int = 0, progress: Progress | None = None) -> Plan:
    """Plan from the start belief to the goal. Deterministic but for the wall-clock limit of the optimisation.

    Args:
        problem: what to solve.
        seed: of the search.
        progress: called with one line of text and the fraction done whenever a stage begins.

    Returns:
        A plan with outcome ``"solved"`` (to be confirmed by `verification.verify`) or ``"no_plan"`` with the reason.
    """
    mode, reason = start_mode(problem.automaton, problem.start)
    if mode is None:
        return Plan("no_plan", reason, seed=seed, timings=_Clock().timings())
    return _plan_from(problem, mode, seed, progress or (lambda _text, _fraction: None))


def replan(problem: Problem, belief: HybridBelief, seed: int = 0) -> Trajectory | None:
    """A new trajectory from the most likely mode of a belief, its stds taken as independent; None if there is none."""
    index = belief.most_likely
    mode = problem.automaton.modes[index].name
    stds = np.linalg.norm(belief.factors[index], axis=1)
    start = Start(tuple(map(float, belief.means[index])), tuple(map(float, stds)), mode)
    return _plan_from(replace(problem, start=start), mode, seed, lambda _text, _fraction: None).trajectory


def _plan_from(problem: Problem, mode: str, seed: int, say: Progress) -> Plan:
    """Plan from the start's mean in a mode that is known."""
    clock = _Clock()
    problem = replace(problem, start=replace(problem.start, mode=mode))
    limits = limits_of(problem)
    say("searching mode sequences", 0.0)
    with clock.stage("search"):
        found = search_modes(problem, limits, mode, seed)
    if not found.sequences:
        return Plan("no_plan", found.reason, seed=seed, timings=clock.timings())
    with clock.stage("build"):
        compiled = compile_automaton(problem.automaton)
    candidates: list[Candidate] = []
    best: BeliefPath | None = None
    for number, sequence in enumerate(found.sequences, start=1):
        say(f"optimising {' -> '.join(sequence.modes)}", number / (len(found.sequences) + 1))
        path, message = _optimise(problem, limits, compiled, sequence, clock)
        usable = path is not None and path.feasible
        cost = path.cost if path is not None and usable else None
        candidates.append(Candidate(sequence.modes, sequence.cost, cost, message))
        if path is not None and usable and (best is None or path.cost < best.cost):
            best = path
    if best is None:
        first = candidates[0]
        reason = f"no mode sequence could be optimised; {' -> '.join(first.modes)}: {first.message}"
        return Plan("no_plan", reason, candidates=tuple(candidates), seed=seed, timings=clock.timings())
    return _solved(problem, limits, best, tuple(candidates), seed, clock)


def _optimise(
    problem: Problem, limits: Limits, compiled: CompiledAutomaton, sequence: ModeSequence, clock: _Clock
) -> tuple[BeliefPath | None, str]:
    """The belief path through a mode sequence and what the optimisation said."""
    knots = 0
    for stretch in _STRETCHES:
        with clock.stage("build"):
            start = guess(problem, limits, compiled, sequence, stretch)
            if start.reason:
                return None, start.reason
            longer = sum(phase.steps for phase in start.phases)
            if longer == knots:
                break
            knots = longer
            nlp = transcribe(problem, limits, compiled, start.phases)
        with clock.stage("optimise"):
            path = solve(nlp, problem)
        if path.feasible:
            return path, path.message
    with clock.stage("optimise"):
        return path, "; ".join([path.message, *unmet(nlp, problem)])


def _solved(
    problem: Problem, limits: Limits, path: BeliefPath, candidates: tuple[Candidate, ...], seed: int, clock: _Clock
) -> Plan:
    gains = belief_lqr(problem, limits, path.modes, path.is_transition)
    inputs = np.where(np.abs(path.inputs) < _INPUT_ROUNDING * limits.max_step, 0.0, path.inputs)
    trajectory = Trajectory(path.modes, path.means, path.factors, inputs, gains, path.is_transition)
    errors = [abs(float(path.means[-1, i]) - value) for i, value, _ in problem.goal.target]
    stds = [float(np.linalg.norm(path.factors[-1, i])) for i, _, _ in problem.goal.target]
    answer = Plan(
        "solved",
        "",
        trajectory=trajectory,
        candidates=candidates,
        cost=path.cost,
        goal_error=max(errors, default=0.0),
        goal_std=max(stds, default=0.0),
        seed=seed,
        timings=clock.timings(),
    )
    tried = f"cheapest of {len(candidates)} mode sequences" if len(candidates) > 1 else "the only mode sequence"
    return replace(answer, reason=f"{' -> '.join(answer.mode_sequence)}, {tried}: {path.message}")


class _Clock:
    """Seconds by stage."""

    def __init__(self) -> None:
        self._began = perf_counter()
        self._seconds = {"search": 0.0, "build": 0.0, "optimise": 0.0}

    def stage(self, name: str) -> _Stage:
        return _Stage(self._seconds, name)

    def timings(self) -> dict[str, float]:
        return {**self._seconds, "total": perf_counter() - self._began}


class _Stage:
    """A context that adds its duration to a stage."""

    def __init__(self, seconds: dict[str, float], name: str) -> None:
        self._seconds, self._name = seconds, name

    def __enter__(self) -> None:
        self._began = perf_counter()

    def __exit__(self, *_: object) -> None:
        self._seconds[self._name] += perf_counter() - self._began
