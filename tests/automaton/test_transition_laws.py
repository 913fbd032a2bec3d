"""Laws of the transition logic on random automata: a naive simulation, splitting of steps, invariants, bounds."""

from __future__ import annotations

import numpy as np
import pytest
from automaton_examples import cabinet, chain, detent, naive
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import hybrid_step

from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.graph import KinematicEdge, KinematicGraph
from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Link, Mode, Noise, Part, Pin, Reset, Tie
from micah_plan.automaton.joint import prismatic
from micah_plan.automaton.region import HalfSpace, Region
from micah_plan.automaton.transition import Step, simulate, step

lawful = settings(max_examples=120)
finite = {"allow_nan": False, "allow_infinity": False}
# Inputs below the tolerance of a margin count as none, unlike in the naive simulation.
_inputs = st.floats(-2.5, 2.5, **finite).map(lambda u: round(u, 6))


@st.composite
def edges(draw: st.DrawFn, name: str) -> KinematicEdge:
    """A chain of one to four models, with rigid ones at the ends or between; thresholds may be round numbers."""
    kinds = draw(
        st.sampled_from(
            [
                ["prismatic"],
                ["prismatic", "prismatic"],
                ["prismatic", "rigid"],
                ["rigid", "prismatic"],
                ["prismatic", "rigid", "prismatic"],
                ["rigid", "prismatic", "prismatic", "rigid"],
                ["prismatic", "prismatic", "prismatic"],
            ]
        )
    )
    bounds = [0.0]
    for kind in kinds:
        length = draw(st.one_of(st.sampled_from([0.1, 0.2, 0.5]), st.floats(0.1, 1.0, **finite)))
        bounds.append(bounds[-1] + (0.0 if kind == "rigid" else length))
    return chain(name, bounds, kinds)


@st.composite
def situations(draw: st.DrawFn, release: float | None = None) -> tuple[HybridAutomaton, str, np.ndarray, np.ndarray]:
    """An automaton of one or two links, a mode, a state in its invariant (also on its boundary) and an input."""
    names = ["a", "b"][: draw(st.integers(1, 2))]
    graph = KinematicGraph(tuple(draw(edges(name)) for name in names))
    automaton = build_automaton(graph, release=draw(st.sampled_from([0.0, 0.3])) if release is None else release)
    mode = draw(st.sampled_from(automaton.modes))
    x, u = [], []
    for i in range(automaton.n):
        bounds = [h.c * h.a[i] for h in mode.invariant.half_spaces if h.a[i]]
        x.append(
            bounds[0] + draw(st.one_of(st.sampled_from([0.0, 0.5, 1.0]), st.floats(0, 1))) * (bounds[1] - bounds[0])
        )
        u.append(draw(st.one_of(st.sampled_from([0.0, 0.1, -0.1, 0.5, -0.5]), _inputs)))
    for pin in mode.pins:
        x[pin.coordinate] = pin.value
    return automaton, mode.name, np.array(x), np.array(u)


def pushes(automaton: HybridAutomaton, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, 0.2, automaton.n)


def assert_in_invariant(automaton: HybridAutomaton, result: Step) -> None:
    assert automaton.mode(result.mode).invariant.contains(result.x, np.zeros(automaton.m), tolerance=1e-9), result


