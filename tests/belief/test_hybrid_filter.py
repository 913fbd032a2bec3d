"""The hybrid filter against 10^5 particles on a door that shuts and a slider with two segments, and its laws."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from reference.hybrid_step import step

from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Mode, Noise, Pin, Reset
from micah_plan.automaton.region import Region, above, below, input_below
from micah_plan.belief.filter import initial_belief, predict_belief, update
from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.errors import InputError

SHUT, MIDDLE, END = 0.6, 0.3, 0.5
PARTICLES = 100_000


def door(process: float = 0.005, observation: float = 0.02, pin: float = 0.004, clamp: bool = False) -> HybridAutomaton:
    """A revolute door, held shut at 0.6 rad; leaves the latch when pulled. Optionally clamped at 0."""
    name = (Coordinate("door", "rad"),)
    swing = Mode("swing", (), ((1.0,),), Region((above(0, 0.0, 1, 1),)))
    shut = Mode("shut", (), ((0.0,),), Region((above(0, SHUT, 1, 1),)), pins=(Pin(0, SHUT, pin),))
    clamps = (Edge("swing", "swing", Region((below(0, 0.0, 1, 1),)), Reset(A=((0.0,),))),) if clamp else ()
    edges = (
        Edge("swing", "shut", Region((above(0, SHUT, 1, 1),))),
        Edge("shut", "swing", Region((input_below(0, 0.0, 1, 1, strict=True),))),
        *clamps,
    )
    return HybridAutomaton(name, name, (), (), (swing, shut), edges, Noise((process,), (observation,)))


def slider() -> HybridAutomaton:
    """A slider whose second segment moves half as far, ending at a clamp."""
    name = (Coordinate("slider", "m"),)
    edges = (
        Edge("first", "second", Region((above(0, MIDDLE, 1, 1),))),
        Edge("second", "first", Region((below(0, MIDDLE, 1, 1, strict=True),))),
        Edge("second", "second", Region((above(0, END, 1, 1),)), Reset(((0.0,),), None, (END,))),
    )
    modes = (Mode("first", (), ((1.0,),)), Mode("second", (), ((0.5,),)))
    return HybridAutomaton(name, name, (), (), modes, edges, Noise((0.004,), (0.01,)))


def mirror(returns: bool = True) -> HybridAutomaton:
    """A slider that an input moves forth before the middle and back behind it."""
    to, back, _ = slider().edges
    first, second = slider().modes
    edges = (to, back) if returns else (to,)
    return replace(slider(), modes=(first, replace(second, input_matrix=((-1.0,),))), edges=edges)


def one_way_mirror() -> HybridAutomaton:
    return mirror(returns=False)


class Particles(ABC):
    """A bootstrap particle filter; mode 0 is the automaton's first, and subclasses move each particle by one step."""

    def __init__(self, automaton: HybridAutomaton, mean: float, std: float, seed: int, count: int = PARTICLES) -> None:
        self.rng = np.random.default_rng(seed)
        self.process, self.observation = automaton.noise.process_std[0], automaton.noise.observation_std[0]
        self.mode = np.zeros(count, dtype=int)
        self.limit = self.limits(automaton, count)
        self.x = np.minimum(self.rng.normal(mean, std, count), self.limit - 1e-12)

    @abstractmethod
    def limits(self, automaton: HybridAutomaton, count: int) -> np.ndarray:
        """Where each particle leaves the first mode."""

    @abstractmethod
    def predict(self, u: float) -> None:
        """Move every particle by one step with an input."""

    def update(self, z: float) -> None:
        weights = np.exp(-0.5 * ((z - self.x) / self.observation) ** 2)
        count = len(self.x)
        positions = (self.rng.random() + np.arange(count)) / count
        chosen = np.searchsorted(np.cumsum(weights) / weights.sum(), positions).clip(max=count - 1)
        self.x, self.mode, self.limit = self.x[chosen], self.mode[chosen], self.limit[chosen]

    @property
    def shares(self) -> np.ndarray:
        return np.array([np.mean(self.mode == 0), np.mean(self.mode == 1)])


