"""What beliefs make of a joint whose lever is known only so well, and that it is what objects then do."""

from __future__ import annotations

import numpy as np
import pytest
from uncertain_joints import unsure_door

from micah_plan.automaton.step_noise import drawn_gains
from micah_plan.automaton.transition import TransitionBatch
from micah_plan.belief import filter as batch
from micah_plan.belief.filter import initial_belief, predict_belief, update

GAIN = 0.1


def test_a_step_adds_noise_in_proportion_to_the_motion() -> None:
    automaton = unsure_door(GAIN, process=0.002)
    start = initial_belief(automaton, [0.1], [0.01], "swing")
    for u in (0.0, 0.05, -0.2):
        after = predict_belief(automaton, start, [u])
        assert after.covariance[0, 0] == pytest.approx(0.01**2 + 0.002**2 + (GAIN * u) ** 2, rel=1e-9)


def test_a_freed_coordinate_moves_as_uncertainly() -> None:
    automaton = unsure_door(GAIN, process=0.0)
    latched = initial_belief(automaton, [0.6], [0.0], "shut")
    free = predict_belief(automaton, latched, [-0.2])
    assert free.weights == pytest.approx([1.0, 0.0])
    known = latched.covariance[0, 0]
    assert free.covariance[0, 0] == pytest.approx(known + (GAIN * 0.2) ** 2, rel=1e-6)


def test_certain_levers_change_nothing() -> None:
    without, exact = unsure_door(None), unsure_door(0.0)
    beliefs = [initial_belief(automaton, [0.3], [0.05], "swing") for automaton in (without, exact)]
    for u in (0.1, 0.15, 0.1, -0.1):
        beliefs = [predict_belief(a, b, [u]) for a, b in zip((without, exact), beliefs, strict=True)]
        assert np.array_equal(beliefs[0].weights, beliefs[1].weights)
        assert np.array_equal(beliefs[0].factors, beliefs[1].factors)


def test_many_beliefs_at_once_are_those_of_the_filter() -> None:
    automaton, rng = unsure_door(GAIN), np.random.default_rng(0)
    one = initial_belief(automaton, [0.3], [0.05], "swing")
    alone, together = [one] * 6, batch.repeated_belief(automaton, one, 6)
    for _ in range(6):
        u, z = rng.uniform(-0.1, 0.2, (6, 1)), rng.uniform(0.2, 0.7, (6, 1))
        alone = [update(automaton, predict_belief(automaton, b, u[i]), z[i]) for i, b in enumerate(alone)]
        together = batch.update(automaton, batch.predict_belief(automaton, together, u), z)
        assert together.weights == pytest.approx(np.array([b.weights for b in alone]), abs=1e-9)
        merged_moments = np.einsum("tq,tqn->tn", together.weights, together.means)
        assert merged_moments == pytest.approx(np.array([b.mean for b in alone]), abs=1e-9)
        spread = np.einsum("tq,tqij->tij", together.weights, together.factors)
        assert spread == pytest.approx(
            np.array([np.einsum("q,qij->ij", b.weights, b.factors) for b in alone]), abs=1e-9
        )


def normalised_errors(believed: float, true: float, steps: int, objects: int = 400) -> float:
    """Mean squared error of the filter over its variance: objects with gains of std `true`, measured at every step."""
    model, world = unsure_door(believed), unsure_door(true)
    rng = np.random.default_rng(7)
    shifts = np.zeros((objects, 1))
    truth = TransitionBatch(world, shifts, drawn_gains(world, rng, objects))
    modes, x = np.zeros(objects, dtype=int), 0.01 * rng.normal(size=(objects, 1)) - 2.0
    beliefs = batch.repeated_belief(model, initial_belief(model, [-2.0], [0.01], "swing"), objects)
    found = []
    for _ in range(steps):
        u = np.full((objects, 1), 0.15)
        modes, x = truth.step(modes, x, u, 0.002 * rng.normal(size=x.shape))
        measured = x + 0.01 * rng.normal(size=x.shape)
        beliefs = batch.update(model, batch.predict_belief(model, beliefs, u), measured)
        found.append(np.square((x - beliefs.means[:, 0]) / beliefs.factors[:, 0, :1, 0]).mean())
    return float(np.mean(found))


def test_the_filter_is_as_wrong_as_it_says_though_an_object_has_one_gain() -> None:
    assert normalised_errors(1e-9, GAIN, 10) > 4.0  # a filter that trusts its lever is not
    assert normalised_errors(GAIN, GAIN, 10) == pytest.approx(1.0, abs=0.35)
    assert normalised_errors(GAIN, GAIN, 1) == pytest.approx(1.0, abs=0.2)
