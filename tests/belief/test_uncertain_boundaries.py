"""The filter where thresholds are known only so well, against particles that each have thresholds of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from interacting_models import InteractingModels
from particles import ParticleFilter
from test_hybrid_filter import cabinet, door, mirror, slider

from micah_plan.automaton.hybrid import HybridAutomaton, Noise, Reset
from micah_plan.belief.filter import initial_belief, predict_belief, update
from micah_plan.belief.hybrid_belief import HybridBelief

STD = 0.03
PUSH_PULL = [[0.04]] * 11 + [[0.0]] * 3 + [[-0.04]] * 5
THERE_BACK_THERE = [[0.04]] * 8 + [[-0.04]] * 6 + [[0.04]] * 8


def blurred(automaton: HybridAutomaton, std: float = STD) -> HybridAutomaton:
    """Thresholds on the state known to `std`, and pins at them no better."""
    edges = tuple(e if e.is_self_transition else replace(e, threshold_std=std) for e in automaton.edges)
    modes = tuple(replace(q, pins=tuple(replace(p, std=max(p.std, std)) for p in q.pins)) for q in automaton.modes)
    return replace(automaton, edges=edges, modes=modes)


def thrown() -> HybridAutomaton:
    """The slider with a jump of 2 cm to the second segment, and back."""
    on, back, *others = slider().edges
    jumps = (replace(edge, reset=Reset(None, None, (by,))) for edge, by in ((on, 0.02), (back, -0.02)))
    return replace(slider(), edges=(*jumps, *others))


def exact_pins(automaton: HybridAutomaton) -> HybridAutomaton:
    """As particles have it: what a latch holds lies at the boundary itself."""
    modes = tuple(replace(q, pins=tuple(replace(p, std=1e-4) for p in q.pins)) for q in automaton.modes)
    return replace(automaton, modes=modes)


def noisy_cabinet() -> HybridAutomaton:
    return replace(exact_pins(cabinet()), noise=Noise((0.005, 0.004), (0.02, 0.01)))


def uncertain_latch() -> HybridAutomaton:
    """The cabinet with a latch whose place is known to 3 cm; both modes that hold the door hold it there."""
    automaton = blurred(noisy_cabinet())
    sure = (replace(edge, threshold_std=0.0) for edge in automaton.edges[1:])
    return replace(automaton, edges=(automaton.edges[0], *sure))


TO_THE_DRAWER = [[0.1, 0.0]] * 9 + [[0.05, 0.04]] * 10
SYSTEMS = {
    "door": (exact_pins(door()), [0.3], [0.05], PUSH_PULL),
    "slider": (slider(), [0.15], [0.02], THERE_BACK_THERE),
    "slider with jumps": (thrown(), [0.15], [0.02], THERE_BACK_THERE),
    "mirror": (mirror(), [0.15], [0.02], THERE_BACK_THERE),
    "cabinet": (noisy_cabinet(), [0.2, 0.1], [0.03, 0.01], TO_THE_DRAWER),
    "uncertain door": (blurred(door()), [0.3], [0.03], PUSH_PULL),
    "uncertain slider": (blurred(slider(), 0.02), [0.15], [0.02], THERE_BACK_THERE),
    "uncertain cabinet": (uncertain_latch(), [0.2, 0.1], [0.03, 0.01], TO_THE_DRAWER),
}


def compared(name: str, seed: int, particles: int) -> dict[str, np.ndarray]:
    """How far our filter and an IMM filter are from particles, mean over the steps of one run.

    Returns:
        per filter the total variation of the modes' weights, and the distance of the means over the sensor's std.
    """
    automaton, mean, std, inputs = SYSTEMS[name]
    cloud, truth = (ParticleFilter(automaton, mean, std, count, seed + count) for count in (particles, 1))
    models = InteractingModels(automaton, mean, std)
    rng = np.random.default_rng(seed)
    belief = initial_belief(automaton, mean, std, automaton.modes[0].name)
    found: dict[str, list[tuple[float, float]]] = {"ours": [], "imm": []}
    for u in inputs:
        truth.predict(u)
        z = truth.x[0] + rng.normal(0.0, automaton.noise.observation_std)
        belief = update(automaton, predict_belief(automaton, belief, u), z)
        for other in (cloud, models):
            other.predict(u)
            other.update(z)
        pairs = {"ours": (belief.weights, belief.mean), "imm": (models.weights, models.weights @ models.means)}
        for key, (weights, at) in pairs.items():
            away = np.abs(at - cloud.x.mean(axis=0)) / automaton.noise.observation_std
            found[key].append((0.5 * float(np.abs(weights - cloud.shares).sum()), float(away.max())))
    return {key: np.mean(rows, axis=0) for key, rows in found.items()}


@pytest.mark.sweep
@pytest.mark.parametrize("name", SYSTEMS)
def test_belief_is_near_that_of_particles(name: str) -> None:
    variation, distance = compared(name, 1, 1500)["ours"]
    assert variation < 0.04
    assert distance < 0.2


@pytest.mark.slow
@pytest.mark.parametrize("name", SYSTEMS)
def test_belief_is_nearer_to_particles_than_interacting_models_are(name: str) -> None:
    runs = [compared(name, seed, 2000) for seed in range(5)]
    ours, imm = (np.mean([run[key] for run in runs], axis=0) for key in ("ours", "imm"))
    assert (ours < imm).all(), (ours, imm)
    assert ours[0] < 0.02
    assert ours[1] < 0.1


@pytest.mark.sweep
@pytest.mark.parametrize("name", ["uncertain door", "uncertain slider"])
def test_without_measurements_it_equals_particles(name: str) -> None:
    """Weights within 0.06, mean and std within a tenth of the threshold's std, also where that std is the sensor."""
    automaton, mean, std, inputs = SYSTEMS[name]
    cloud = ParticleFilter(automaton, mean, std, 2500, seed=3)
    belief = initial_belief(automaton, mean, std, automaton.modes[0].name)
    for k, u in enumerate(inputs):
        cloud.predict(u)
        belief = predict_belief(automaton, belief, u)
        assert np.allclose(belief.weights, cloud.shares, atol=0.06), k
        assert abs(belief.mean[0] - cloud.x.mean()) < 0.1 * STD, k
        assert abs(np.sqrt(belief.covariance[0, 0]) - cloud.x.std()) < 0.1 * STD, k