class DoorParticles(Particles):
    """The latch holds at a place known to the pin's std only: each particle has its own."""

    lowest = -np.inf

    def limits(self, automaton: HybridAutomaton, count: int) -> np.ndarray:
        pin = automaton.mode("shut").pins[0]
        return self.rng.normal(pin.value, pin.std, count)

    def predict(self, u: float) -> None:
        free = (self.mode == 0) | (u < 0)
        moved = self.x + np.where(free, u + self.rng.normal(0.0, self.process, len(self.x)), 0.0)
        caught = free & (moved >= self.limit) & (moved > self.x)
        self.x = np.maximum(np.where(caught, self.limit, moved), self.lowest)
        self.mode = np.where(caught | ~free, 1, 0)


class ClampedDoorParticles(DoorParticles):
    lowest = 0.0


class SliderParticles(Particles):
    """The change of ratio at 0.3 is located on each particle's path."""

    def limits(self, automaton: HybridAutomaton, count: int) -> np.ndarray:
        return np.full(count, automaton.edges[0].guard.half_spaces[0].c)

    def predict(self, u: float) -> None:
        w = self.rng.normal(0.0, self.process, len(self.x))
        d, other = np.where(self.mode == 0, u, 0.5 * u) + w, np.where(self.mode == 0, 0.5 * u, u) + w
        end = self.x + d
        crosses = np.where(self.mode == 0, (end >= self.limit) & (d > 0), (end < self.limit) & (d < 0))
        share = np.divide(end - self.limit, d, out=np.zeros_like(d), where=crosses)
        onward = other * d > 0  # else the new mode's motion leads back and the state stays at the boundary
        end = np.where(crosses, self.limit + np.where(onward, share * other, 0.0), end)
        self.mode = np.where(crosses, 1 - self.mode, self.mode)
        self.x = np.minimum(end, END)


def both(
    automaton: HybridAutomaton,
    particles: type[Particles],
    start: tuple[float, float],
    inputs: list[float],
    seed: int,
    sees: bool,
) -> list[tuple[HybridBelief, np.ndarray, float, float, float]]:
    """Filter and particles side by side on one simulated truth; (belief, shares, mean, std, true x) per step."""
    belief = initial_belief(automaton, [start[0]], [start[1]], automaton.modes[0].name)
    cloud, truth = particles(automaton, *start, seed), particles(automaton, *start, seed + 1000, 1)
    rng = np.random.default_rng(seed + 2000)
    history = []
    for u in inputs:
        truth.predict(u)
        cloud.predict(u)
        belief = predict_belief(automaton, belief, [u])
        if sees:
            z = float(truth.x[0] + rng.normal(0.0, cloud.observation))
            belief = update(automaton, belief, [z])
            cloud.update(z)
        history.append((belief, cloud.shares, float(cloud.x.mean()), float(cloud.x.std()), float(truth.x[0])))
    return history


PUSH_AND_PULL_DOOR = [0.05] * 9 + [0.0] * 4 + [-0.05] * 5
OPEN_TO_THE_STOP = [-0.05] * 5 + [0.0] * 3 + [0.05] * 4
THERE_AND_BACK = [0.04] * 14 + [0.0] * 3 + [-0.04] * 12


