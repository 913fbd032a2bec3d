"""Hands: one input that moves several coordinates, letting go and taking hold elsewhere, and whether it is possible."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hand_problems import (
    around_a_block,
    gears,
    handing_over,
    pre_release_problem,
    pusher,
    regrasping,
    swinging_back,
    turning_a_cap,
    two_holds,
)
from planning_examples import planar_problem

from micah_plan.automaton.hybrid import Mode, Pin, Tie
from micah_plan.automaton.region import Region
from micah_plan.planning.limits import Limits, limits_of
from micah_plan.planning.search.leaves import leaves_of
from micah_plan.planning.search.mode_search import search_modes
from micah_plan.planning.search.passages import passages
from micah_plan.planning.solver import solve
from micah_plan.task.problem import Problem

PROBLEMS: dict[str, tuple[Callable[[], Problem], int]] = {
    # How often the plan takes hold anew, at least.
    "a rod is carried": (pre_release_problem, 0),
    "it is carried back": (partial(pre_release_problem, 0.1, -0.2, 0.35), 0),
    "three geared coordinates": (gears, 0),
    "around a block": (around_a_block, 0),
    "held elsewhere": (regrasping, 1),
    "held elsewhere on the way back": (partial(regrasping, 0.3, -0.05, -0.05), 1),
    "from where nobody holds it": (partial(regrasping, mode="free", revisits=2, offset=0.3), 1),
    "a mode per hold": (two_holds, 1),
    "a cap, turned three times": (turning_a_cap, 3),
    "from hand to hand": (handing_over, 2),
    "left where a pusher takes it": (pusher, 2),
}


@pytest.mark.sweep
@pytest.mark.parametrize(
    "seed", [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.evidence)]
)
@pytest.mark.parametrize("name", PROBLEMS)
def test_hands_carry_let_go_and_take_hold_elsewhere(name: str, seed: int) -> None:
    make, least = PROBLEMS[name]
    problem = make()
    plan = solve(problem, seed=seed)
    assert plan.outcome == "solved", plan.reason
    taken = [mode for mode in plan.mode_sequence[1:] if mode != "free"]
    assert len(taken) >= least


def test_nothing_is_moved_where_the_next_mode_may_have_begun() -> None:
    """The thing is moved while the door is open for certain, not while it swings back."""
    problem = swinging_back()
    found = solve(problem)
    assert found.outcome == "solved", found.reason
    assert found.trajectory is not None
    door, moved = found.trajectory.means[:, 0], np.abs(found.trajectory.inputs[:, 1])
    passes = np.minimum(door[:-1], door[1:]) < 0.5
    assert moved[passes].max() < 0.005 < 0.02 < moved.max()


@pytest.mark.slow
def test_a_target_out_of_reach_stays_unsolved() -> None:
    """With one more hold the cap could be turned by 2.3; two holds turn it by 1.8 at most."""
    refused = solve(turning_a_cap(revisits=1))
    assert refused.outcome == "no_plan"
    assert refused.reason.endswith("raise revisits to 2")
    assert solve(turning_a_cap(revisits=2)).outcome == "solved"


def test_what_cannot_move_alone_is_reported() -> None:
    """Hand and rod are carried together: no input brings the rod to 0.5 m and the hand to 0.4 m."""
    problem = pre_release_problem()
    goal = replace(problem.goal, target=((0, 0.4, 0.02), (1, 0.5, 0.02)))
    refused = solve(replace(problem, goal=goal))
    assert refused.outcome == "no_plan"
    assert "'carries' keeps hand - rod" in refused.reason


def test_what_never_happens_is_not_planned() -> None:
    """Where letting go first of all drops the rod, nobody can take hold of it again."""
    problem = regrasping()
    opens = problem.automaton.edges[1]
    dropped = replace(problem.automaton.modes[0], name="dropped", input_matrix=((0.0, 0.0), (0.0, 0.0)))
    falls = replace(opens, target="dropped")
    automaton = replace(
        problem.automaton, modes=(*problem.automaton.modes, dropped), edges=(falls, *problem.automaton.edges)
    )
    assert solve(replace(problem, automaton=automaton), advise=False).outcome == "no_plan"


def leaf_mode(matrix: list[list[float]], pins: tuple[Pin, ...] = (), ties: tuple[Tie, ...] = ()) -> Mode:
    return Mode("any", (), tuple(map(tuple, matrix)), Region(), Region(), pins, ties=ties)


def unit_limits(n: int, m: int) -> Limits:
    return Limits(np.ones(m), -np.ones(n), np.ones(n), np.arange(1.0, n + 1.0))


@pytest.mark.parametrize(
    ("matrix", "pins", "ties", "directions", "kept"),
    [
        ([[1.0], [1.0]], (), (), 1, 1),
        ([[1.0, 0.0], [0.0, 1.0]], (), (), 2, 0),
        ([[1.0, 0.0], [0.0, 0.0], [2.0, 0.0]], (), (), 1, 2),
        ([[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]], (Pin(1, 0.0, 0.1),), (), 2, 0),
        ([[1.0], [-2.0]], (), (Tie(1, (-2.0, 0.0), 0.3),), 1, 0),
        ([[1.0, 1.0], [1.0, 1.0], [0.0, 0.0]], (Pin(2, 0.0, 0.1),), (), 1, 1),
    ],
)
def test_leaves_keep_what_no_input_moves(
    matrix: list[list[float]], pins: tuple[Pin, ...], ties: tuple[Tie, ...], directions: int, kept: int
) -> None:
    mode = leaf_mode(matrix, pins, ties)
    limits = unit_limits(*np.shape(matrix))
    leaves = leaves_of(mode, limits)
    assert leaves.along.shape[1] == directions
    assert len(leaves.kept) == kept
    rng = np.random.default_rng(0)
    x, moved = rng.normal(size=(2, len(matrix)))
    onward = x + mode.B * mode.free[:, None] @ rng.normal(size=limits.max_step.size)
    np.testing.assert_array_equal(leaves.numbers(np.array([x, onward, moved])), [0, 0, int(kept > 0)])
    np.testing.assert_allclose(leaves.projected_on_leaf(x, onward[None])[0], onward, atol=1e-12)
    np.testing.assert_allclose(leaves.kept @ leaves.along, 0.0, atol=1e-12)


@pytest.mark.parametrize("make", [regrasping, two_holds, pusher, planar_problem])
def test_passages_are_paths_but_for_obstacles(make: Callable[[], Problem]) -> None:
    problem = make()
    automaton, limits = problem.automaton, limits_of(problem)
    start, found = problem.start.mode or "left", 0
    for passage in passages(problem, limits, start, np.random.default_rng(0)):
        found += 1
        np.testing.assert_allclose(passage.entries[0], problem.start.mean)
        tolerances = [tolerance for _, _, tolerance in problem.goal.target]
        assert (problem.goal.distances(passage.exits[-1]) < np.array(tolerances) + 1e-8).all()
        for i, name in enumerate(passage.modes):
            leaves = leaves_of(automaton.mode(name), limits)
            np.testing.assert_array_equal(leaves.numbers(np.array([passage.entries[i], passage.exits[i]])), [0, 0])
            assert automaton.mode(name).invariant.contains(passage.exits[i], np.zeros(automaton.m), 1e-8)
        for i, number in enumerate(passage.edges):
            edge = automaton.edges[number]
            on_state = [h for h in edge.guard.half_spaces if not h.on_input]
            assert all(h.margin(passage.exits[i], np.zeros(automaton.m)) > -1e-8 for h in on_state)
            behind = edge.reset.apply(passage.exits[i], np.zeros(automaton.m))
            np.testing.assert_allclose(behind, passage.entries[i + 1], atol=1e-8)
    assert found > 5


@pytest.mark.slow
def test_the_same_seed_finds_the_same() -> None:
    problem = regrasping()
    one, other = (search_modes(problem, limits_of(problem), "holds", seed=3) for _ in range(2))
    assert [s.cost for s in one.sequences] == [s.cost for s in other.sequences]
    for first, second in zip(one.sequences, other.sequences, strict=True):
        assert [w.tobytes() for w in first.waypoints] == [w.tobytes() for w in second.waypoints]
