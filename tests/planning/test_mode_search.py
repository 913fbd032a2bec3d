"""The high level: roadmaps, guard edges, k cheapest mode sequences, reasons."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from planning_examples import DOOR_SHUT, door_automaton, door_problem, drawer_problem, planar_problem, with_settings
from scipy.sparse import csr_array

from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Mode, Noise, Pin, Reset
from micah_plan.automaton.region import Region, below, box, input_above
from micah_plan.planning import messages
from micah_plan.planning.limits import limits_of
from micah_plan.planning.search.mode_paths import cheapest_sequences
from micah_plan.planning.search.mode_search import SearchResult, _modes_near_the_way, search_modes
from micah_plan.planning.search.roadmap import TRANSITION_COST, JoinedRoadmap, motions_of
from micah_plan.task.deadline import Deadline, TimeLimitError
from micah_plan.task.goal import Goal
from micah_plan.task.problem import Problem
from micah_plan.task.settings import PlannerSettings
from micah_plan.task.start import Start


def search(problem: Problem, start_mode: str, seed: int = 0) -> SearchResult:
    return search_modes(problem, limits_of(problem), start_mode, seed)


def test_closing_a_door_offers_to_stop_at_the_frame_and_to_latch() -> None:
    found = search(door_problem(0.2, DOOR_SHUT), "swings").sequences
    assert [s.modes for s in found] == [("swings",), ("swings", "shut")]
    assert found[1].edges == (0,)
    for sequence in found:
        np.testing.assert_allclose(sequence.waypoints[0], [[0.2], [DOOR_SHUT]], atol=1e-9)
    # The path is straight: its length in steps of 0.06 rad, and one transition.
    assert found[0].cost == pytest.approx(1.0 / 0.06)
    assert found[1].cost == pytest.approx(1.0 / 0.06 + TRANSITION_COST)


def test_opening_a_door_leaves_the_latch_by_the_input() -> None:
    (sequence,) = search(door_problem(DOOR_SHUT, 0.3, mode="shut"), "shut").sequences
    assert sequence.modes == ("shut", "swings")
    np.testing.assert_allclose(sequence.waypoints[0], [[DOOR_SHUT]])
    np.testing.assert_allclose(sequence.waypoints[1], [[DOOR_SHUT], [0.3]], atol=1e-9)


def test_the_path_goes_through_the_gate_and_around_the_trap() -> None:
    problem = planar_problem()
    (first, *_) = search(problem, "left").sequences
    assert first.modes == ("left", "right")
    left, right = first.waypoints
    assert left[-1, 0] == pytest.approx(0.0, abs=1e-9)
    assert left[-1, 1] >= 0.8 - 1e-9
    np.testing.assert_allclose(right[0], left[-1])
    np.testing.assert_allclose(right[-1], [0.8, -0.8], atol=1e-9)
    along = np.concatenate([np.linspace(a, b, 500) for a, b in itertools.pairwise(left)])
    block = problem.automaton.edges[2].guard
    assert not np.any(np.all(block.margins(along, np.zeros((len(along), 2))) > 1e-6, axis=1))


def test_the_straight_path_would_hit_the_trap() -> None:
    problem = planar_problem()
    limits = limits_of(problem)
    motion = motions_of(problem, limits)["left"]
    start = np.array([[-0.9, 0.0]] * 4)
    ends = np.array([[-0.7, 0.9], [0.0, 0.0], [-0.5, 0.0], [-0.6, 0.0]])
    # Free; through the block; into the block; up to its boundary, where the transition happens.
    np.testing.assert_array_equal(np.isfinite(motion.steps(start, ends)), [True, False, False, True])


def test_results_do_not_depend_on_what_ran_before() -> None:
    problem = planar_problem()
    first = search(problem, "left", seed=7)
    search(drawer_problem(0.0, 0.3), "slides", seed=3)
    search(problem, "left", seed=8)
    again = search(problem, "left", seed=7)
    assert [(s.modes, s.edges, s.cost) for s in first.sequences] == [
        (s.modes, s.edges, s.cost) for s in again.sequences
    ]
    for one, other in zip(first.sequences, again.sequences, strict=True):
        assert [w.tobytes() for w in one.waypoints] == [w.tobytes() for w in other.waypoints]


def test_the_reset_moves_the_path() -> None:
    """A transition that carries the door back to 0.5: the next mode's path begins there."""
    automaton = door_automaton()
    thrown = Edge("swings", "shut", automaton.edges[0].guard, Reset(c=(0.0,)))
    moved = Edge("shut", "swings", automaton.edges[1].guard, Reset(A=((0.0,),), c=(0.5,)))
    automaton = replace(automaton, edges=(thrown, moved, automaton.edges[2]))
    (sequence,) = search(door_problem(DOOR_SHUT, 0.3, mode="shut", automaton=automaton), "shut").sequences
    np.testing.assert_allclose(sequence.waypoints[1], [[0.5], [0.3]], atol=1e-9)


