"""Thresholds drawn around the model's: one draw per boundary, wherever it bounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from automaton_examples import SHUT, SPLIT, cabinet, detent, door, guard, plain, two_rails

from micah_plan.automaton.drawn_thresholds import drawn_shifts, with_boundaries
from micah_plan.automaton.hybrid import Edge, HybridAutomaton
from micah_plan.automaton.transition import step

STD = 0.02


def blurred(automaton: HybridAutomaton, std: float = STD) -> HybridAutomaton:
    """The automaton with all thresholds between its modes known only so well."""
    edges = (edge if edge.is_self_transition else replace(edge, threshold_std=std) for edge in automaton.edges)
    return replace(automaton, edges=tuple(edges))


def drawn_object(automaton: HybridAutomaton, rng: np.random.Generator) -> HybridAutomaton:
    return with_boundaries(automaton, drawn_shifts(automaton, rng, 1)[0])


def threshold(automaton: HybridAutomaton, name: str) -> float:
    (found,) = {edge.guard.half_spaces[0].c for edge in automaton.edges if edge.name == name}
    return found


def test_certain_thresholds_cost_no_draw() -> None:
    automaton, rng = door(), np.random.default_rng(0)
    assert drawn_object(automaton, rng) is automaton
    assert rng.bit_generator.state == np.random.default_rng(0).bit_generator.state


def test_the_same_seed_draws_the_same() -> None:
    first, again, other = (drawn_object(blurred(cabinet()), np.random.default_rng(s)) for s in (1, 1, 2))
    assert first == again != other


def test_a_latch_moves_as_a_whole() -> None:
    automaton = blurred(door())
    drawn = drawn_object(automaton, np.random.default_rng(3))
    at = threshold(drawn, "revolute -> rigid")
    assert abs(at - SHUT) > 1e-3
    moving, shut = drawn.modes
    assert moving.invariant.half_spaces[1].c == pytest.approx(-at)
    assert moving.invariant.half_spaces[0].c == 0.0
    assert shut.pins[0].value == pytest.approx(at)
    widths = [np.array([h.c for h in a.modes[1].invariant.half_spaces]) for a in (automaton, drawn)]
    assert widths[1] - widths[0] == pytest.approx([at - SHUT, SHUT - at])
    assert [e.guard for e in drawn.edges[1:]] == [e.guard for e in automaton.edges[1:]]
    after = step(drawn, "revolute", [1.1], [0.3])
    assert (after.mode, after.x) == ("rigid", pytest.approx([at]))


def test_both_ways_through_a_boundary_move_together() -> None:
    drawn = drawn_object(blurred(two_rails()), np.random.default_rng(4))
    there, back = threshold(drawn, "prismatic_1 -> prismatic_2"), threshold(drawn, "prismatic_2 -> prismatic_1")
    assert there == pytest.approx(-back)
    assert there != pytest.approx(SPLIT, abs=1e-3)
    assert drawn.modes[0].invariant.half_spaces[1].c == pytest.approx(-there)
    assert drawn.modes[1].invariant.half_spaces[0].c == pytest.approx(there)


def test_a_detent_between_two_slides_is_one_boundary() -> None:
    drawn = drawn_object(blurred(detent()), np.random.default_rng(5))
    at = threshold(drawn, "prismatic_1 -> rigid")
    assert at == pytest.approx(-threshold(drawn, "prismatic_2 -> rigid")) == drawn.mode("rigid").pins[0].value


def test_a_boundary_is_the_same_in_every_mode_of_a_product_and_others_are_their_own() -> None:
    drawn = drawn_object(blurred(cabinet()), np.random.default_rng(6))
    latch = {threshold(drawn, f"revolute/prismatic_{k} -> rigid/prismatic_{k}") for k in (1, 2)}
    rail = {threshold(drawn, f"{m}/prismatic_1 -> {m}/prismatic_2") for m in ("revolute", "rigid")}
    assert len(latch) == len(rail) == 1
    assert latch.pop() - SHUT != pytest.approx(rail.pop() - SPLIT, abs=1e-4)
    assert {pin.value for mode in drawn.modes for pin in mode.pins} == {threshold(drawn, "revolute/prismatic_1 -> "
                                                                                   "rigid/prismatic_1")}  # fmt: skip


def test_draws_have_the_stated_std() -> None:
    automaton, rng = blurred(door()), np.random.default_rng(7)
    drawn = [threshold(drawn_object(automaton, rng), "revolute -> rigid") for _ in range(2000)]
    assert np.mean(drawn) == pytest.approx(SHUT, abs=4 * STD / np.sqrt(2000))
    assert np.std(drawn) == pytest.approx(STD, rel=4 / np.sqrt(2 * 2000))


def test_a_half_space_of_any_scale_moves_in_its_own_unit() -> None:
    edge = Edge("a", "b", guard(([2.0, 1.0], [0.0, 0.0], 3.0)), threshold_std=STD)
    back = Edge("b", "a", guard(([-4.0, -2.0], [0.0, 0.0], -6.0, True)), threshold_std=2 * STD)
    eye = [[1.0, 0.0], [0.0, 1.0]]
    drawn = drawn_object(plain({"a": eye, "b": eye}, [edge, back]), np.random.default_rng(8))
    there, again = (e.guard.half_spaces[0].c for e in drawn.edges)
    assert -2 * there == pytest.approx(again)
    assert there - 3.0 == pytest.approx(STD * np.random.default_rng(8).standard_normal())