class TestOnRandomObjects:
    @pytest.mark.slow
    @given(situations(), st.integers(0, 1000))
    @settings(max_examples=40)
    def test_a_naive_simulation_on_a_fine_grid_ends_nearby(
        self, situation: tuple[HybridAutomaton, str, np.ndarray, np.ndarray], seed: int
    ) -> None:
        automaton, mode, x, u = situation
        # Not against the input: there the state rests on a boundary, and the naive step trembles around it.
        w = np.sign(u) * np.abs(pushes(automaton, seed))
        cuts = 400
        result = step(automaton, mode, x, u, w)
        naive_mode, naive_x = naive(automaton, mode, x, u, w, cuts)
        resolution = 4 * np.abs(u + w).max() / cuts + 1e-9
        np.testing.assert_allclose(result.x, naive_x, atol=resolution)
        thresholds = [h.c * h.a[i] for e in automaton.edges for h in e.guard.half_spaces for i in range(automaton.n)]
        if min((abs(xi - t) for xi in result.x for t in thresholds), default=1.0) > 2 * resolution:
            assert result.mode == naive_mode

    @pytest.mark.slow
    @given(situations(release=0.0), st.floats(0.01, 0.99))
    @lawful
    def test_two_parts_of_a_step_end_where_the_whole_does(
        self, situation: tuple[HybridAutomaton, str, np.ndarray, np.ndarray], share: float
    ) -> None:
        automaton, mode, x, u = situation
        whole = step(automaton, mode, x, u)
        first = step(automaton, mode, x, share * u)
        second = step(automaton, first.mode, first.x, (1 - share) * u)
        assert second.mode == whole.mode
        np.testing.assert_allclose(second.x, whole.x, atol=1e-9)

    @pytest.mark.slow
    @given(situations(), st.integers(0, 1000))
    @lawful
    def test_the_state_ends_in_the_invariant_of_its_mode(
        self, situation: tuple[HybridAutomaton, str, np.ndarray, np.ndarray], seed: int
    ) -> None:
        automaton, mode, x, u = situation
        assert_in_invariant(automaton, step(automaton, mode, x, u))
        assert_in_invariant(automaton, step(automaton, mode, x, u, pushes(automaton, seed)))

    @pytest.mark.slow
    @given(situations(), st.integers(0, 1000))
    @lawful
    def test_events_are_few_ordered_and_justified(
        self, situation: tuple[HybridAutomaton, str, np.ndarray, np.ndarray], seed: int
    ) -> None:
        automaton, mode, x, u = situation
        result = step(automaton, mode, x, u, pushes(automaton, seed))
        assert result.complete
        assert len(result.events) <= 2 * len(automaton.modes) + 2 * automaton.n
        fractions = [event.fraction for event in result.events]
        assert fractions == sorted(fractions)
        assert all(0.0 <= fraction <= 1.0 for fraction in fractions)
        now = mode
        for event in result.events:
            edge = automaton.edges[event.edge]
            assert (event.source, event.target) == (edge.source, edge.target) == (now, event.target)
            assert edge.guard.contains(event.x_before, u, tolerance=1e-9)
            after = edge.reset.apply(event.x_before, u)
            np.testing.assert_allclose(event.x_after, after, atol=1e-9)
            now = event.target
        assert now == result.mode

    @given(situations(), st.integers(0, 1000))
    @settings(max_examples=40)
    def test_the_same_step_twice_is_the_same_bit_for_bit(
        self, situation: tuple[HybridAutomaton, str, np.ndarray, np.ndarray], seed: int
    ) -> None:
        automaton, mode, x, u = situation
        first, second = (step(automaton, mode, x, u, pushes(automaton, seed)) for _ in range(2))
        assert first.mode == second.mode
        np.testing.assert_array_equal(first.x, second.x)
        assert [(e.edge, e.fraction) for e in first.events] == [(e.edge, e.fraction) for e in second.events]


class TestSimulate:
    def test_is_step_after_step(self) -> None:
        automaton, rng = cabinet(), np.random.default_rng(5)
        inputs, disturbances = rng.uniform(-0.4, 0.4, (200, 2)), rng.normal(0, 0.05, (200, 2))
        run = simulate(automaton, "revolute/prismatic_1", [0.3, 0.1], inputs, disturbances)
        mode, x, events = "revolute/prismatic_1", np.array([0.3, 0.1]), 0
        for k in range(200):
            result = step(automaton, mode, x, inputs[k], disturbances[k])
            mode, x, events = result.mode, result.x, events + len(result.events)
            assert run.modes[k + 1] == mode
            np.testing.assert_array_equal(run.states[k + 1], x)
        assert len(run.events) == events > 100
        assert set(run.modes) == {m.name for m in automaton.modes}

    def test_no_steps(self) -> None:
        run = simulate(cabinet(), "rigid/prismatic_2", [1.2, 0.3], np.zeros((0, 2)))
        assert (run.modes, run.events, run.complete) == (("rigid/prismatic_2",), (), True)
        np.testing.assert_array_equal(run.states, [[1.2, 0.3]])

    @pytest.mark.parametrize("cuts", [1, 2, 7, 50])
    def test_the_number_of_steps_does_not_matter(self, cuts: int) -> None:
        run = simulate(detent(), "prismatic_1", [0.05], np.full((cuts, 1), 0.3 / cuts))
        assert run.modes[-1] == "prismatic_2"
        assert run.states[-1] == pytest.approx([0.35], abs=1e-12)
        assert [event.target for _, event in run.events] == ["rigid", "prismatic_2"]