def test_goal_in_no_range_says_the_ranges() -> None:
    found = search(door_problem(0.2, 2.0), "swings")
    assert found.sequences == ()
    assert "door = 2 ± 0.05 rad" in str(found.reason)
    assert "'swings' allows door in [0, 1.2] rad" in str(found.reason)


def test_no_transition_to_the_goal_reports_it() -> None:
    automaton = door_automaton()
    automaton = replace(automaton, edges=automaton.edges[1:])
    found = search(door_problem(0.2, DOOR_SHUT, automaton=automaton, goal_modes=("shut",)), "swings")
    assert found.reason is not None
    assert found.reason.code == "no_transition_to_goal"
    assert found.reason.sentence == messages.no_transition_to_goal("swings", ("shut",))


def test_a_guard_out_of_reach_is_named() -> None:
    problem = door_problem(DOOR_SHUT, 0.3, mode="shut", automaton=door_automaton(release=0.1))
    assert "the guard of 'shut -> swings' ('input door < -0.1') holds nowhere" in str(search(problem, "shut").reason)


def test_a_reset_out_of_the_target_is_named() -> None:
    automaton = door_automaton()
    moved = Edge("shut", "swings", automaton.edges[1].guard, Reset(A=((0.0,),), c=(5.0,)))
    automaton = replace(automaton, edges=(automaton.edges[0], moved, automaton.edges[2]))
    found = search(door_problem(DOOR_SHUT, 0.3, mode="shut", automaton=automaton), "shut")
    assert str(found.reason).startswith("the reset of 'shut -> swings' leads out of the invariant of mode 'swings'")


def test_a_coordinate_that_nothing_moves_is_named() -> None:
    problem = planar_problem(trap=False)
    modes = tuple(replace(mode, input_matrix=((1.0, 0.0), (0.0, 0.0))) for mode in problem.automaton.modes)
    problem = replace(problem, automaton=replace(problem.automaton, modes=modes), goal=Goal(((1, 0.5, 0.05),)))
    assert "'y' starts at 0 m and the goal is 0.5 ± 0.05 m, but no mode that can be reached moves it" in (
        str(search(problem, "left").reason)
    )


def test_a_goal_behind_a_wall_of_guards_is_not_connected() -> None:
    problem = planar_problem()
    wall = replace(problem.automaton.edges[2], guard=Region(problem.automaton.edges[2].guard.half_spaces[:1]))
    automaton = replace(problem.automaton, edges=(*problem.automaton.edges[:2], wall))
    assert "lead to the goal only without 'x >= -0.6'" in str(
        search(replace(problem, automaton=automaton), "left").reason
    )


def test_candidates_limit_the_number_of_sequences() -> None:
    assert len(search(with_settings(door_problem(0.2, DOOR_SHUT), candidates=1), "swings").sequences) == 1


