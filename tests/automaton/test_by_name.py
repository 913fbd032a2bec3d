"""States, inputs and transitions by the names that a model gives them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from micah_plan.automaton.transition import simulate, step
from micah_plan.documents.model import load_model
from micah_plan.errors import InputError


@pytest.fixture(scope="module")
def cabinet(repository):
    return load_model(repository / "models" / "cabinet.yaml")


def test_names_and_order_are_equivalent(cabinet) -> None:
    x, u = np.array([0.3, 0.1]), np.array([0.05, -0.02])
    named_x, named_u = cabinet.named(x), dict(zip(cabinet.input_names, u.tolist(), strict=True))
    assert list(named_x) == list(cabinet.coordinate_names)
    np.testing.assert_array_equal(cabinet.state(named_x), x)
    np.testing.assert_array_equal(cabinet.input(named_u), u)
    mode = cabinet.mode_names[0]
    by_name, in_order = step(cabinet, mode, named_x, named_u), step(cabinet, mode, x, u)
    assert by_name.mode == in_order.mode
    np.testing.assert_array_equal(by_name.x, in_order.x)
    several = simulate(cabinet, mode, named_x, [named_u, {}, u])
    np.testing.assert_array_equal(several.states, simulate(cabinet, mode, x, np.array([u, 0 * u, u])).states)


def test_inputs_that_are_not_named_are_zero_but_states_are_not(cabinet) -> None:
    first, second = cabinet.coordinate_names
    np.testing.assert_array_equal(cabinet.input({}), np.zeros(cabinet.m))
    with pytest.raises(InputError, match=f"the state has no value of {second}"):
        cabinet.state({first: 0.1})


def test_an_edge_has_the_name_that_it_prints(cabinet) -> None:
    for edge in cabinet.edges:
        same = [other for other in cabinet.edges if other.name == edge.name]
        assert cabinet.edge(edge.name, same.index(edge)) is edge
        if len(same) == 1:
            assert cabinet.edge(edge.name) is edge


def test_two_transitions_of_one_name_need_a_number(cabinet) -> None:
    twice = replace(cabinet, edges=(*cabinet.edges, cabinet.edges[0]))
    name = cabinet.edges[0].name
    with pytest.raises(InputError, match="2 transitions are"):
        twice.edge(name)
    assert twice.edge(name, 1) is twice.edges[-1]
    with pytest.raises(InputError, match="number 2; give 0 to 1"):
        twice.edge(name, 2)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda m: m.edge("open -> shut"), "unknown transition 'open -> shut'; choose one of "),
        (lambda m: m.state({"dor": 1.0}), "unknown coordinate 'dor'; choose one of "),
        (lambda m: m.input({"dor": 1.0}), "unknown input 'dor'; choose one of "),
        (lambda m: m.state([0.1]), "x must be 2 finite numbers. Got [0.1]"),
        (lambda m: m.state([0.1, np.nan]), "x must be 2 finite numbers. Got "),
        (lambda m: m.input({m.input_names[0]: "far"}), "u must be 2 finite numbers. Got "),
        (lambda m: step(m, "shut", [0.0, 0.0], {}), "unknown mode 'shut'; choose one of "),
        (lambda m: replace(m, edges=()).edge("a -> b"), "unknown transition 'a -> b'; the model has no transition"),
    ],
)
def test_what_is_wrong_is_reported_by_name(cabinet, call, says) -> None:
    with pytest.raises(InputError) as error:
        call(cabinet)
    assert str(error.value).startswith(says)
