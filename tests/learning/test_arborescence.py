"""The arborescence of greatest weight, against all arborescences there are."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from micah_plan.errors import InputError
from micah_plan.learning.parts.arborescence import Arc, Weight, maximum_arborescence

NODES = ("base", "a", "b", "c", "d")
ARCS = [(parent, child) for parent in NODES for child in NODES[1:] if parent != child]


def every(weights: dict[Arc, Weight]) -> list[tuple[Weight, dict[str, str]]]:
    """Total weight of every choice of parents in which each node hangs on the root."""
    found = []
    options = [[parent for parent, child in weights if child == node] for node in NODES[1:]]
    for parents in itertools.product(*options):
        tree = dict(zip(NODES[1:], parents, strict=True))
        if all(_reaches_root(tree, node) for node in tree):
            chosen = [weights[parent, child] for child, parent in tree.items()]
            found.append((tuple(map(sum, zip(*chosen, strict=True))), tree))
    return found


def _reaches_root(tree: dict[str, str], node: str) -> bool:
    for _ in tree:
        node = tree.get(node, node)
    return node == "base"


@given(st.lists(st.tuples(st.integers(-9, 9), st.integers(-2, 2)), min_size=len(ARCS), max_size=len(ARCS)))
def test_no_tree_is_heavier(values: list[tuple[int, int]]) -> None:
    weights: dict[Arc, Weight] = dict(zip(ARCS, values, strict=True))
    tree = maximum_arborescence(weights, "base")
    total = tuple(map(sum, zip(*(weights[parent, child] for child, parent in tree.items()), strict=True)))
    assert all(_reaches_root(tree, node) for node in NODES[1:])
    assert total == max(weight for weight, _ in every(weights))


def test_a_cycle_that_everyone_likes_is_broken_where_it_costs_least() -> None:
    weights: dict[Arc, Weight] = {
        ("base", "a"): (1.0,),
        ("base", "b"): (3.0,),
        ("a", "b"): (10.0,),
        ("b", "a"): (9.0,),
    }
    assert maximum_arborescence(weights, "base") == {"a": "b", "b": "base"}


def test_ties_are_broken_by_the_later_elements_for_any_order_of_the_arcs() -> None:
    weights: dict[Arc, Weight] = {("base", "a"): (1.0, 0.0), ("base", "b"): (1.0, 0.0), ("a", "b"): (1.0, 1.0)}
    expected = {"a": "base", "b": "a"}
    assert maximum_arborescence(weights, "base") == expected
    assert maximum_arborescence(dict(reversed(weights.items())), "base") == expected


def test_a_node_without_a_way_to_it() -> None:
    with pytest.raises(InputError, match="'c' cannot be reached from 'base'"):
        maximum_arborescence({("base", "a"): (0.0,), ("c", "b"): (0.0,), ("b", "c"): (0.0,)}, "base")