@pytest.mark.parametrize("seed", range(8))
def test_k_cheapest_sequences_agree_with_enumeration(seed: int) -> None:
    rng = np.random.default_rng(seed)
    modes = ["a", "b", "c", "d"]
    graphs = {q: rng.uniform(1, 5, (3, 3)) * (rng.random((3, 3)) < 0.7) * (1 - np.eye(3)) for q in modes}
    pairs = [(p, q) for p in modes for q in modes if p != q and rng.random() < 0.7]
    exits = {i: rng.integers(0, 3, (2, 2)) for i in range(len(pairs))}
    goals = {"d": np.array([0, 2]), "b": np.array([1])}
    goal_costs = {"d": np.array([0.5, 0.0]), "b": np.array([4.0])}
    roadmap = JoinedRoadmap(
        {q: csr_array(g) for q, g in graphs.items()}, exits, dict(enumerate(pairs)), ("a", 0), goals, goal_costs
    )
    found = cheapest_sequences(roadmap, 50)
    expected = enumerated(graphs, pairs, exits, goals, goal_costs)
    assert [s.cost for s in found] == pytest.approx(sorted(expected.values()))
    assert {s.edges: pytest.approx(s.cost) for s in found} == expected
    assert [s.edges for s in cheapest_sequences(roadmap, 2)] == [s.edges for s in found[:2]]
    for sequence in found:
        assert len(set(sequence.modes)) == len(sequence.modes)
        assert walked(sequence, graphs, goals, goal_costs) == pytest.approx(sequence.cost)


def enumerated(graphs, pairs, exits, goals, goal_costs):  # type: ignore[no-untyped-def]
    """Cost by edges of every sequence without revisits, by dynamic programming along each."""
    costs: dict[tuple[int, ...], float] = {}

    def within(mode, entry):  # type: ignore[no-untyped-def]
        cost = entry.copy()
        weights = np.where(graphs[mode] > 0, graphs[mode], np.inf)
        for _ in range(3):
            cost = np.minimum(cost, (cost[:, None] + weights).min(axis=0))
        return cost

    def visit(mode, entry, modes, edges):  # type: ignore[no-untyped-def]
        cost = within(mode, entry)
        if mode in goals:
            total = (cost[goals[mode]] + goal_costs[mode]).min()
            if np.isfinite(total):
                costs[edges] = total
        for index, (source, target) in enumerate(pairs):
            if source == mode and target not in modes:
                following = np.full(3, np.inf)
                for before, after in exits[index]:
                    following[after] = min(following[after], cost[before] + TRANSITION_COST)
                visit(target, following, {*modes, target}, (*edges, index))

    visit("a", np.array([0.0, np.inf, np.inf]), {"a"}, ())
    return costs


def walked(sequence, graphs, goals, goal_costs):  # type: ignore[no-untyped-def]
    """The cost of the vertices that a sequence reports."""
    motion = sum(
        graphs[mode][i, j]
        for mode, path in zip(sequence.modes, sequence.vertices, strict=True)
        for i, j in itertools.pairwise(path)
    )
    last = sequence.modes[-1]
    ending = goal_costs[last][list(goals[last]).index(sequence.vertices[-1][-1])]
    return motion + ending + TRANSITION_COST * len(sequence.edges)


def test_revisits_only_if_allowed() -> None:
    """From a to b and back: with revisits a cheaper vertex of a is reached through b."""
    graphs = {"a": csr_array(np.zeros((2, 2))), "b": csr_array(np.zeros((1, 1)))}
    exits = {0: np.array([[0, 0]]), 1: np.array([[0, 1]])}
    ends = {0: ("a", "b"), 1: ("b", "a")}
    roadmap = JoinedRoadmap(graphs, exits, ends, ("a", 0), {"a": np.array([1])}, {"a": np.array([0.0])})
    assert cheapest_sequences(roadmap, 1) == []
    (found,) = cheapest_sequences(roadmap, 1, revisits=1)
    assert found.modes == ("a", "b", "a")
    assert found.cost == pytest.approx(2 * TRANSITION_COST)


