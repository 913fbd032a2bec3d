"""Problems whose models remember inputs: with the memory as part of the state, and without.

Goals, starts and pages refer to the model's own coordinates x. Planner, feedback and filter work on (x, m), see
`automaton.input_memory`; a start is at rest. The search for mode sequences needs x only: how far the inputs of a mode
lead does not depend on when they arrive.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from micah_plan.arrays import DIFFERENCE, Floats
from micah_plan.automaton.effects.motion import displaced
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.input_memory import (
    memory_at_rest,
    own_size,
    passed_arrays,
    with_memory_states,
    without_memory_states,
)
from micah_plan.planning.limits import motion_per_input
from micah_plan.task.problem import Problem

# An input has arrived when less than this share of it is missing.
_MISSING = 0.02
_LONGEST = 60


def with_input_memory(problem: Problem) -> Problem:
    """The problem over (x, m), with memories at rest; unchanged if there is no memory or it is included already."""
    whole = with_memory_states(problem.automaton)
    if whole is problem.automaton:
        return problem
    start = problem.start
    rest = memory_at_rest(whole, start.mean)
    start = replace(start, mean=start.mean + rest, std=start.std + (0.0,) * len(rest))
    return replace(problem, automaton=whole, start=start)


def without_input_memory(problem: Problem) -> Problem:
    """The problem over x."""
    plain = without_memory_states(problem.automaton)
    if plain is problem.automaton:
        return problem
    start = replace(problem.start, mean=problem.start.mean[: plain.n], std=problem.start.std[: plain.n])
    return replace(problem, automaton=plain, start=start)


def after_memories_run_out(automaton: HybridAutomaton, mode: str, x: Floats) -> Floats:
    """(..., n) states after the memories have run out: no further command, and no guard in the way."""
    nothing = np.zeros((*x.shape[:-1], automaton.m))
    for _ in range(_LONGEST if automaton.input_memories else 0):
        passed, kept = passed_arrays(automaton.input_memories, mode, x, nothing)
        x = kept + displaced(automaton, automaton.mode(mode), kept, passed)[0]
    return x


def steps_of_memory(automaton: HybridAutomaton, max_step: Floats) -> tuple[int, int]:
    """Steps until half of the largest input arrives, and steps until its last part has arrived."""
    felt, gone = 0, 0
    if not automaton.input_memories:
        return felt, gone
    rest = np.zeros(automaton.n)
    rest[own_size(automaton) :] = memory_at_rest(automaton)
    for mode in automaton.modes:
        for u in (max_step, -max_step):
            x, arrived = rest, np.zeros((2, _LONGEST, automaton.m))
            for k in range(2 * _LONGEST):
                passed, x = passed_arrays(automaton.input_memories, mode.name, x, u if k < _LONGEST else 0.0 * u)
                arrived[divmod(k, _LONGEST)] = np.abs(passed) / max_step
            felt = max(felt, *(int(np.argmax(column >= 0.5)) for column in arrived[0].T))
            gone = max(gone, int((arrived[1] > _MISSING).any(axis=1).sum()))
    return felt, gone


def linear_step(automaton: HybridAutomaton, mode: str, x: Floats, u: Floats, largest: Floats) -> tuple[Floats, Floats]:
    """A (n, n) and B (n, m) of a mode's flow linearised at (x, u), with the memories of inputs.

    Effects on the command scale B by their gain at the largest inputs (m,): where a dead zone or a saturation has no
    slope, larger corrections still count.
    """
    n, m = automaton.n, automaton.m
    B = motion_per_input(automaton, mode, largest)
    if not automaton.input_memories:
        return np.eye(n), B
    steps = DIFFERENCE * np.eye(n + m)
    around = np.concatenate([np.concatenate([x, u]) + steps, np.concatenate([x, u]) - steps])
    passed, kept = passed_arrays(automaton.input_memories, mode, around[:, :n], around[:, n:])
    after = kept + passed @ B.T
    slopes = (after[: n + m] - after[n + m :]).T / (2 * DIFFERENCE)
    return slopes[:, :n], slopes[:, n:]
