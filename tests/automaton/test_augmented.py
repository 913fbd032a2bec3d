"""Larger states: coordinates that are added change nothing of the others, and can be taken out again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from automaton_examples import cabinet, detent, door, two_rails

from micah_plan.automaton.augmented import augment_state, fix_augmented_state, mapped
from micah_plan.automaton.hybrid import Coordinate, HybridAutomaton, Mode, Reset
from micah_plan.automaton.region import HalfSpace
from micah_plan.automaton.sensing import Light
from micah_plan.automaton.transition import step


def thrown() -> HybridAutomaton:
    """Two rails with a reset that moves the state and depends on the input, a light and a region of Init."""
    automaton = two_rails()
    first = replace(automaton.edges[0], reset=Reset(((0.9,),), ((0.2,),), (0.05,)))
    noise = replace(automaton.noise, light=Light(((0, 1.0),), (0.3,)))
    init = ((automaton.modes[0].name, automaton.modes[0].invariant),)
    return replace(automaton, edges=(first, *automaton.edges[1:]), noise=noise, init=init)


OBJECTS = {"two rails": two_rails, "door": door, "cabinet": cabinet, "detent": detent, "thrown": thrown}
ADDED = (Coordinate("late", "m"), Coordinate("later", "m"))


@pytest.mark.parametrize("name", OBJECTS)
def test_added_coordinates_stay_and_change_nothing(name: str) -> None:
    automaton, rng = OBJECTS[name](), np.random.default_rng(0)
    whole = augment_state(automaton, ADDED)
    assert whole.coordinates == (*automaton.coordinates, *ADDED)
    assert whole.noise.process_std[automaton.n :] == (0.0, 0.0)
    for mode in automaton.modes:
        assert whole.sensing(whole.mode(mode.name)).std_at(np.zeros(whole.n))[automaton.n :].tolist() == [np.inf] * 2
        for _ in range(20):
            x, u, e = rng.uniform(-0.2, 1.5, automaton.n), rng.uniform(-0.5, 0.5, automaton.m), rng.normal(size=2)
            alone, together = step(automaton, mode.name, x, u), step(whole, mode.name, [*x, *e], u)
            assert together.mode == alone.mode
            assert together.x.tolist() == [*alone.x.tolist(), *e.tolist()]


@pytest.mark.parametrize("name", OBJECTS)
def test_they_can_be_taken_out_again(name: str) -> None:
    automaton = OBJECTS[name]()
    assert fix_augmented_state(augment_state(automaton, ADDED), automaton.n) == automaton
    assert mapped(automaton) == automaton


@pytest.mark.parametrize("name", OBJECTS)
def test_with_values_it_steps_as_the_larger_one_does_from_there(name: str) -> None:
    automaton, rng = OBJECTS[name](), np.random.default_rng(1)
    whole = augment_state(automaton, ADDED, lambda h, _: (0.3 * sum(h.a), -0.2 * sum(h.a)))
    for _ in range(40):
        mode = automaton.modes[rng.integers(len(automaton.modes))].name
        x, u, e = rng.uniform(-0.2, 1.5, automaton.n), rng.uniform(-0.5, 0.5, automaton.m), 0.3 * rng.normal(size=2)
        alone = step(fix_augmented_state(whole, automaton.n, e.tolist()), mode, x, u)
        together = step(whole, mode, [*x, *e], u)
        assert alone.mode == together.mode
        np.testing.assert_allclose(alone.x, together.x[: automaton.n], atol=1e-12)


def test_invariants_and_guards_may_depend_on_them() -> None:
    automaton, seen = thrown(), []

    def weights(half_space: HalfSpace, mode: Mode | None) -> tuple[float, float]:
        seen.append(mode)
        return (0.0, -half_space.a[0]) if mode is None else (half_space.a[0], 0.0)

    whole = augment_state(automaton, ADDED, weights)
    assert {None if mode is None else mode.name for mode in seen} == {None, *automaton.mode_names}
    for own, mode in zip(automaton.modes, whole.modes, strict=True):
        assert [h.a for h in mode.invariant.half_spaces] == [(h.a[0], h.a[0], 0.0) for h in own.invariant.half_spaces]
    for before, edge in zip(automaton.edges, whole.edges, strict=True):
        assert [h.a for h in edge.guard.half_spaces] == [(h.a[0], 0.0, -h.a[0]) for h in before.guard.half_spaces]
    ((_, region),) = whole.init
    assert all(h.a[1:] == (0.0, 0.0) for h in region.half_spaces)