def test_orders_of_independent_transitions_are_not_all_expanded() -> None:
    """Eight latches to open in any order: 40,320 sequences of equal cost, of which four are asked for."""
    latches = 8
    modes = list(itertools.product((0, 1), repeat=latches))
    name = {q: "".join(map(str, q)) for q in modes}
    pairs = [(q, (*q[:i], 1, *q[i + 1 :])) for q in modes for i in range(latches) if not q[i]]
    graphs = {name[q]: csr_array(np.zeros((1, 1))) for q in modes}
    exits = {i: np.array([[0, 0]]) for i in range(len(pairs))}
    ends = {i: (name[a], name[b]) for i, (a, b) in enumerate(pairs)}
    last = name[modes[-1]]
    roadmap = JoinedRoadmap(graphs, exits, ends, (name[modes[0]], 0), {last: np.array([0])}, {last: np.array([0.0])})
    asked = 0

    def is_over() -> bool:
        nonlocal asked
        asked += 1
        return False

    found = cheapest_sequences(roadmap, 4, is_over=is_over)
    assert [s.cost for s in found] == pytest.approx([latches * TRANSITION_COST] * 4)
    assert len({s.edges for s in found}) == 4
    assert asked < 100


def test_the_time_limit_ends_the_search() -> None:
    problem = planar_problem()
    for asked in (0, 3, 20):
        clock = itertools.count()
        with pytest.raises(TimeLimitError, match="was reached in the search"):
            search_modes(problem, limits_of(problem), "left", deadline=Deadline(asked, lambda clock=clock: next(clock)))


def latched_doors(count: int) -> Problem:
    """Doors that are each latched or open, and so 2^count modes; the first is to be opened."""
    names, n = [f"d{i}" for i in range(count)], count
    modes, edges = [], []
    for number in range(2**count):
        latched = [bool(number >> i & 1) for i in range(count)]
        matrix = np.diag([0.0 if shut else 1.0 for shut in latched])
        pins = tuple(Pin(i, 0.0, 0.005) for i, shut in enumerate(latched) if shut)
        name = format(number, f"0{count}b")
        modes.append(Mode(name, (), tuple(map(tuple, matrix.tolist())), box([0.0] * n, [1.0] * n, n, names), pins=pins))
        for i, shut in enumerate(latched):
            other = format(number ^ (1 << i), f"0{count}b")
            guard = input_above(i, 0.01, n, n, name=names[i]) if shut else below(i, 0.0, n, n, name=names[i])
            edges.append(Edge(name, other, Region((guard,))))
    coordinates = tuple(Coordinate(name, "m") for name in names)
    noise = Noise((0.002,) * n, (0.01,) * n)
    automaton = HybridAutomaton(coordinates, coordinates, (), (), tuple(modes), tuple(edges), noise)
    start = Start((0.0,) * n, (0.005,) * n, "1" * count)
    return Problem(automaton, start, Goal(((0, 0.5, 0.05),)), PlannerSettings(samples_per_mode=30))


def test_of_many_modes_those_near_the_way_are_searched_first() -> None:
    problem = latched_doors(6)
    near = _modes_near_the_way(problem, "111111")
    assert len(near) == 2 * (1 + 5 + 10)  # the first open or not, and at most two others
    found = search(problem, "111111").sequences
    assert found[0].modes == ("111111", "111110")
    for sequence in found:
        edges = [problem.automaton.edges[i] for i in sequence.edges]
        assert [edge.source for edge in edges] == list(sequence.modes[:-1])
        assert [edge.target for edge in edges] == list(sequence.modes[1:])


@pytest.mark.slow
def test_where_no_way_is_near_all_modes_are_searched() -> None:
    """The first door opens only while three others are open, one of which has to be shut again before that: no."""
    problem = latched_doors(6)
    edges = tuple(
        edge
        for edge in problem.automaton.edges
        if not (edge.source[-1] == "1" and edge.target[-1] == "0" and edge.source.count("1") > 3)
    )
    far = replace(problem, automaton=replace(problem.automaton, edges=edges))
    first = search(far, "111111").sequences[0]
    assert len(first.modes) == 5
