"""What one mode leaves where it is and another one moves: met where it is believed, led by a tie once it is caught."""

from __future__ import annotations

import pytest

from micah_plan import execute, solve
from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Link, Mode, Noise, Part, Tie
from micah_plan.automaton.joint import prismatic
from micah_plan.automaton.region import HalfSpace, Region, above, box
from micah_plan.task.goal import Goal
from micah_plan.task.problem import Problem
from micah_plan.task.start import Start

JOINTS = (prismatic((1.0, 0.0, 0.0), (0.0, 0.0, 0.0)), prismatic((1.0, 0.0, 0.0), (0.0, 0.1, 0.0)))
NAMES = ("x", "y")


def automaton(modes: tuple[Mode, ...], edges: tuple[Edge, ...], measured: float = 0.004) -> HybridAutomaton:
    """A hand at x and a part at y; one input moves the hand."""
    x, y = (Coordinate(name, "m") for name in NAMES)
    links = (Link("base", "x", 0), Link("base", "y", 1))
    noise = Noise((0.001, 0.0001), (measured, measured))
    return HybridAutomaton((x, y), (x,), links, (Part("x"), Part("y")), modes, edges, noise)


def gripping(width: float, *asked: HalfSpace) -> Problem:
    """The hand takes hold of a part whose place it sees on the way, from 1 cm to `width` in front of it.

    Args:
        asked: what must hold besides.
    """
    approach = Mode("approach", JOINTS, ((1.0,), (0.0,)), Region(()))
    carry = Mode("carry", JOINTS, ((1.0,), (1.0,)), Region(()))
    near = HalfSpace((1.0, -1.0), (0.0,), -width - 0.01, False, "near")
    not_too_near = HalfSpace((-1.0, 1.0), (0.0,), 0.01, False, "not too near")
    edges = (Edge("approach", "carry", Region((near, not_too_near, *asked))),)
    return Problem(automaton((approach, carry), edges), Start((0.0, 0.4), (0.002, 0.03)), Goal(((1, 0.8, 0.05),)))


@pytest.mark.evidence
def test_a_part_is_met_where_it_is_believed_to_be_and_then_carried() -> None:
    result = solve(gripping(0.02))
    assert result.outcome == "solved", result.reason
    assert result.plan.mode_sequence == ("approach", "carry")
    assert execute(result, trials=100, seed=1).successes >= 95


@pytest.mark.evidence
def test_a_guard_far_narrower_than_what_is_known_is_taken_by_who_passes_through_it() -> None:
    result = solve(gripping(0.0005))
    assert result.outcome == "solved", result.reason
    assert execute(result, trials=40, seed=1).successes >= 37


@pytest.mark.slow
def test_a_guard_on_an_input_that_is_far_narrower_than_the_belief_is_refused() -> None:
    backwards = HalfSpace((0.0, 0.0), (-1.0,), 0.0, True, "backwards")
    assert solve(gripping(0.0005, backwards)).outcome != "solved"


@pytest.mark.sweep
@pytest.mark.parametrize("offset", [0.1, 0.0])
def test_a_transition_puts_what_follows_where_its_tie_says(offset: float) -> None:
    """The part does not move before it is caught; then half of each step of the hand is its own."""
    free = Mode("free", JOINTS, ((1.0,), (0.0,)), box([0.0, -1.0], [0.5, 1.0], 1, list(NAMES)))
    ties = (Tie(1, (0.5, 0.0), offset),)
    led = Mode("led", JOINTS, ((1.0,), (0.5,)), box([0.5, -1.0], [1.0, 1.0], 1, list(NAMES)), ties=ties)
    edges = (Edge("free", "led", Region((above(0, 0.5, 2, 1, name="x"),))),)
    problem = Problem(automaton((free, led), edges), Start((0.1, 0.0), (0.005, 0.005)), Goal(((0, 0.9, 0.03),)))
    result = solve(problem)
    assert result.outcome == "solved", result.reason
    assert execute(result, trials=50, seed=1).successes >= 47
