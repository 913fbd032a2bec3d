"""Random automata that the check accepts go through everything that reads a model, or are refused in words."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from micah_plan.automaton.check import check_automaton
from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Link, Mode, Noise, Part, Pin, Reset
from micah_plan.automaton.joint import prismatic, revolute
from micah_plan.automaton.region import HalfSpace, Region
from micah_plan.automaton.transition import step
from micah_plan.belief.filter import initial_belief, predict, update
from micah_plan.documents.model import dump_model, load_model
from micah_plan.errors import InputError
from micah_plan.planning.pomdp_hd import plan
from micah_plan.task.goal import Goal
from micah_plan.task.problem import Problem
from micah_plan.task.settings import PlannerSettings
from micah_plan.task.start import Start
from micah_plan.view.model_page import model_page

WEIGHTS = (-1.0, 0.0, 0.0, 0.5, 1.0)


@st.composite
def half_spaces(draw: st.DrawFn, n: int, m: int, most: int) -> Region:
    """Up to `most` half-spaces on states, inputs or both; often none at all, so that nothing is bounded."""
    rows = []
    for number in range(draw(st.integers(0, most))):
        a = tuple(draw(st.sampled_from(WEIGHTS)) for _ in range(n))
        b = tuple(draw(st.sampled_from(WEIGHTS)) for _ in range(m)) if draw(st.booleans()) else (0.0,) * m
        if any(a) or any(b):
            rows.append(
                HalfSpace(a, b, draw(st.sampled_from((-1.0, -0.2, 0.0, 0.3))), draw(st.booleans()), f"h{number}")
            )
    return Region(tuple(rows))


@st.composite
def automata(draw: st.DrawFn) -> HybridAutomaton:
    n, q = draw(st.integers(1, 2)), draw(st.integers(1, 3))
    turns = [draw(st.booleans()) for _ in range(n)]
    joints = tuple(
        revolute((0, 0, 1), (0, 0, 0), (0.3, 0, 0)) if turn else prismatic((1, 0, 0), (0, 0, 0)) for turn in turns
    )
    modes = []
    for number in range(q):
        rows = tuple(tuple(draw(st.sampled_from(WEIGHTS)) for _ in range(n)) for _ in range(n))
        pins = (Pin(0, draw(st.sampled_from((0.0, 0.3))), 0.001),) if draw(st.integers(0, 3)) == 0 else ()
        rows = ((0.0,) * n, *rows[1:]) if pins else rows
        modes.append(Mode(f"mode {number}", joints, rows, draw(half_spaces(n, n, 2)), pins=pins))
    edges = []
    chain = [(number, number + 1) for number in range(q - 1)]
    for source, target in chain + draw(st.lists(st.tuples(st.integers(0, q - 1), st.integers(0, q - 1)), max_size=3)):
        guard = draw(half_spaces(n, n, 2))
        reset = Reset.to({0: draw(st.sampled_from((0.0, 0.3)))}, n) if draw(st.booleans()) else Reset()
        edges.append(Edge(f"mode {source}", f"mode {target}", guard, reset))
    return HybridAutomaton(
        coordinates=tuple(Coordinate(f"c{i}", "rad" if turn else "m") for i, turn in enumerate(turns)),
        inputs=tuple(Coordinate(f"c{i}", "rad" if turn else "m") for i, turn in enumerate(turns)),
        links=tuple(Link("base" if i == 0 else f"part {i - 1}", f"part {i}", i) for i in range(n)),
        parts=tuple(Part(f"part {i}") for i in range(n)),
        modes=tuple(modes),
        edges=tuple(edges),
        noise=Noise((0.001,) * n, (0.005,) * n),
    )


def goes_through(automaton: HybridAutomaton, seed: int, folder: str) -> bool:
    """Whether the check accepts it; all that comes after may refuse a use of it, in words."""
    try:
        check_automaton(automaton)
    except InputError:
        return False
    path = f"{folder}/model.yaml"
    dump_model(automaton, path)
    assert load_model(path) == automaton
    rng, n = np.random.default_rng(seed), automaton.n
    x, mode = rng.uniform(-0.2, 0.2, n), automaton.modes[0].name
    for _ in range(5):
        reached = step(automaton, mode, x, rng.uniform(-0.3, 0.3, n), 0.001 * rng.standard_normal(n))
        x, mode = np.array(reached.x), reached.mode
        assert np.isfinite(x).all()
        assert mode in automaton.mode_names
    try:
        belief = initial_belief(automaton, np.zeros(n), np.full(n, 0.02))
        for _ in range(3):
            belief = update(automaton, predict(automaton, belief, rng.uniform(-0.1, 0.1, n)), rng.normal(0, 0.02, n))
        assert belief.weights.sum() == pytest.approx(1.0)
        assert all(np.linalg.eigvalsh(factor @ factor.T).min() >= -1e-12 for factor in belief.factors)
        problem = Problem(
            automaton,
            Start((0.0,) * n, (0.02,) * n),
            Goal(((0, 0.2, 0.05),), ()),
            settings=replace(PlannerSettings(), max_knots=20, samples_per_mode=20, max_step=(0.1,) * n),
        )
        found = plan(problem, seed)
        assert found.reason
        assert (found.trajectory is not None) == (found.outcome == "solved")
    except InputError:
        pass
    assert "<html" in model_page(automaton)
    return True


@settings(max_examples=40, deadline=None, derandomize=True)
@given(automata(), st.integers(0, 1000))
def test_what_the_check_accepts_everything_takes(tmp_path_factory: pytest.TempPathFactory, automaton, seed) -> None:
    goes_through(automaton, seed, str(tmp_path_factory.mktemp("model")))


@pytest.mark.slow
@settings(max_examples=1000, deadline=None, derandomize=True)
@given(automata(), st.integers(0, 1000))
def test_a_thousand_of_them(tmp_path_factory: pytest.TempPathFactory, automaton, seed) -> None:
    goes_through(automaton, seed, str(tmp_path_factory.mktemp("model")))
