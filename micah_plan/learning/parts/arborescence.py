"""Maximum spanning arborescence: the parents of all nodes with the greatest sum of weights.

Source: Edmonds, "Optimum branchings", 1967. SciPy's spanning trees are of undirected graphs.

Pairs of parts that may be attached to each other, from their motion in the base frame alone; half of the pairs are
excluded.

A part that is attached to another is carried along. So if one moves in the base frame while the other rests, the other
is not attached to it: it would have to compensate exactly. Time is cut into windows, and a part can be attached to
another if it moves in at least half of the windows in which the other does. A part that never moves carries nothing
that the base does not carry as well. Only certain cases are excluded: slow drift of a tracker counts as motion, and
then the pair is learned and judged by its evidence.
"""

from __future__ import annotations

from collections.abc import Mapping

from micah_plan.errors import InputError, shown

Weight = tuple[float, ...]
Arc = tuple[str, str]


def maximum_arborescence(weights: Mapping[Arc, Weight], root: str) -> dict[str, str]:
    """Parent of every node but the root.

    Args:
        weights: of arcs (parent, child). Weights are tuples of one length: they add by element and compare in order,
            so later elements break ties of the earlier ones.

    Raises:
        InputError: a node that no arc leads to from the root.
    """
    reached, ahead = {root}, [root]
    while ahead:
        here = ahead.pop()
        new = [child for parent, child in weights if parent == here and child not in reached]
        reached.update(new)
        ahead += new
    for arc in weights:
        for node in arc:
            if node not in reached:
                raise InputError(f"{shown(node)} cannot be reached from {shown(root)}")
    return {child: parent for parent, child in _chosen(weights, root)}


def _chosen(weights: Mapping[Arc, Weight], root: str) -> set[Arc]:
    """The arcs of the arborescence: the best into every node, with each cycle broken once."""
    best: dict[str, Arc] = {}
    for arc in sorted(weights):
        parent, child = arc
        if child not in (root, parent) and (child not in best or weights[arc] > weights[best[child]]):
            best[child] = arc
    cycle = _cycle(best, root)
    if not cycle:
        return set(best.values())
    # The cycle becomes one node, named as none of the others; an arc into it pays for the arc that it replaces.
    merged = "\0".join(sorted(cycle))
    shorter: dict[Arc, Weight] = {}
    original: dict[Arc, Arc] = {}
    for arc in sorted(weights):
        parent, child = arc
        if parent in cycle and child in cycle:
            continue
        weight = weights[arc]
        if child in cycle:
            weight = tuple(w - b for w, b in zip(weight, weights[best[child]], strict=True))
        new = (merged if parent in cycle else parent, merged if child in cycle else child)
        if new not in shorter or weight > shorter[new]:
            shorter[new], original[new] = weight, arc
    arcs = {original[arc] for arc in _chosen(shorter, root)}
    entered = next(child for _, child in arcs if child in cycle)
    return arcs | {best[node] for node in cycle if node != entered}


def _cycle(best: Mapping[str, Arc], root: str) -> set[str]:
    for start in sorted(best):
        path, node = [start], best[start][0]
        while node != root and node not in path:
            path.append(node)
            node = best[node][0]
        if node != root:
            return set(path[path.index(node) :])
    return set()
