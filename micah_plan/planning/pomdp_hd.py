"""POMDP-HD: mode sequences from a search, a belief trajectory along each, and the cheapest with feedback.

    1. high level   search the roadmaps of all modes for the cheapest mode sequences        `search`
    2. low level    optimise the belief trajectory through each of them                     `transcription`
    3. choose       the cheapest optimum of all                                             here
    4. feedback     belief-LQR around it                                                    `feedback`

Source: Jain and Niekum, "Efficient hierarchical robot motion planning under uncertainty and hybrid dynamics", CoRL
2018.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from micah_plan.arrays import EQUAL, Floats
from micah_plan.automaton.input_memory import own_size
from micah_plan.planning import messages
from micah_plan.planning.attempt import Attempt, attempt_plan
from micah_plan.planning.cuts import Cut, tight_places, with_cuts_as_bodies, with_enlarged_obstacles
from micah_plan.planning.feedback import belief_lqr
from micah_plan.planning.findings import finding_of_status, findings_of, sentence_of
from micah_plan.planning.input_memories import with_input_memory, without_input_memory
from micah_plan.planning.limits import Limits, drifts, limits_of
from micah_plan.planning.no_way import NoWayError
from micah_plan.planning.plan_cost import time_cost
from micah_plan.planning.roll_outs import departure
from micah_plan.planning.search.mode_search import ModeSequence, SearchResult, search_modes
from micah_plan.planning.search.passing_time import with_passing_time
from micah_plan.planning.transcription.guess import PhaseGuess, guess, guess_at
from micah_plan.planning.transcription.programme import transcribe
from micah_plan.planning.transcription.solve import BeliefPath, solve_transcription, violated_constraints
from micah_plan.planning.zero_time_transitions import with_zero_time_transitions
from micah_plan.summaries import Progress
from micah_plan.task.deadline import Deadline, TimeLimitError
from micah_plan.task.plan import Candidate, Finding, Plan, Trajectory
from micah_plan.task.problem import Problem

# Factors on the number of steps of a path, tried in turn: slower inputs, more measurements at a guard. Where something
# drifts, time may run out: then as fast as inputs allow comes second.
_STRETCHES = (1.0, 2.0, 4.0)
# How often the sides of obstacles are chosen again on a path, and the least gain.
_MOST_SIDES, _LEAST_GAIN = 4, 1e-3
# Searches after the first, each without the narrow places of the paths before.
_MOST_DETOURS = 2


def plan(problem: Problem, seed: int = 0, progress: Progress | None = None, deadline: Deadline | None = None) -> Plan:
    """Plan from the start belief to the goal. Deterministic up to the limits on processor time.

    Args:
        problem: to solve.
        seed: of the search.
        progress: called with one line of text and the fraction done whenever a stage begins.
        deadline: None: the time limit of the settings from now on.

    Returns:
        A plan with outcome ``"solved"`` (to be confirmed by `verification.verify`) or ``"no_plan"`` with the reason.
    """
    return attempt_plan(planned, "search", problem, seed, progress, deadline)


def with_memory(problem: Problem, sequence: ModeSequence) -> ModeSequence:
    """A sequence found over x as one over (x, m), with m as at the start of the problem."""
    memory = np.array(problem.start.mean[own_size(problem.automaton) :])
    paths = [np.hstack([path, np.tile(memory, (len(path), 1))]) for path in sequence.waypoints]
    return replace(sequence, waypoints=tuple(paths))


def planned(attempt: Attempt, search_result: SearchResult | None = None) -> Plan:
    """Plan by POMDP-HD; `search_result`: mode sequences over x to optimise, None: search for them.

    A memory of inputs does not change the possible mode sequences. If the means of all plans leave their mode sequences
    because other transitions happen first, search and optimisation are repeated with these transitions divided
    (`zero_time_transitions`).
    """
    asked = attempt.problem
    whole = with_input_memory(asked)
    attempt = replace(attempt, problem=with_zero_time_transitions(whole))
    if search_result is not None:
        return _cheapest_plan(attempt, asked, _optimised_each(attempt, search_result))
    plan = _cheapest_plan(attempt, asked, _with_detours(attempt))
    if plan.trajectory is None or departure(asked, plan.trajectory) is None:
        return plan
    divided = with_zero_time_transitions(whole, in_parts=True)
    with suppress(NoWayError, TimeLimitError):
        again = replace(attempt, problem=divided)
        better = _cheapest_plan(again, asked, _with_detours(again))
        return plan if better.trajectory is None else replace(better, alternatives=(*better.alternatives, plan))
    return plan


def _with_detours(attempt: Attempt) -> list[_CandidatePlan]:
    """Belief paths along the mode sequences of a search, and around their narrow places.

    Raises:
        NoWayError, TimeLimitError: if there is no sequence.
    """
    attempt.progress("searching mode sequences", 0.0)
    plain, cuts = without_input_memory(attempt.problem), list[Cut]()
    limits, size_of_state = limits_of(plain), own_size(attempt.problem.automaton)
    search_result = _searched(attempt, plain, cuts)
    tried = _optimised_each(attempt, search_result)
    if not any(attempt_result.is_whole for attempt_result in tried):
        with suppress(TimeLimitError):
            tried += _optimised_each(
                attempt, _without_optimised(attempt, _searched(attempt, with_enlarged_obstacles(plain), cuts), tried)
            )
    for _ in range(_MOST_DETOURS):
        tight = [
            cut
            for attempt_result in tried
            if attempt_result.path
            for cut in tight_places(plain, limits, attempt_result.path, size_of_state)
        ]
        if len(tight) <= len(cuts):
            break
        cuts = tight
        with suppress(TimeLimitError):
            tried += _optimised_each(attempt, _without_optimised(attempt, _searched(attempt, plain, cuts), tried))
    return tried


def _searched(attempt: Attempt, plain: Problem, cuts: Sequence[Cut]) -> SearchResult:
    """Mode sequences of a problem over x, with some states cut out."""
    attempt.deadline.check("search", messages.without_detour(), "candidates")
    with attempt.clock.stage("search"):
        task = with_passing_time(with_cuts_as_bodies(plain, cuts) if cuts else plain)
        return search_modes(task, limits_of(task), attempt.mode, attempt.seed, deadline=attempt.deadline)


def _without_optimised(attempt: Attempt, found: SearchResult, tried: Sequence[_CandidatePlan]) -> SearchResult:
    """Sequences without an optimisation so far, through modes of the problem; none is not an error.

    A state that is cut out may be in the goal, but to be stuck there is no plan.
    """
    own = set(attempt.problem.automaton.mode_names)
    ways = (way for way in found.sequences if own.issuperset(way.modes))
    return SearchResult(tuple(way for way in ways if not _is_known(way, tried)))


def _is_known(sequence: ModeSequence, tried: Sequence[_CandidatePlan]) -> bool:
    """Whether a path with the same transitions and corners was optimised already."""
    return any(
        attempt_result.sequence.edges == sequence.edges
        and all(
            a.shape == b.shape and np.allclose(a, b)
            for a, b in zip(attempt_result.corners, sequence.waypoints, strict=True)
        )
        for attempt_result in tried
    )


def _optimised_each(attempt: Attempt, found: SearchResult) -> list[_CandidatePlan]:
    """The belief paths through the mode sequences of a search.

    Raises:
        NoWayError: if it has a reason why there are none.
    """
    if found.reason is not None:
        raise NoWayError(found.reason)
    tried = []
    for number, sequence in enumerate(found.sequences, start=1):
        attempt.progress(f"optimising {' -> '.join(sequence.modes)}", number / (len(found.sequences) + 1))
        attempt_result = _low_level(attempt, with_memory(attempt.problem, sequence))
        tried.append(replace(attempt_result, corners=sequence.waypoints))
    return tried


def _cheapest_plan(attempt: Attempt, asked: Problem, tried: Sequence[_CandidatePlan]) -> Plan:
    """The cheapest plan whose mean keeps to its mode sequence, with the others as alternatives."""
    candidates = tuple(attempt_result.candidate(asked) for attempt_result in tried)
    paths = [
        (attempt_result.path, attempt_result.sequence, attempt_result.price(asked))
        for attempt_result in tried
        if attempt_result.path is not None and attempt_result.path.feasible
    ]
    if not paths:
        first, findings = (
            candidates[0],
            tuple(finding for attempt_result in tried for finding in attempt_result.findings),
        )
        beginning = messages.no_sequence_optimised(first.modes)
        if tried[0].path is None:  # the message is the finding
            return attempt.refused_for(findings, beginning, candidates)
        return attempt.refused(f"{beginning}{first.message}", findings, candidates)
    plans = []
    for number, (path, sequence, price) in enumerate(sorted(paths, key=lambda priced: priced[2]), start=1):
        trajectory = trajectory_of(attempt.problem, attempt.limits, path)
        how = messages.chosen(number, len(tried), path.message)
        in_part = tuple(findings_of(attempt.problem, sequence.modes, path.in_part))
        plan = attempt.solved(trajectory, price, how, candidates, in_part)
        plans.append(replace(plan, purposes=sequence.purposes))
    # Between the knots other transitions may come first: what its own mean does not follow is no plan.
    plans.sort(key=lambda plan: plan.trajectory is None or departure(asked, plan.trajectory) is not None)
    return replace(plans[0], alternatives=tuple(plans[1:]))


@dataclass(frozen=True, eq=False)
class _CandidatePlan:
    """A mode sequence after optimisation: its belief path if there is one, and its shortfalls.

    Attributes:
        corners: waypoints of the sequence over x, as the search found them.
    """

    sequence: ModeSequence
    path: BeliefPath | None
    message: str
    findings: tuple[Finding, ...] = ()
    corners: tuple[Floats, ...] = ()

    @property
    def is_whole(self) -> bool:
        """Whether all boundaries of the path hold with the confidence."""
        return self.path is not None and self.path.feasible and not self.path.in_part

    def price(self, problem: Problem) -> float:
        """The cost including time; infinite without a path."""
        if self.path is None or not self.path.feasible:
            return np.inf
        return self.path.cost + time_cost(problem, self.path.is_transition)

    def candidate(self, problem: Problem) -> Candidate:
        """The sequence as an entry of a plan's candidates."""
        price = self.price(problem)
        return Candidate(self.sequence.modes, self.sequence.total, price if np.isfinite(price) else None, self.message)


