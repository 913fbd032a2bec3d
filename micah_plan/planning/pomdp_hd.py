"""POMDP-HD: mode sequences from a search, a belief trajectory through each, the cheapest with feedback around it.

Source: Jain and Niekum, "Efficient hierarchical robot motion planning under uncertainty and hybrid dynamics", CoRL
2018.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.planning.feedback import belief_lqr
from micah_plan.planning.findings import endpoint_findings, finding_of_reason, finding_of_status, findings_of
from micah_plan.planning.input_memory import with_input_memory, without_input_memory
from micah_plan.planning.limits import Limits, limits_of
from micah_plan.planning.replanning import believed_problem, with_memory
from micah_plan.planning.search.mode_search import ModeSequence, SearchResult, search_modes
from micah_plan.planning.tightening import verified_plan
from micah_plan.planning.transcription.guess import guess
from micah_plan.planning.transcription.programme import transcribe
from micah_plan.planning.transcription.solve import BeliefPath, solve, unmet
from micah_plan.planning.verification import verify
from micah_plan.symbolic.compiled import CompiledAutomaton, compile_automaton
from micah_plan.task.clock import Clock
from micah_plan.task.deadline import Deadline, TimeLimitError
from micah_plan.task.plan import Candidate, Finding, Plan, Trajectory
from micah_plan.task.problem import Problem
from micah_plan.task.start import start_mode

Progress = Callable[[str, float], None]

# How much longer than its length asks for a path may take, tried in turn: slow inputs, more measurements at a guard.
_STRETCHES = (1.0, 2.0, 4.0)
# Inputs below this share of the largest step are the solver's rounding; on a guard like u < 0 they would matter.
_INPUT_ROUNDING = 1e-6


def plan(problem: Problem, seed: int = 0, progress: Progress | None = None, deadline: Deadline | None = None) -> Plan:
    """Plan from the start belief to the goal. Deterministic but for the wall-clock limits.

    Args:
        problem: what to solve.
        seed: of the search.
        progress: called with one line of text and the fraction done whenever a stage begins.
        deadline: when to end; None: as the settings say, from now on.

    Returns:
        A plan with outcome ``"solved"`` (to be confirmed by `verification.verify`) or ``"no_plan"`` with the reason.
    """
    mode, reason = start_mode(problem.automaton, problem.start)
    if mode is None:
        return Plan("no_plan", reason, seed=seed, timings=Clock().timings(), findings=endpoint_findings(problem))
    return _plan_from(with_input_memory(problem), mode, seed, progress or _silent, deadline or _deadline_of(problem))


def replan(problem: Problem, belief: HybridBelief, seed: int = 0) -> Trajectory | None:
    """A new trajectory from the most likely mode of a belief (`replanning.believed_problem`).

    None if there is none, or none that roll-outs confirm: as many of them as it takes to tell (`verify`, sequential).
    """
    here = believed_problem(with_input_memory(problem), belief)
    mode = problem.automaton.modes[belief.most_likely].name

    def planner(task: Problem, *, deadline: Deadline) -> Plan:
        return _plan_from(task, mode, seed, _silent, deadline)

    found = verified_plan(here, planner, seed, verifier=partial(verify, sequential=True))
    return found.trajectory if found.outcome == "solved" else None


def _silent(_text: str, _fraction: float) -> None:
    """Nobody is told."""


def _deadline_of(problem: Problem) -> Deadline:
    return Deadline(problem.settings.solve_time_limit_s)


def _plan_from(problem: Problem, mode: str, seed: int, say: Progress, deadline: Deadline) -> Plan:
    """Plan from the start's mean in a mode that is known."""
    clock = Clock()
    problem = replace(problem, start=replace(problem.start, mode=mode))
    limits = limits_of(problem)
    say("searching mode sequences", 0.0)
    plain = without_input_memory(problem)
    try:
        with clock.stage("search"):
            found = search_modes(plain, limits_of(plain), mode, seed, deadline=deadline)
            sequences = [with_memory(problem, sequence) for sequence in found.sequences]
    except TimeLimitError as over:
        found = SearchResult((), over.reason)
    if not found.sequences:
        findings = endpoint_findings(problem) or (finding_of_reason("search", found.reason),)
        return Plan("no_plan", found.reason, seed=seed, timings=clock.timings(), findings=findings)
    with clock.stage("build"):
        compiled = compile_automaton(problem.automaton)
    candidates: list[Candidate] = []
    missed: list[Finding] = []
    best: tuple[BeliefPath, ModeSequence] | None = None
    for number, sequence in enumerate(sequences, start=1):
        say(f"optimising {' -> '.join(sequence.modes)}", number / (len(sequences) + 1))
        try:
            path, message, in_the_way = _optimise(problem, limits, compiled, sequence, clock, deadline)
        except TimeLimitError as over:
            in_the_way = [finding_of_reason("optimisation", over.reason, sequence.modes)]
            path, message = None, over.reason
        usable = path is not None and path.feasible
        cost = path.cost if path is not None and usable else None
        candidates.append(Candidate(sequence.modes, sequence.total, cost, message))
        missed += in_the_way
        if path is not None and usable and (best is None or path.cost < best[0].cost):
            best = path, sequence
    if best is None:
        first = candidates[0]
        reason = f"no mode sequence could be optimised; {' -> '.join(first.modes)}: {first.message}"
        answer = Plan("no_plan", reason, candidates=tuple(candidates), seed=seed, findings=tuple(missed))
        return replace(answer, timings=clock.timings())
    path, sequence = best
    kept = findings_of(problem, sequence.modes, path.in_part)
    return replace(_solved(problem, limits, path, tuple(candidates), seed, clock), findings=tuple(kept))