def test_what_a_latch_shows_of_its_place_is_remembered() -> None:
    """Measured at rest in the latch, the place is known; the next passage waits for it."""
    automaton, stays = blurred(door()), np.array([0.64])
    belief = initial_belief(automaton, [0.5], [0.01], "swing")
    assert np.allclose(belief.shift_stds, STD)
    for _ in range(4):
        belief = predict_belief(automaton, belief, [0.06])
    for _ in range(8):
        belief = update(automaton, predict_belief(automaton, belief, [0.0]), stays)
    assert belief.weights[1] > 0.999
    assert belief.shifts[1, 0] == pytest.approx(0.04, abs=0.006)
    assert belief.shift_stds[1, 0] < 0.008
    for _ in range(3):
        belief = predict_belief(automaton, belief, [-0.04])
    pushed = predict_belief(
        automaton, predict_belief(automaton, belief, [0.05]), [0.05]
    )  # to 2 cm behind the model's 0.6 rad
    assert pushed.weights[0] > 0.7


def test_staying_open_where_the_model_has_the_latch_moves_the_latch_further_on() -> None:
    automaton = blurred(door())
    belief = initial_belief(automaton, [0.55], [0.005], "swing")
    for z in (0.57, 0.59, 0.61):
        belief = update(automaton, predict_belief(automaton, belief, [0.02]), [z])
    assert belief.shifts[0, 0] > 0.01
    assert belief.shift_stds[0, 0] < 0.8 * STD


def test_a_hand_made_belief_knows_of_boundaries_what_the_model_does() -> None:
    automaton = blurred(door())
    start = initial_belief(automaton, [0.5], [0.02], "swing")
    bare = HybridBelief(start.weights, start.means, start.factors)
    ours, same = (predict_belief(automaton, belief, [0.08]) for belief in (start, bare))
    assert np.allclose(ours.weights, same.weights, atol=1e-12)
    assert np.allclose(ours.means[0], same.means[0], atol=1e-12)


def test_a_place_held_already_is_no_news() -> None:
    """The drawer going from one mode to the next behind a door that stays shut leaves the door's belief alone."""
    automaton = replace(noisy_cabinet(), modes=cabinet().modes)
    modes = tuple(replace(q, pins=tuple(replace(p, std=0.05) for p in q.pins)) for q in automaton.modes)
    automaton = replace(automaton, modes=modes)
    belief = initial_belief(automaton, [1.0, 0.25], [0.05, 0.001], "drawer")
    moved = predict_belief(automaton, belief, [0.0, 0.1])
    assert moved.weights[2] > 0.999
    assert moved.factors[2, 0, 0] == pytest.approx(belief.factors[1, 0, 0], rel=1e-6)
