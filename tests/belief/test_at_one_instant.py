"""Transitions that an input opens happen before the state moves; of those that hold there the first listed does."""

from __future__ import annotations

import numpy as np
import pytest
from reference.hybrid_step import step

from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Link, Mode, Noise, Part
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.region import Region, above, below, box, input_below
from micah_plan.belief.filter import initial_belief, predict_belief, repeated_belief

SLIDE = (Joint("prismatic", (0.0, 0.0, 0.0), axis=(0.0, 0.0, 1.0)),)
OPENS = input_below(1, -0.5, 1, 2, strict=True, name="input grip")


def hand(*guards: tuple[str, Region], process: float = 0.0) -> HybridAutomaton:
    """A hand at z that holds, and what its grip opens to, in order."""
    held = Mode("held", SLIDE, ((1.0, 0.0),), box([-1.0], [1.0], 2, ["z"]))
    others = [Mode(name, SLIDE, ((gain, 0.0),)) for name, gain in (("stands", 1.0), ("dropped", 0.0), ("thrown", 1.0))]
    edges = tuple(Edge("held", target, guard) for target, guard in guards)
    coordinates = (Coordinate("z", "m"),)
    inputs = (Coordinate("z", "m"), Coordinate("grip", "m"))
    links, noise = (Link("base", "hand", 0),), Noise((process,), (0.003,))
    return HybridAutomaton(coordinates, inputs, links, (Part("hand"),), (held, *others), edges, noise)


HIGH = Region((OPENS, above(0, 0.005, 1, 2, strict=True, name="z")))
BETWEEN = Region((OPENS, above(0, 0.004, 1, 2, name="z"), below(0, 0.008, 1, 2, name="z")))
ALWAYS = Region((OPENS,))
TOUCH = Region((below(0, 0.0, 1, 2, name="z"),))
CASES = {
    "high first": (("dropped", HIGH), ("stands", ALWAYS)),
    "always first": (("stands", ALWAYS), ("dropped", HIGH)),
    "a band, then high": (("thrown", BETWEEN), ("dropped", HIGH), ("stands", ALWAYS)),
    "a touch beside": (("thrown", TOUCH), ("dropped", HIGH), ("stands", ALWAYS)),
}


@pytest.mark.sweep
@pytest.mark.parametrize("way", [0.02, -0.02, 0.0])
@pytest.mark.parametrize("mean", [0.001, 0.0045, 0.02])
@pytest.mark.parametrize("case", CASES)
def test_the_filter_is_the_automatons_own_step(case: str, mean: float, way: float) -> None:
    automaton, rng, std = hand(*CASES[case]), np.random.default_rng(0), 0.002
    belief, u = initial_belief(automaton, [mean], [std], "held"), [way, -1.0]
    # What lies behind the boundary at which a mode is left is the tail of a fit, no state.
    starts = mean + std * rng.standard_normal(4000)
    starts = starts[starts > 0.0] if case == "a touch beside" else starts
    ends = [step(automaton, "held", [z], u) for z in starts]
    after = predict_belief(automaton, belief, u)
    for number, name in enumerate(automaton.mode_names):
        own = np.array([end.x[0] for end in ends if end.mode == name])
        assert after.weights[number] == pytest.approx(len(own) / len(ends), abs=0.03), name
        if len(own) > 200 and case != "a touch beside":  # the filter keeps that tail
            assert after.means[number, 0] == pytest.approx(own.mean(), abs=2e-4), name
    both = predict_belief(automaton, repeated_belief(automaton, belief, 2), np.array([u, u]))
    assert both.weights[0] == pytest.approx(after.weights)


def test_without_that_input_nothing_changes() -> None:
    automaton = hand(*CASES["high first"])
    after = predict_belief(automaton, initial_belief(automaton, [0.02], [0.002], "held"), [0.01, 0.0])
    assert after.weights == pytest.approx([1.0, 0.0, 0.0, 0.0])