def _optimise(
    problem: Problem,
    limits: Limits,
    compiled: CompiledAutomaton,
    sequence: ModeSequence,
    clock: Clock,
    deadline: Deadline,
) -> tuple[BeliefPath | None, str, list[Finding]]:
    """The belief path through a mode sequence, what the optimisation said, and what stands in the way of it."""
    name, knots = " -> ".join(sequence.modes), -1
    for stretch in _STRETCHES:
        deadline.check("optimisation", f"{name} was not tried {'' if knots < 0 else 'with more knots '}", "candidates")
        with clock.stage("build"):
            start = guess(problem, limits, compiled, sequence, stretch)
            if start.reason:
                return None, start.reason, [finding_of_reason("optimisation", start.reason, sequence.modes)]
            longer = sum(phase.steps for phase in start.phases)
            if longer == knots:
                break
            knots = longer
            nlp = transcribe(problem, limits, compiled, start.phases)
        with clock.stage("optimise"):
            path = solve(nlp, _with_time_left(problem, deadline))
        if path.feasible:
            return path, path.message, []
        deadline.check(
            "optimisation", f"{name} was at {sum(phase.steps for phase in start.phases)} steps", "candidates"
        )
    if "time limit" in path.message:  # what it had reached by then says nothing of what is possible
        return path, path.message, [finding_of_status(sequence.modes, path.message)]
    with clock.stage("optimise"):
        missed = unmet(nlp, _with_time_left(problem, deadline))
    message = "; ".join([path.message, *(shortfall.sentence for shortfall in missed)])
    findings = findings_of(problem, sequence.modes, missed)
    return path, message, findings or [finding_of_status(sequence.modes, path.message)]


def _with_time_left(problem: Problem, deadline: Deadline) -> Problem:
    """The problem with the time that an optimisation may take now."""
    settings = problem.settings
    return replace(problem, settings=replace(settings, time_limit_s=min(settings.time_limit_s, deadline.left_s)))


def trajectory_of(problem: Problem, limits: Limits, path: BeliefPath) -> Trajectory:
    """A belief path with the feedback around it."""
    inputs = np.where(np.abs(path.inputs) < _INPUT_ROUNDING * limits.max_step, 0.0, path.inputs)
    inputs = np.clip(inputs, -limits.max_step, limits.max_step)  # the solver keeps bounds only to its tolerance
    gains = belief_lqr(problem, limits, path.modes, path.is_transition, (path.means, inputs))
    return Trajectory(path.modes, path.means, path.factors, inputs, gains, path.is_transition)


def _solved(
    problem: Problem, limits: Limits, path: BeliefPath, candidates: tuple[Candidate, ...], seed: int, clock: Clock
) -> Plan:
    trajectory = trajectory_of(problem, limits, path)
    answer = Plan(
        "solved",
        "",
        trajectory=trajectory,
        candidates=candidates,
        cost=path.cost,
        goal_error=problem.goal.error(path.means[-1]),
        goal_std=problem.goal.std(path.factors[-1]),
        seed=seed,
        timings=clock.timings(),
    )
    tried = f"cheapest of {len(candidates)} mode sequences" if len(candidates) > 1 else "the only mode sequence"
    return replace(answer, reason=f"{' -> '.join(answer.mode_sequence)}, {tried}: {path.message}")