@pytest.mark.sweep
@pytest.mark.parametrize("seed", [3, 4])
@pytest.mark.parametrize(
    ("automaton", "particles", "start", "inputs"),
    [
        (door(), DoorParticles, (0.3, 0.05), PUSH_AND_PULL_DOOR),
        (door(clamp=True), ClampedDoorParticles, (0.15, 0.05), OPEN_TO_THE_STOP),
        (slider(), SliderParticles, (0.15, 0.03), THERE_AND_BACK),
    ],
    ids=["door", "clamped door", "slider"],
)
@pytest.mark.parametrize("sees", [False, True], ids=["blind", "measured"])
def test_belief_equals_that_of_particles(
    automaton: HybridAutomaton, particles: type[Particles], start: tuple[float, float], inputs: list[float],
    sees: bool, seed: int,
) -> None:  # fmt: skip
    """Weights within 0.08, mean within a quarter of the std of the start (blind) or the sensor, std within 15 %."""
    scale = automaton.noise.observation_std[0] if sees else start[1]
    for k, (belief, shares, mean, std, _) in enumerate(both(automaton, particles, start, inputs, seed, sees)):
        # A Gaussian spreads what particles pile up at a stop or a threshold; hence a floor of one process std.
        floor = automaton.noise.process_std[0]
        assert np.allclose(belief.weights, shares, atol=0.08), k
        assert abs(belief.mean[0] - mean) < max(0.25 * scale, floor), k
        assert abs(np.sqrt(belief.covariance[0, 0]) - std) < max(0.15 * std, floor), k


@pytest.mark.slow
@pytest.mark.parametrize(
    ("automaton", "particles", "start", "inputs"),
    [
        (door(), DoorParticles, (0.3, 0.05), PUSH_AND_PULL_DOOR),
        (slider(), SliderParticles, (0.15, 0.03), THERE_AND_BACK),
    ],
    ids=["door", "slider"],
)
def test_errors_match_the_predicted_spread(
    automaton: HybridAutomaton, particles: type[Particles], start: tuple[float, float], inputs: list[float]
) -> None:
    """Over 250 simulated truths the mean squared error, in units of the predicted variance, is near one."""
    rng = np.random.default_rng(11)
    ratios, right = [], []
    for trial in range(250):
        truth = particles(automaton, *start, 5000 + trial, 1)
        belief = initial_belief(automaton, [start[0]], [start[1]], automaton.modes[0].name)
        for u in inputs:
            truth.predict(u)
            z = truth.x[0] + rng.normal(0.0, truth.observation)
            belief = update(automaton, predict_belief(automaton, belief, [u]), [z])
            # At a stop the variance is zero by the model and so is the error: the floor keeps 0/0 out.
            ratios.append((belief.mean[0] - truth.x[0]) ** 2 / (belief.covariance[0, 0] + 1e-7))
            right.append((belief.weights[truth.mode[0]], belief.most_likely == truth.mode[0]))
    assert 0.8 < np.mean(ratios) < 1.25
    claimed, actual = np.mean(right, axis=0)
    assert claimed > 0.95
    assert abs(np.mean([max(w, 1 - w) for w, _ in right]) - actual) < 0.02


def cabinet() -> HybridAutomaton:
    """A door, then a drawer behind it: three modes in a chain, a stop at the end and resets that move x."""
    names = (Coordinate("door", "rad"), Coordinate("drawer", "m"))
    modes = (
        Mode("door", (), ((1.0, 0.0), (0.0, 0.0))),
        Mode("drawer", (), ((0.0, 0.0), (0.0, 1.0)), pins=(Pin(0, 1.0, 1e-7),)),
        Mode("far", (), ((0.0, 0.0), (0.0, 0.4)), pins=(Pin(0, 1.0, 1e-7),)),
    )
    edges = (
        Edge("door", "drawer", Region((above(0, 1.0, 2, 2),))),
        Edge("drawer", "door", Region((input_below(0, 0.0, 2, 2, strict=True), below(1, 0.05, 2, 2)))),
        Edge("drawer", "far", Region((above(1, 0.3, 2, 2),)), Reset(None, None, (0.0, 0.1))),
        Edge("far", "drawer", Region((below(1, 0.35, 2, 2, strict=True),)), Reset(None, None, (0.0, -0.1))),
        Edge("far", "far", Region((above(1, 0.6, 2, 2),)), Reset(((1.0, 0.0), (0.0, 0.0)), None, (0.0, 0.6))),
        Edge("drawer", "drawer", Region((below(1, 0.0, 2, 2),)), Reset(((1.0, 0.0), (0.0, 0.0)))),
    )
    return HybridAutomaton(names, names, (), (), modes, edges, Noise((0.0, 0.0), (0.01, 0.01)))


