"""Verification: the fraction of roll-outs of the true hybrid system that end in the goal, with its interval."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri

from micah_plan.arrays import INTERVAL, Booleans, Floats, Ints
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.planning import messages
from micah_plan.planning.around_bodies import with_scene
from micah_plan.planning.offers import (
    LESS_NOISE,
    MORE_CONFIDENCE,
    MORE_KNOTS,
    SURER_START,
    lower_confidence,
    more_revisits,
    moved_target,
)
from micah_plan.planning.path_constraints import PathRecord, joined_records
from micah_plan.planning.roll_outs import (
    RollOuts,
    are_in_goal,
    departure,
    draw_chances,
    restricted_to_nearby_modes,
    roll_out,
)
from micah_plan.task.acceptance import least_share, least_trials
from micah_plan.task.deadline import NEVER, Deadline, TimeLimitError
from micah_plan.task.plan import Finding, Plan, Trajectory
from micah_plan.task.problem import Problem
from micah_plan.task.reason import Offer, one_of
from micah_plan.task.release import pre_release_problem

# Where a sequential verification ends early it errs with at most this probability.
_ERRORS = 0.01
# Roll-outs that are made at once, and at most.
_AT_ONCE = 10_000
_MOST_TRIALS = 100_000
_ENOUGH = math.log((1.0 - _ERRORS) / _ERRORS)


def verify(
    problem: Problem,
    plan: Plan,
    trials: int | None = None,
    seed: int = 0,
    deadline: Deadline = NEVER,
    *,
    sequential: bool = False,
) -> Plan:
    """The plan with its success rate; ``"not_verified"`` if that is clearly below the confidence.

    Args:
        problem: solved by the plan.
        plan: as `pomdp_hd.plan` returned it; without a trajectory it is returned unchanged.
        trials: number of roll-outs; None: from the settings, but enough to show the confidence
            (`task.acceptance.least_trials`). 0: no verification.
        seed: of the roll-outs.
        deadline: if it passes before they end, the plan is not verified.
        sequential: stop at the first of the `decision_points` with a decision, as during an execution, where
            only the outcome counts and not the success rate.
    """
    count = problem.settings.verification_trials if trials is None else trials
    if plan.trajectory is None or count <= 0:
        return plan
    problem, confidence = with_scene(pre_release_problem(problem)), problem.settings.confidence
    found = messages.found(plan.mode_sequence)
    if (needed := least_trials(confidence)) > _MOST_TRIALS:
        sentence, remedy = messages.too_many_trials(needed, confidence, _MOST_TRIALS), messages.LOWER_CONFIDENCE
        finding = Finding("verification", "too_many_trials", sentence, remedy, plan.mode_sequence)
        return plan.refused_for(finding, found)
    count = max(count, needed) if trials is None and not sequential else count
    try:
        ends = _ends(problem, plan.trajectory, count, seed, deadline, sequential)
    except TimeLimitError as over:
        return plan.refused_for(Finding.of("verification", over.reason, plan.mode_sequence), found)
    successes, done = int(ends.in_goal.sum()), len(ends.in_goal)
    share, interval = successes / done, wilson_interval(successes, done)
    answer = replace(plan, success_probability=share, success_interval=interval, verification_trials=done)
    clear = sequential_decision(successes, done, confidence) if done < count else None
    if share >= least_share(confidence, count) if clear is None else clear:
        return answer
    if (leaves := departure(problem, plan.trajectory)) is not None:
        where = leaves.planned, leaves.knot
        ways = messages.ROOM_AT_TRANSITION, MORE_KNOTS, LESS_NOISE
        of_plan = one_of(ways), plan.mode_sequence, *where, "transitions"
        sentence = messages.leaves_mode_sequence(leaves.knot, leaves.planned, leaves.visited)
        finding = Finding("verification", "leaves_mode_sequence", sentence, *of_plan, ways=ways)
        return answer.refused_for(finding, found)
    reason = f"{found}{messages.too_few_succeed(successes, done, confidence)}"
    findings = _findings(problem, plan.mode_sequence, ends)
    return replace(answer, outcome="not_verified", reason=reason, findings=(*plan.findings, *findings))


@dataclass(frozen=True, eq=False)
class _Ends:
    """Final states of t roll-outs: modes (t,), states (t, n) [rad or m], success (t,), and path records."""

    modes: Ints
    states: Floats
    in_goal: Booleans
    path: PathRecord


def _ends(
    problem: Problem, trajectory: Trajectory, count: int, seed: int, deadline: Deadline, sequential: bool
) -> _Ends:
    """Final states of `count` roll-outs, at once or sequentially until decided, among reachable modes."""
    near, outermost = restricted_to_nearby_modes(problem, trajectory)
    ends, visited = _run_roll_outs(near, trajectory, count, seed, deadline, sequential)
    if visited & outermost:
        return _run_roll_outs(problem, trajectory, count, seed, deadline, sequential)[0]
    numbers = np.array([problem.automaton.mode_index(name) for name in near.automaton.mode_names])
    return replace(ends, modes=numbers[ends.modes])


def _run_roll_outs(
    problem: Problem, trajectory: Trajectory, count: int, seed: int, deadline: Deadline, sequential: bool
) -> tuple[_Ends, set[str]]:
    """(final states, names of visited modes)."""
    turns: list[RollOuts] = []
    in_goal, confidence = np.zeros(0, dtype=bool), problem.settings.confidence
    looks = decision_points(count, confidence) if sequential else (*range(_AT_ONCE, count, _AT_ONCE), count)
    for number, look in enumerate(looks):
        own_seed = seed if len(looks) == 1 else (seed, number)
        chances = draw_chances(problem, trajectory, look - len(in_goal), own_seed)
        turns.append(roll_out(problem, trajectory, chances, deadline))
        in_goal = np.append(in_goal, are_in_goal(problem, turns[-1]))
        if sequential_decision(int(in_goal.sum()), len(in_goal), confidence) is not None:
            break
    modes, states = (np.concatenate([getattr(turn, name) for turn in turns]) for name in ("modes", "states"))
    reached = {int(mode) for turn in turns for mode in (*np.unique(turn.visited), *np.unique(turn.modes))}
    visited = {problem.automaton.modes[mode].name for mode in reached}
    return _Ends(modes, states, in_goal, joined_records([turn.path for turn in turns])), visited


def sequential_decision(successes: int, trials: int, confidence: float) -> bool | None:
    """Whether the successes establish the confidence (True) or twice its failure rate (False); None: undecided.

    None where more roll-outs are needed. The sequential probability ratio test between these two, with an error
    probability of one in a hundred. Source: Wald, "Sequential analysis", 1947.
    """
    of_success, of_failure = _evidence(confidence)
    ratio = successes * of_success + (trials - successes) * of_failure
    return ratio > 0.0 if abs(ratio) >= _ENOUGH else None


def decision_points(trials: int, confidence: float) -> tuple[int, ...]:
    """Numbers of roll-outs at which a sequential verification tests for a decision.

    A step of few roll-outs takes nearly as long as one of some more, so it tests once before the end: when a plan that
    fails half as often as the confidence allows is expected to be decided. Not at all where that is late.
    """
    of_success, of_failure = _evidence(confidence)
    failing = 0.5 * (1.0 - confidence)
    first = math.ceil(_ENOUGH / ((1.0 - failing) * of_success + failing * of_failure))
    return (first, trials) if 2 * first <= trials else (trials,)


def _evidence(confidence: float) -> tuple[float, float]:
    """Increments of the log likelihood ratio for a success and a failure."""
    failing = 1.0 - confidence
    worse = min(2.0 * failing, 0.5 * (1.0 + failing))
    return math.log(confidence / (1.0 - worse)), math.log(failing / worse)


def _findings(problem: Problem, modes: tuple[str, ...], ends: _Ends) -> list[Finding]:
    """Findings on failed roll-outs: final modes and distances from the goal, most frequent first."""
    automaton, goal, confidence = problem.automaton, problem.goal, problem.settings.confidence
    findings: list[tuple[float, Finding]] = ends.path.findings(modes)
    names = [automaton.modes[i].name for i in ends.modes]
    wrong = [name for name in names if not goal.admits(name)]
    if wrong:
        share, commonest = len(wrong) / len(names), max(sorted(set(wrong)), key=wrong.count)
        sentence = messages.ends_in_other_mode(share, goal.modes, commonest)
        ways: tuple[str | Offer, ...] = LESS_NOISE, SURER_START, MORE_CONFIDENCE
        place = modes, commonest, None, "goal modes"
        finding = Finding("verification", "ends_in_other_mode", sentence, one_of(ways), *place, ways=ways)
        findings.append((share, finding))
    ranges = {index: automaton.ranges(index, [automaton.mode(modes[-1])]) for index in goal.indices}
    of_target = goal.target, goal.distances(ends.states).T, goal.misses(ends.states).T
    joint = _joint_offer(problem, ends)
    for (index, value, tolerance), distance, missed in zip(*of_target, strict=True):
        coordinate, need = automaton.coordinates[index], float(np.quantile(distance, confidence))
        if need <= tolerance:
            continue
        elsewhere = _other_final_mode(names, missed, modes)
        share, unit = float(missed.mean()), coordinate.unit
        sentence = messages.misses_goal(share, coordinate.name, elsewhere, confidence, need, tolerance, unit)
        words = messages.widen_tolerance(coordinate.name)
        ways = Offer(words, f"{words} to", "tolerance", joint), LESS_NOISE, lower_confidence(float(ends.in_goal.mean()))
        nearest = min((min(max(value, low), high) for low, high in ranges[index]), key=lambda x: abs(x - value))
        if nearest != value:  # the end of the range is nearer than the target: what misses does so on one side
            ways = moved_target(index, nearest), *ways
        if elsewhere:
            ways = LESS_NOISE, SURER_START, MORE_CONFIDENCE
        if problem.settings.revisits == 0 and (better := _localising(automaton, modes[-1], index)):
            ways = *ways, more_revisits(1, messages.localise(better, coordinate.name))
        of_goal = modes, "", None, f"the goal {coordinate.name} = {value:g} ± {tolerance:g}"
        finding = Finding("verification", "misses_goal", sentence, one_of(ways), *of_goal, unit=unit, ways=ways)
        findings.append((share, replace(finding, amount=need - tolerance, room=tolerance, need=need)))
    if not findings and joint:
        words = messages.widen_tolerance(automaton.coordinates[joint[0][0]].name)
        share = float(1.0 - ends.in_goal.mean())
        sentence = messages.misses_goal_jointly(share)
        ways = Offer(words, f"{words} to", "tolerance", joint), LESS_NOISE, lower_confidence(1.0 - share)
        return [Finding("verification", "misses_goal", sentence, one_of(ways), modes, ways=ways)]
    return [finding for _, finding in sorted(findings, key=lambda pair: -pair[0])]


def _joint_offer(problem: Problem, ends: _Ends) -> tuple[tuple[int, float], ...]:
    """Tolerances of the missed targets within which the requested share of roll-outs ends jointly."""
    goal, confidence = problem.goal, problem.settings.confidence
    distances = goal.distances(ends.states)
    tolerances = np.array([tolerance for _, _, tolerance in goal.target])
    wide = np.quantile(distances, confidence, axis=0) > tolerances
    if not np.count_nonzero(wide):  # each alone is missed seldom enough, but not all together
        wide = np.asarray((distances > tolerances).any(axis=0))
    share = float(np.quantile((distances / tolerances)[:, wide].max(axis=1, initial=0.0), confidence))
    return tuple((index, share * tol) for (index, _, tol), over in zip(goal.target, wide, strict=True) if over)


def _other_final_mode(names: list[str], missed: Booleans, modes: tuple[str, ...]) -> str:
    """The most frequent final mode of the failed roll-outs, if it is not the plan's last mode."""
    ends = [name for name, out in zip(names, missed, strict=True) if out]
    commonest = max(sorted(set(ends)), key=ends.count, default=modes[-1])
    return "" if commonest == modes[-1] else commonest


def _localising(automaton: HybridAutomaton, last: str, index: int) -> str:
    """A mode that pins or senses a coordinate better than the last one; empty if there is none."""
    worst = automaton.sensing(automaton.mode(last)).std[index]
    for mode in automaton.modes:
        if mode.name != last and (not mode.free[index] or automaton.sensing(mode).std[index] < worst):
            return mode.name
    return ""


def wilson_interval(successes: int, trials: int, coverage: float = INTERVAL) -> tuple[float, float]:
    """The probabilities that `successes` of `trials` do not contradict.

    Source: Wilson, "Probable inference, the law of succession, and statistical inference", JASA 1927. Unlike the normal
    approximation it has a width also where all or none succeed.
    """
    z, share = float(ndtri(0.5 + 0.5 * coverage)), successes / trials
    center = (share + z**2 / (2 * trials)) / (1 + z**2 / trials)
    half = z / (1 + z**2 / trials) * math.sqrt(share * (1 - share) / trials + z**2 / (4 * trials**2))
    # The ends are exact where all or none succeed, independent of rounding.
    low = 0.0 if successes == 0 else max(0.0, center - half)
    return low, 1.0 if successes == trials else min(1.0, center + half)
