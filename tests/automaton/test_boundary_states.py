"""Boundaries as states: a step of (x, s) is a step of x by the object whose boundaries are shifted by s."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from automaton_examples import cabinet, detent, door, guard, plain, two_rails
from hypothesis import given, settings
from hypothesis import strategies as st
from reference.hybrid_step import step

from micah_plan.automaton.drawn_thresholds import (
    boundaries_of_pins,
    boundary_of,
    boundary_stds,
    threshold_stds,
    with_boundaries,
    with_boundary_states,
)
from micah_plan.automaton.effects.add import with_effect
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.hybrid import Edge, HybridAutomaton, Mode, Reset
from micah_plan.automaton.input_memory import with_memory_states
from micah_plan.automaton.region import HalfSpace
from micah_plan.automaton.transition import TransitionBatch


def blurred(automaton: HybridAutomaton, std: float = 0.03) -> HybridAutomaton:
    """Thresholds on the state known to `std`; pins at them no better."""
    edges = tuple(edge if edge.is_self_transition else replace(edge, threshold_std=std) for edge in automaton.edges)
    modes = tuple(replace(q, pins=tuple(replace(p, std=max(p.std, std)) for p in q.pins)) for q in automaton.modes)
    return replace(automaton, edges=edges, modes=modes)


def thrown() -> HybridAutomaton:
    """Two rails with a reset that moves the state and depends on the input."""
    automaton = two_rails()
    first = replace(automaton.edges[0], reset=Reset(((0.9,),), ((0.2,),), (0.05,)))
    return replace(automaton, edges=(first, *automaton.edges[1:]))


def shifted_object(automaton: HybridAutomaton, by: np.ndarray) -> HybridAutomaton:
    """The reference: each half-space and pin at an uncertain boundary moved by itself, no state added."""
    shifts = dict(zip(boundary_stds(automaton), by.tolist(), strict=True))

    def moved(h: HalfSpace, at: dict[int, tuple[float, ...]]) -> HalfSpace:
        boundary, scale = boundary_of(h)
        if boundary not in shifts and h.bound is not None:
            boundary, scale = at.get(h.bound.coordinate, ()), h.a[h.bound.coordinate]
        return h.moved(scale * shifts.get(boundary, 0.0))

    def moved_mode(mode: Mode) -> Mode:
        at = boundaries_of_pins(automaton, mode)
        pins = tuple(replace(p, value=p.value + shifts.get(at.get(p.coordinate, ()), 0.0)) for p in mode.pins)
        return replace(mode, pins=pins, invariant=mode.invariant.mapped(lambda h: moved(h, at)))

    edges = (replace(edge, guard=edge.guard.mapped(lambda h: moved(h, {}))) for edge in automaton.edges)
    return replace(automaton, modes=tuple(map(moved_mode, automaton.modes)), edges=tuple(edges))


OBJECTS = {"two rails": two_rails, "door": door, "cabinet": cabinet, "detent": detent, "thrown": thrown}


@pytest.mark.sweep
@pytest.mark.parametrize("name", OBJECTS)
@settings(max_examples=25)
@given(seed=st.integers(0, 10_000))
def test_a_step_is_that_of_the_shifted_object(name: str, seed: int) -> None:
    automaton, rng = blurred(OBJECTS[name]()), np.random.default_rng(seed)
    whole, n = with_boundary_states(automaton), automaton.n
    shift = 0.03 * rng.standard_normal(threshold_stds(automaton).size)
    object_ = shifted_object(automaton, shift)
    assert with_boundaries(automaton, shift) == object_
    mode, x = automaton.modes[rng.integers(len(automaton.modes))].name, rng.uniform(-0.1, 1.3, n)
    for mine, other in zip(whole.modes, object_.modes, strict=True):
        margins = mine.invariant.margins(np.concatenate([x, shift]), np.zeros(automaton.m))
        np.testing.assert_allclose(margins, other.invariant.margins(x, np.zeros(automaton.m)), atol=1e-12)
    for _ in range(12):
        u = rng.uniform(-0.3, 0.3, automaton.m)
        expected = step(object_, mode, x, u)
        found = step(whole, mode, np.concatenate([x, shift]), u)
        assert found.mode == expected.mode
        np.testing.assert_allclose(found.x[:n], expected.x, atol=1e-12)
        assert np.array_equal(found.x[n:], shift)
        mode, x = expected.mode, expected.x


def test_the_state_slides_along_an_uncertain_boundary_and_leaves_it_where_it_is() -> None:
    half_spaces = guard(([1.0, 0.5], [0.0, 0.0], 0.0)), guard(([-1.0, -0.5], [0.0, 0.0], 0.0, True))
    edges = [Edge(*names, region, threshold_std=0.1) for names, region in zip(("ab", "ba"), half_spaces, strict=True)]
    facing = plain({"a": [[1.0, 0.0], [0.0, 1.0]], "b": [[-1.0, 0.0], [0.0, 0.5]]}, edges)
    shift = np.array([0.07])
    expected = step(shifted_object(facing, shift), "a", [-0.25, 0.0], [1.0, 0.2])
    assert expected.mode == "b"
    assert expected.x @ [1.0, 0.5] == pytest.approx(0.07)
    found = step(with_boundary_states(facing), "a", [-0.25, 0.0, *shift], [1.0, 0.2])
    np.testing.assert_allclose(found.x, [*expected.x, *shift], atol=1e-12)
    _, together = TransitionBatch(facing, shift[None]).step(
        np.zeros(1, dtype=int), np.array([[-0.25, 0.0]]), np.array([[1.0, 0.2]]), np.zeros((1, 2))
    )
    np.testing.assert_allclose(together[0], expected.x, atol=1e-12)


def test_pins_at_a_boundary_follow_it_and_share_their_std_with_it() -> None:
    automaton = blurred(door(), 0.03)
    (pin,) = automaton.modes[1].pins
    automaton = replace(
        automaton, modes=(automaton.modes[0], replace(automaton.modes[1], pins=(replace(pin, std=0.05),)))
    )
    (found,) = with_boundary_states(automaton).modes[1].pins
    assert found.follows == automaton.n
    assert found.std == pytest.approx(0.04)


@pytest.mark.parametrize("name", OBJECTS)
def test_a_memory_of_inputs_and_known_boundaries_do_not_depend_on_their_order(name: str) -> None:
    automaton = blurred(OBJECTS[name]())
    late = Effect("delay", automaton.coordinate_names[0], (("steps", 1.4),))
    edges = tuple(replace(edge, reset=Reset()) for edge in automaton.edges if not edge.is_self_transition)
    automaton = with_effect(replace(automaton, edges=edges), late)
    by = np.linspace(-0.02, 0.03, threshold_stds(automaton).size)
    stds = 0.5 * threshold_stds(automaton)
    whole = with_memory_states(automaton)
    assert whole.n > automaton.n
    assert with_boundaries(whole, by, stds) == with_memory_states(with_boundaries(automaton, by, stds))


def test_a_certain_automaton_is_left_alone() -> None:
    assert with_boundary_states(automaton := door()) is automaton
    uncertain = blurred(door())
    assert with_boundary_states(uncertain) is with_boundary_states(uncertain)