@pytest.mark.sweep
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("make", [door, slider, cabinet, mirror, one_way_mirror])
def test_a_sharp_belief_moves_as_the_automaton_does(make: Callable[[], HybridAutomaton], seed: int) -> None:
    """Without noise the belief follows the located events: chains in one step, resets, clamps, leaving a latch."""
    rng = np.random.default_rng(seed)
    automaton = replace(make(), noise=Noise((0.0,) * make().n, (0.01,) * make().n))
    modes = tuple(replace(q, pins=tuple(replace(p, std=1e-7) for p in q.pins)) for q in automaton.modes)
    automaton = replace(automaton, modes=modes)
    mode, x = automaton.modes[0].name, rng.uniform(0.0, 0.25, automaton.n)
    belief = initial_belief(automaton, x, np.full(automaton.n, 1e-7), mode)
    events = 0
    for k in range(40):
        u = rng.uniform(0.0, 0.2, automaton.m) * (1 if (k // 10) % 2 == 0 else -1)
        if rng.random() < 0.1:
            u = u * 8
        taken = step(automaton, mode, x, u)
        mode, x, events = taken.mode, taken.x, events + len(taken.events)
        belief = predict_belief(automaton, belief, u)
        assert automaton.modes[belief.most_likely].name == mode, (k, taken)
        assert belief.weights.max() > 1 - 1e-6
        assert np.allclose(belief.mean, x, atol=1e-5), (k, taken)
    assert events > 0


def test_at_rest_without_noise_nothing_leaks() -> None:
    automaton = door(process=0.0)
    belief = initial_belief(automaton, [SHUT - 0.002], [0.01], "swing")
    for _ in range(20):
        belief = predict_belief(automaton, belief, [0.0])
    assert belief.weights[0] == 1.0
    assert np.allclose(belief.means[0], SHUT - 0.002, atol=1e-12)


def test_a_start_inside_the_guard_crosses_at_once() -> None:
    belief = predict_belief(door(), initial_belief(door(), [SHUT + 0.1], [0.01], "swing"), [0.0])
    assert belief.weights[1] > 0.999


def test_weights_follow_the_likelihood() -> None:
    automaton = door()
    belief = predict_belief(automaton, initial_belief(automaton, [0.55], [0.03], "swing"), [0.05])
    share = belief.weights[1]
    assert 0.3 < share < 0.7
    assert update(automaton, belief, [0.53]).weights[1] < share < update(automaton, belief, [0.61]).weights[1]


def test_a_mode_without_probability_has_its_pins_and_finite_values() -> None:
    belief = predict_belief(door(), initial_belief(door(), [0.1], [0.01], "swing"), [0.01])
    assert belief.weights.tolist() == [1.0, 0.0]
    assert np.allclose([belief.means[1, 0], belief.factors[1, 0, 0]], [SHUT, 0.004])
    updated = update(door(), belief, [0.12])
    assert updated.weights.tolist() == [1.0, 0.0]
    assert np.isfinite(updated.means).all()


def test_functions_are_pure_and_repeatable() -> None:
    automaton = slider()
    start = initial_belief(automaton, [0.28], [0.02], "first")
    kept = start.weights.copy(), start.means.copy(), start.factors.copy()
    first, second = (update(automaton, predict_belief(automaton, start, [0.03]), [0.31]) for _ in range(2))
    for name in ("weights", "means", "factors"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()
    for before, name in zip(kept, ("weights", "means", "factors"), strict=True):
        assert np.array_equal(before, getattr(start, name))
        with pytest.raises(ValueError, match="read-only"):
            getattr(first, name)[...] = 0.0


def test_no_measurement_changes_nothing_and_a_partial_one_only_what_it_can() -> None:
    automaton = cabinet()
    belief = initial_belief(automaton, [0.2, 0.1], [0.1, 0.1], "door")
    assert update(automaton, belief, [np.nan, np.nan]) is belief
    seen = update(automaton, belief, [0.25, np.nan])
    assert seen.means[0, 1] == pytest.approx(0.1)
    assert seen.factors[0, 1, 1] == pytest.approx(0.1)
    assert seen.factors[0, 0, 0] < 0.01


def test_start_takes_stds_or_a_covariance_and_the_first_mode_that_fits() -> None:
    covariance = np.array([[0.04, 0.02], [0.02, 0.01]])  # singular
    belief = initial_belief(cabinet(), [0.2, 0.1], covariance, "door")
    assert np.allclose(belief.factors[0] @ belief.factors[0].T, covariance)
    assert initial_belief(door(), [0.2], [0.1]).weights.tolist() == [1.0, 0.0]
    assert initial_belief(door(), [SHUT], [0.1], "shut").factors[1, 0, 0] < 0.004


@pytest.mark.parametrize(
    ("mean", "spread", "mode", "message"),
    [
        ([0.1, 0.2], [0.1], "swing", "shape"),
        ([0.1], [0.1, 0.1], "swing", "shape"),
        ([np.nan], [0.1], "swing", "finite"),
        ([0.1], [-0.1], "swing", "not negative"),
        ([0.1], [[-0.1]], "swing", "positive semi-definite"),
        ([-0.1], [0.01], None, "no mode's invariant"),
        ([0.1], [0.1], "swinging", "unknown mode"),
    ],
)
def test_start_rejects_what_is_no_belief(mean: list, spread: list, mode: str | None, message: str) -> None:
    with pytest.raises(InputError, match=message):
        initial_belief(door(), mean, spread, mode)


def test_a_noisy_start_just_outside_takes_the_most_probable_mode() -> None:
    assert initial_belief(door(), [-0.01], [0.01]).most_likely == 0
    assert initial_belief(slider(), [-0.01], [0.01]).most_likely == 0


@pytest.mark.slow
def test_coupled_guards_clamps_and_chains_equal_samples_of_the_automaton() -> None:
    """The cabinet with noise, in two coordinates, against 3000 samples moved by the automaton's own step."""
    automaton = replace(cabinet(), noise=Noise((0.01, 0.005), (0.01, 0.01)))
    rng = np.random.default_rng(5)
    belief = initial_belief(automaton, [0.8, 0.1], [0.04, 0.02], "door")
    samples = [("door", rng.normal([0.8, 0.1], [0.04, 0.02])) for _ in range(3000)]
    names = [mode.name for mode in automaton.modes]
    inputs = [(0.09, 0.05)] * 8 + [(0.0, -0.1)] * 5 + [(-0.08, -0.05)] * 3
    for k, u in enumerate(inputs):
        moved = [step(automaton, mode, x, u, rng.normal(0.0, [0.01, 0.005])) for mode, x in samples]
        samples = [(taken.mode, taken.x) for taken in moved]
        belief = predict_belief(automaton, belief, u)
        shares = np.array([np.mean([mode == name for mode, _ in samples]) for name in names])
        states = np.array([x for _, x in samples])
        assert np.allclose(belief.weights, shares, atol=0.12), (k, belief.weights, shares)
        assert np.allclose(belief.mean, states.mean(axis=0), atol=0.015), k
        assert np.allclose(np.sqrt(np.diag(belief.covariance)), states.std(axis=0), rtol=0.2, atol=0.01), k


def test_wrong_shapes_are_named() -> None:
    belief = initial_belief(door(), [0.1], [0.1])
    with pytest.raises(InputError, match=r"input must have shape \(1,\)"):
        predict_belief(door(), belief, [0.1, 0.2])
    with pytest.raises(InputError, match=r"measurement must have shape \(1,\)"):
        update(door(), belief, [0.1, 0.2])