def _low_level(attempt: Attempt, sequence: ModeSequence) -> _CandidatePlan:
    """The belief path along a mode sequence in the fewest feasible steps."""
    try:
        return _optimised(attempt, sequence)
    except (NoWayError, TimeLimitError) as failed:
        finding = Finding.of("optimisation", failed.reason, sequence.modes)
        return _CandidatePlan(sequence, None, str(failed.reason), (finding,))


def _optimised(attempt: Attempt, sequence: ModeSequence) -> _CandidatePlan:
    problem, deadline, clock, steps = attempt.problem, attempt.deadline, attempt.clock, -1
    for stretch in (1.0, problem.settings.pace, *_STRETCHES[1:]) if drifts(problem) else _STRETCHES:
        deadline.check("optimisation", messages.sequence_untried(sequence.modes, steps), "candidates")
        with clock.stage("build"):
            phases = guess(problem, attempt.limits, sequence, stretch)
            longer = sum(phase.steps for phase in phases)
            if longer == steps:
                break
            steps = longer
            nlp = transcribe(problem, attempt.limits, phases)
        with clock.stage("optimise"):
            path = solve_transcription(nlp, _time_limit(attempt))
        if path.feasible:
            path = _with_other_sides(attempt, phases, path)
            return _CandidatePlan(sequence, path, path.message)
        deadline.check("optimisation", messages.sequence_at(sequence.modes, steps), "candidates")
    if path.is_out_of_time:  # then its state is inconclusive
        finding = finding_of_status(sequence.modes, path.message, is_out_of_time=True)
        return _CandidatePlan(sequence, path, path.message, (finding,))
    with clock.stage("optimise"):
        missed = violated_constraints(nlp, _time_limit(attempt))
    message = "; ".join([path.message, *map(sentence_of, missed)])
    findings = findings_of(problem, sequence.modes, missed) or [finding_of_status(sequence.modes, path.message)]
    return _CandidatePlan(sequence, path, message, tuple(findings))


