"""A belief that excludes what is measured begins anew from the measurement, in the modes that allow it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from micah_plan import load
from micah_plan.automaton.hybrid import HybridAutomaton, Pin, Tie
from micah_plan.belief.filter import initial_belief, predict_belief, repeated_belief, update
from micah_plan.belief.hybrid_belief import batch_of
from micah_plan.belief.layout import layout_of
from micah_plan.belief.lost_belief import most_evidence, reinitialise
from micah_plan.belief.truncation import NEGLIGIBLE

STD = 0.01


def slides(**modes: dict) -> HybridAutomaton:
    """Two slides from 0 to 0.5 m; modes may pin or tie them; no place leads from one to the other."""
    joints = {f"part {i}": {"kind": "prismatic", "position": [0, 0, 0], "axis": [1 - i, i, 0]} for i in (0, 1)}
    links = [
        {"parent": parent, "child": f"part {i}", "coordinate": f"c{i}"} for i, parent in ((0, "base"), (1, "part 0"))
    ]
    steps, room = {"c0": "input c0", "c1": "input c1"}, ["c0 >= 0", "c0 <= 0.5", "c1 >= 0", "c1 <= 0.5"]
    other = next(name for name in modes if name != "free")
    automaton = load(
        {
            "coordinates": {"c0": "m", "c1": "m"},
            "inputs": {"c0": "m", "c1": "m"},
            "links": links,
            "noise": {"process_std": {"c0": 0.001, "c1": 0.001}, "observation_std": {"c0": STD, "c1": STD}},
            "modes": {name: {"joints": joints, "step": steps, "invariant": room} for name in modes},
            "transitions": [{"source": "free", "target": other, "guard": ["input c0 >= 1"]}],
        }
    )
    return replace(automaton, modes=tuple(replace(mode, **modes[mode.name]) for mode in automaton.modes))


PINNED = slides(free={}, pinned={"pins": (Pin(1, 0.3, 0.002),)})
FOLLOWING = slides(free={}, pinned={"pins": (Pin(1, 0.0, 0.002, follows=0),)})  # it is where c0 is
TIED = slides(free={}, tied={"ties": (Tie(1, (0.5, 0.0), 0.1),)})


def told(automaton: HybridAutomaton, z: list[float]) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Weights (q,), means (q, n), factors (q, n, n) and log evidence of a belief that begins anew."""
    belief = initial_belief(automaton, [0.1, 0.1], [0.01, 0.02], "free")
    found, evidence = reinitialise(layout_of(automaton), batch_of([belief], np.zeros(0)), np.array(z))
    return found.weights[0], found.means[0], found.factors[0], evidence


@pytest.mark.slow
@pytest.mark.parametrize("automaton", [PINNED, FOLLOWING, TIED], ids=["pinned", "following", "tied"])
def test_its_evidence_is_a_density_of_measurements(automaton: HybridAutomaton) -> None:
    """Over all measurements it sums to what filters drop: one hypothesis, that improbable."""
    axis = np.linspace(-0.05, 0.55, 41)
    total = sum(np.exp(told(automaton, [x, y])[3]) for x in axis for y in axis) * (axis[1] - axis[0]) ** 2
    assert total == pytest.approx(NEGLIGIBLE, rel=0.02)


def test_it_is_where_it_is_measured_in_the_modes_that_allow_it() -> None:
    weights, means, factors, _ = told(PINNED, [0.2, 0.4])
    assert weights == pytest.approx([1.0, 0.0], abs=1e-6)
    assert means[0] == pytest.approx([0.2, 0.4])
    assert np.sqrt(np.diag(factors[0] @ factors[0].T)) == pytest.approx([STD, STD])
    weights, means, factors, _ = told(PINNED, [0.2, 0.303])
    assert weights[1] > 0.9
    assert 0.3 < means[1, 1] < 0.3005
    assert np.linalg.norm(factors[1, 1]) < 0.002
    weights, means, *_ = told(FOLLOWING, [0.2, 0.203])
    assert weights[1] > 0.9
    assert means[1, 1] == pytest.approx(means[1, 0], abs=5e-4)
    assert told(FOLLOWING, [0.2, 0.003])[0][1] < 0.01
    weights, means, *_ = told(TIED, [0.1, 0.152])
    assert weights[1] > 0.9
    assert means[1, 1] == pytest.approx(0.1 + 0.5 * means[1, 0], abs=1e-6)


def test_what_is_not_measured_stays_as_it_was() -> None:
    _, means, factors, _ = told(PINNED, [0.4, np.nan])
    assert means[0] == pytest.approx([0.4, 0.1])
    assert np.linalg.norm(factors[0], axis=1) == pytest.approx([STD, 0.02])


def test_a_likely_measurement_is_no_reason_to_restart_and_the_bound_is_one() -> None:
    layout = layout_of(PINNED)
    rng = np.random.default_rng(0)
    for z in rng.uniform(-0.1, 0.6, (200, 2)):
        assert told(PINNED, list(z))[3] <= most_evidence(layout, z[:, None])[0]
    belief = initial_belief(PINNED, [0.1, 0.1], [0.01, 0.01], "free")
    for away in (0.0, 0.03, 0.05, 0.2):
        after = update(PINNED, predict_belief(PINNED, belief, [0.0, 0.0]), [0.1 + away, 0.1])
        assert after.was_reinitialised == (away > 0.1)


def test_one_and_many_restart_alike() -> None:
    belief = initial_belief(PINNED, [0.1, 0.1], [0.01, 0.01], "free")
    z = np.array([[0.1, 0.1], [0.4, 0.3], [0.45, 0.2]])
    many = update(PINNED, repeated_belief(PINNED, belief, 3), z)
    for number, own in enumerate(z):
        alone = update(PINNED, belief, own)
        assert alone.was_reinitialised == (number > 0)
        some = alone.weights > 0
        np.testing.assert_allclose(many.weights[number], alone.weights, atol=1e-12)
        np.testing.assert_allclose(many.means[number][some], alone.means[some], atol=1e-12)


def test_a_part_that_slipped_away_is_found_where_it_is() -> None:
    """Held for sure, then seen elsewhere: the next steps move it from there."""
    belief = initial_belief(PINNED, [0.1, 0.3], [0.01, 0.001], "pinned")
    belief = update(PINNED, belief, [0.1, 0.1])
    assert belief.was_reinitialised
    assert belief.most_likely == 0
    for k in range(3):
        belief = update(PINNED, predict_belief(PINNED, belief, [0.0, 0.02]), [0.1, 0.1 + 0.02 * (k + 1)])
        assert not belief.was_reinitialised
    assert belief.mean == pytest.approx([0.1, 0.16], abs=0.002)
