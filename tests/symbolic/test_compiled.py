"""The compiled functions against their NumPy twins, textbook formulas and finite differences."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from single_gaussian import one_at_a_time
from single_gaussian import reference as gaussian
from uncertain_joints import swinging

from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Link, Mode, Noise, Pin, Reset
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.region import HalfSpace, Region
from micah_plan.automaton.sensing import Light
from micah_plan.automaton.step_noise import step_noise_std
from micah_plan.symbolic.compiled import compiled_edge, compiled_mode, sensing_std
from micah_plan.symbolic.square_root import observe

N, M = 3, 2
JOINT = Joint("prismatic", (0.0, 0.0, 0.0), axis=(1.0, 0.0, 0.0))
SEEDS = range(8)


def tuples(matrix: np.ndarray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(v) for v in row) for row in matrix)


def region(rng: np.random.Generator, k: int, label: str) -> Region:
    return Region(
        tuple(
            HalfSpace(tuple(rng.normal(size=N)), tuple(rng.normal(size=M)), float(rng.normal()), name=f"{label} {i}")
            for i in range(k)
        )
    )


def example(seed: int = 0) -> HybridAutomaton:
    """Three coupled coordinates: a free mode, a mode with two pins and rows of zeros, resets of every kind.

    With an odd seed sensing depends on the place, and the pinned mode senses its first coordinate in its own way.
    """
    rng = np.random.default_rng(seed)
    names = tuple(Coordinate(f"c{i}", "m") for i in range(N))
    inputs = tuple(Coordinate(f"u{i}", "m") for i in range(M))
    held = rng.normal(size=(N, M))
    held[[0, 2]] = 0.0
    free = Mode("free", (), tuples(rng.normal(size=(N, M))), region(rng, 3, "inside"), region(rng, 2, "input"))
    pins, own = (Pin(0, 0.4, 0.05), Pin(2, -0.2, 0.2)), ((0, 0.01),) if seed % 2 else ()
    pinned = Mode("pinned", (), tuples(held), pins=pins, observation_std=own)
    light = Light(((0, -0.1), (2, 0.3)), (0.5, 0.2, 0.3)) if seed % 2 else None
    general = Reset(tuples(rng.normal(size=(N, N))), tuples(rng.normal(size=(N, M))), tuple(rng.normal(size=N)))
    clamp = Reset(A=((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, -1.0)), c=(0.0, 0.7, 0.0))
    return HybridAutomaton(
        names,
        inputs,
        (),
        (),
        (free, pinned),
        (
            Edge("free", "pinned", Region((HalfSpace((1.0, -0.5, 0.0), (0.0, 0.3), 0.2, name="shut"),))),
            Edge("pinned", "free", region(rng, 1, "open"), general),
            Edge("free", "free", Region(), clamp),
        ),
        Noise((0.02, 0.0, 0.1), (0.05, np.inf, 0.2), light),
    )


def sample(rng: np.random.Generator, scale: float = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """mean, factor, u, z"""
    factor = np.tril(rng.normal(size=(N, N)) * scale)
    np.fill_diagonal(factor, np.abs(np.diag(factor)) + 0.1 * scale)
    return rng.normal(size=N), factor, rng.normal(size=M), rng.normal(size=N)


def call(function: ca.Function, *arguments: np.ndarray) -> list[np.ndarray]:
    """All outputs as arrays; columns as one-dimensional arrays."""
    outputs = function.call([ca.DM(a) for a in arguments])
    return [o.full().ravel() if o.shape[1] == 1 else o.full() for o in outputs]


def update(automaton: HybridAutomaton, name: str) -> ca.Function:
    """(mean, factor, z) -> (mean, factor): all measurements of a mode, one coordinate after the other."""
    z, mean, factor = ca.SX.sym("z", N), ca.SX.sym("x", N), ca.SX.sym("L", ca.Sparsity.lower(N))
    after = mean, factor
    for index, std in enumerate(sensing_std(automaton.sensing(automaton.mode(name)), mean)):
        if isinstance(std, ca.SX) or np.isfinite(std):
            after = observe(*after, index, std, z[index])
    after = ca.densify(after[0]), after[1]
    return ca.Function("update", [mean, factor, z], after, ["mean", "factor", "z"], ["mean_next", "factor_next"])


def observation_std(automaton: HybridAutomaton, name: str) -> ca.Function:
    """x -> std (n, 1) of a measurement there."""
    x = ca.SX.sym("x", N)
    stds = sensing_std(automaton.sensing(automaton.mode(name)), x)
    return ca.Function("observation_std", [x], [ca.vertcat(*stds)], ["x"], ["std"])


def everything(automaton: HybridAutomaton) -> list[tuple[str, ca.Function]]:
    """Every compiled function with a unique name."""
    modes = ("step", "invariant", "inputs", "predict", "belief_step", "condition")
    edges = ("guard", "guard_belief", "belief_reset")
    return [
        *((f"{q}.{f}", getattr(compiled_mode(automaton, q), f)) for q in automaton.mode_names for f in modes),
        *((f"{q}.update", update(automaton, q)) for q in automaton.mode_names),
        *((f"{i}.{f}", getattr(compiled_edge(automaton, i), f)) for i in range(len(automaton.edges)) for f in edges),
    ]


@pytest.mark.parametrize("seed", SEEDS)
def test_maps_equal_the_automaton(seed: int) -> None:
    automaton = example(seed)
    x, factor, u, _ = sample(np.random.default_rng(seed))
    for mode in automaton.modes:
        functions = compiled_mode(automaton, mode.name)
        assert np.allclose(call(functions.step, x, u)[0], x + mode.B @ u, atol=1e-13)
        assert np.allclose(call(functions.invariant, x, u)[0], mode.invariant.margins(x, u), atol=1e-13)
        assert np.allclose(call(functions.inputs, x, u)[0], mode.inputs.margins(x, u), atol=1e-13)
        stds = call(observation_std(automaton, mode.name), x)[0]
        assert np.allclose(stds, automaton.sensing(mode).std_at(x), rtol=1e-13)
        assert functions.mode is mode
    for number, edge in enumerate(automaton.edges):
        functions = compiled_edge(automaton, number)
        assert functions.edge is edge
        assert np.allclose(call(functions.guard, x, u)[0], edge.guard.margins(x, u), atol=1e-13)
        margin, std = call(functions.guard_belief, x, factor, u)
        expected = [gaussian.margin(x, factor, u, h) for h in edge.guard.half_spaces]
        assert np.allclose(np.stack([margin, std], axis=1), np.array(expected).reshape(-1, 2), atol=1e-13)


def followed(seed: int) -> HybridAutomaton:
    """The example with its pins at places that follow the coordinate between them."""
    automaton = example(seed)
    free, pinned = automaton.modes
    pins = tuple(replace(pin, follows=1) for pin in pinned.pins)
    return replace(automaton, modes=(free, replace(pinned, pins=pins)))


def unsure(seed: int) -> HybridAutomaton:
    """The example with two coordinates that turn about axes whose levers are known only so well."""
    automaton = example(seed)
    joints = (swinging(0.2), JOINT, swinging(0.05))
    links = tuple(Link("base", f"part {i}", i) for i in range(N))
    modes = tuple(replace(mode, joints=joints) for mode in automaton.modes)
    return replace(automaton, links=links, modes=modes)


@pytest.mark.sweep
@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e4])
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("make", [example, followed, unsure])
def test_belief_functions_equal_their_numpy_twins(
    make: Callable[[int], HybridAutomaton], seed: int, scale: float
) -> None:
    automaton = make(seed)
    mean, factor, u, z = sample(np.random.default_rng(seed), scale)
    close = {"rtol": 1e-9, "atol": 1e-9 * max(1.0, scale)}
    for mode in automaton.modes:
        functions, sensing = compiled_mode(automaton, mode.name), automaton.sensing(mode)
        predicted = gaussian.predict(mean, factor, mode.B @ u, step_noise_std(automaton, mode, u))
        for ours, twin in zip(call(functions.predict, mean, factor, u), predicted, strict=True):
            assert np.allclose(ours, twin, **close)
        updated = one_at_a_time.update(mean, factor, z, sensing.std_at(mean))
        for ours, twin in zip(call(update(automaton, mode.name), mean, factor, z), updated[:2], strict=True):
            assert np.allclose(ours, twin, **close)
        likely = one_at_a_time.update(*predicted, predicted[0], sensing.std_at(predicted[0]))[:2]
        for ours, twin in zip(call(functions.belief_step, mean, factor, u), likely, strict=True):
            assert np.allclose(ours, twin, **close)
        held = one_at_a_time.condition_on_pins(mean, factor, mode.pins)
        for ours, twin in zip(call(functions.condition, mean, factor), held, strict=True):
            assert np.allclose(ours, twin, **close)
    for number, edge in enumerate(automaton.edges):
        moved = gaussian.reset(mean, factor, u, edge.reset)
        located = automaton.pins_located_by(edge)
        others = automaton.pins_met_by(edge)
        twins = one_at_a_time.condition_on_pins(*one_at_a_time.replaced_at_pins(*moved, located), others)
        ours = call(compiled_edge(automaton, number).belief_reset, mean, factor, u)
        # Two pins that follow one coordinate leave a pivot of about the smallest std, which costs digits.
        assert np.allclose(ours[0], twins[0], rtol=1e-8, atol=1e-8 * max(1.0, scale))
        assert np.allclose(ours[1] @ ours[1].T, twins[1] @ twins[1].T, rtol=1e-8, atol=1e-9 * max(1.0, scale**2))


@pytest.mark.parametrize("seed", SEEDS)
def test_update_is_the_textbook_kalman_update(seed: int) -> None:
    mean, factor, _, z = sample(np.random.default_rng(seed))
    seen = [0, 2]
    P = factor @ factor.T
    S = P[np.ix_(seen, seen)] + np.diag(np.array([0.05, 0.2]) ** 2)
    K = P[:, seen] @ np.linalg.inv(S)
    new_mean, new_factor = call(update(example(), "free"), mean, factor, z)
    assert np.allclose(new_mean, mean + K @ (z[seen] - mean[seen]), atol=1e-12)
    assert np.allclose(new_factor @ new_factor.T, P - K @ P[seen], atol=1e-12)


@pytest.mark.parametrize("seed", SEEDS)
def test_predict_adds_process_noise_to_free_coordinates_only(seed: int) -> None:
    automaton = example(seed)
    mean, factor, u, _ = sample(np.random.default_rng(seed))
    for name, variances in (("free", [0.02**2, 0.0, 0.1**2]), ("pinned", [0.0, 0.0, 0.0])):
        new_mean, new_factor = call(compiled_mode(automaton, name).predict, mean, factor, u)
        assert np.allclose(new_mean, mean + automaton.mode(name).B @ u, atol=1e-13)
        assert np.allclose(new_factor @ new_factor.T, factor @ factor.T + np.diag(variances), atol=1e-12)


def test_a_mode_of_pins_is_not_counted_twice() -> None:
    """Staying in a pinned mode without a sensor leaves the belief as the contact made it."""
    automaton = example()
    blind = HybridAutomaton(
        automaton.coordinates, automaton.inputs, (), (), automaton.modes, automaton.edges,
        Noise(automaton.noise.process_std, (np.inf,) * N),
    )  # fmt: skip
    mean, factor, u, _ = sample(np.random.default_rng(1))
    entered = call(compiled_edge(blind, 0).belief_reset, mean, factor, u)
    variances = np.diag(entered[1] @ entered[1].T)
    assert np.isclose(variances[0], 0.05**2)  # located by the guard: the pin's own
    assert entered[0][0] == 0.4
    assert variances[2] < 0.2**2  # added to what was known
    stayed = call(compiled_mode(blind, "pinned").belief_step, *entered, np.zeros(M))
    assert np.allclose(stayed[1], entered[1], atol=1e-15)


@pytest.mark.sweep
@pytest.mark.parametrize("scale", [1e-8, 1e-3, 1.0, 1e3, 1e6])
@pytest.mark.parametrize("seed", SEEDS)
def test_factors_stay_factors(seed: int, scale: float) -> None:
    """Lower triangular, positive diagonal, finite; measuring never increases a variance, in any direction."""
    mean, factor, u, z = sample(np.random.default_rng(seed), scale)
    outputs = {
        name: call(f, *({"mean": mean, "factor": factor, "u": u, "z": z}[f.name_in(i)] for i in range(f.n_in())))
        for name, f in everything(example())
        if f.name() in ("predict", "update", "belief_step", "belief_reset", "condition")
    }
    for _new_mean, new_factor, *_ in outputs.values():
        assert np.all(np.isfinite(new_factor))
        assert np.array_equal(new_factor, np.tril(new_factor))
        assert np.all(np.diag(new_factor) > 0)
    for name in ("free.update", "pinned.update", "pinned.condition"):
        gained = factor @ factor.T - outputs[name][1] @ outputs[name][1].T
        assert np.linalg.eigvalsh(gained).min() > -1e-12 * scale**2


def test_upper_triangle_of_the_input_is_ignored() -> None:
    mean, factor, u, _ = sample(np.random.default_rng(0))
    step = compiled_mode(example(), "free").belief_step
    assert np.array_equal(call(step, mean, factor + np.triu(np.ones((N, N)), 1), u)[1], call(step, mean, factor, u)[1])


def test_exactly_known_beliefs_have_finite_values_and_derivatives() -> None:
    automaton = example()
    exact = HybridAutomaton(
        automaton.coordinates, automaton.inputs, (), (), automaton.modes, automaton.edges, Noise((0.0,) * N, (0.0,) * N)
    )
    arguments = {"mean": np.zeros(N), "factor": np.zeros((N, N)), "u": np.zeros(M), "z": np.zeros(N), "x": np.zeros(N)}
    for model in (automaton, exact):
        for name, function in everything(model):
            values = [ca.DM(arguments[function.name_in(i)]) for i in range(function.n_in())]
            outputs = function.call(values) + function.jacobian().call(values + function.call(values))
            assert all(np.all(np.isfinite(o.full())) for o in outputs), name


NAMES = [name for name, _ in everything(example())]


@pytest.mark.sweep
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("name", NAMES)
def test_jacobians_equal_finite_differences(seed: int, name: str) -> None:
    function = dict(everything(example(seed)))[name]
    mean, factor, u, z = sample(np.random.default_rng(3))
    arguments = {"mean": mean, "x": mean, "factor": factor, "u": u, "z": z}
    values = [arguments[function.name_in(i)] for i in range(function.n_in())]
    jacobians = function.jacobian().call([ca.DM(v) for v in values] + function.call([ca.DM(v) for v in values]))
    for index, value in enumerate(values):
        for entry in range(value.size):
            row, column = entry % len(value), entry // len(value)
            if column > row:
                continue  # above the diagonal of the factor
            plus, minus = (function.call(shifted(values, index, row, column, step)) for step in (1e-6, -1e-6))
            for output in range(function.n_out()):
                numeric = (plus[output] - minus[output]).full().ravel(order="F") / 2e-6
                exact = jacobians[output * function.n_in() + index].full()[:, entry]
                assert np.allclose(exact, numeric, rtol=1e-5, atol=1e-7), (name, output, index, entry)


def shifted(values: list[np.ndarray], index: int, row: int, column: int, step: float) -> list[ca.DM]:
    moved = [ca.DM(v) for v in values]
    moved[index][row, column] += step
    return moved