def _with_other_sides(attempt: Attempt, phases: tuple[PhaseGuess, ...], path: BeliefPath) -> BeliefPath:
    """A partly feasible path optimised again with the sides of obstacles that suit it.

    By which side a step stays out of them is chosen before the optimisation, and may be another where it ends.
    """
    problem = attempt.problem
    for _ in range(_MOST_SIDES):
        if not path.in_part or attempt.deadline.is_over():
            break
        with attempt.clock.stage("build"):
            nlp = transcribe(problem, attempt.limits, guess_at(problem, phases, path.means, path.factors, path.inputs))
        with attempt.clock.stage("optimise"):
            again = solve_transcription(nlp, _time_limit(attempt))
        if not again.feasible or again.cost > path.cost - _LEAST_GAIN:
            break
        path = again
    return path


def _time_limit(attempt: Attempt) -> float:
    """Time limit of the next optimisation [s]."""
    return min(attempt.problem.settings.time_limit_s, attempt.deadline.left_s)


def trajectory_of(problem: Problem, limits: Limits, path: BeliefPath) -> Trajectory:
    """The trajectory of a belief path, with feedback gains."""
    inputs = np.where(np.abs(path.inputs) < EQUAL * limits.max_step, 0.0, path.inputs)
    inputs = np.clip(inputs, -limits.max_step, limits.max_step)  # the solver meets bounds only to its tolerance
    gains = belief_lqr(problem, limits, path.modes, path.is_transition, (path.means, inputs))
    return Trajectory(path.modes, path.means, path.factors, inputs, gains, path.is_transition)