@pytest.mark.slow
def test_10_000_random_steps_are_those_of_the_reference() -> None:
    """Of automata whose guards, resets, pins and ties chain, chatter and meet at walls."""
    rng, events, walls = np.random.default_rng(0), 0, 0
    for _ in range(250):
        automaton = tangled(rng)
        for _ in range(40):
            mode = automaton.modes[int(rng.integers(len(automaton.modes)))].name
            x, pushed = rng.choice(PLACES, automaton.n), rng.choice([0.0, 0.01], automaton.n)
            u = rng.choice([0.0, 0.5, -0.5, 1.0, -1.0], automaton.m)
            ours, theirs = step(automaton, mode, x, u, pushed), hybrid_step.step(automaton, mode, x, u, pushed)
            assert (ours.mode, ours.complete) == (theirs.mode, theirs.complete)
            assert [one.edge for one in ours.events] == [one.edge for one in theirs.events]
            assert ours.x == pytest.approx(theirs.x, abs=1e-9)
            for one, other in zip(ours.events, theirs.events, strict=True):
                assert one.fraction == pytest.approx(other.fraction, abs=1e-9)
                assert one.x_after == pytest.approx(other.x_after, abs=1e-9)
            events += len(ours.events)
            walls += not ours.events and not np.allclose(ours.x - x, automaton.mode(mode).B @ u + pushed)
    assert events > 3000
    assert walls > 100


PLACES = (0.0, 0.25, 0.5, 0.75, 1.0)


def tangled(rng: np.random.Generator) -> HybridAutomaton:
    """A random automaton: nothing about it need make sense."""
    n, q = int(rng.integers(1, 4)), int(rng.integers(1, 4))
    coordinates = tuple(Coordinate(f"c{i}", "m") for i in range(n))
    joints = tuple(prismatic((1.0, 0.0, 0.0), (0.0, 0.0, 0.0)) for _ in range(n))
    links = tuple(Link("base", f"part {i}", i) for i in range(n))
    modes = []
    for number in range(q):
        pins = (Pin(0, float(rng.choice(PLACES)), 0.001),) if rng.random() < 0.2 else ()
        weights = (0.0, *rng.choice([0.0, 1.0, -0.5], n - 1).tolist())
        ties = (Tie(0, weights, 0.1),) if not pins and n > 1 and rng.random() < 0.2 else ()
        B = np.where(np.arange(n)[:, None] < len(pins) + len(ties), 0.0, rng.choice([0.0, 1.0, 1.0, -1.0], (n, n)))
        modes.append(Mode(f"mode {number}", joints, tuple(map(tuple, B.tolist())), Region(), Region(), pins, ties=ties))
    edges = []
    for _ in range(int(rng.integers(1, 6))):
        source, target = rng.integers(q, size=2)
        rows = []
        for k in range(int(rng.integers(1, 3))):
            a, b = rng.choice([0.0, 1.0, -1.0, 0.5], n), rng.choice([0.0, 0.0, 1.0], n)
            a[k % n] = a[k % n] or 1.0
            rows.append(
                HalfSpace(
                    tuple(a.tolist()), tuple(b.tolist()), float(rng.choice(PLACES)), bool(rng.random() < 0.5), f"h{k}"
                )
            )
        puts = {int(rng.integers(n)): float(rng.choice(PLACES))} if rng.random() < 0.5 else {}
        edges.append(
            Edge(f"mode {source}", f"mode {target}", Region(tuple(rows)), Reset.to(puts, n) if puts else Reset())
        )
    return HybridAutomaton(
        coordinates, coordinates, links, tuple(Part(f"part {i}") for i in range(n)), tuple(modes), tuple(edges),
        Noise((0.0,) * n, (0.01,) * n),
    )  # fmt: skip
