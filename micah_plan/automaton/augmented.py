"""Operations on whole automata: map all modes or edges, add coordinates to the state, fix coordinates at values.

Memories of inputs and the thresholds of uncertain boundaries are coordinates of an augmented state (`input_memory`,
`with_boundary_states`), behind the others. Neither inputs nor noise move them, no sensor measures them, and transitions
keep them. The caller decides which half-spaces depend on them.

An automaton over (x, e) stands for one automaton over x for each value of e: `fix_augmented_state` is
that for given values.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from operator import mul
from typing import TypeVar

from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Mode, Noise, Pin, Reset
from micah_plan.automaton.region import HalfSpace, Region

Weights = Callable[[HalfSpace, Mode | None], Sequence[float]]
"""(k,) of the added coordinates in a half-space of a mode's invariant or, where the mode is None, of a guard."""
_T = TypeVar("_T")


def mapped(
    automaton: HybridAutomaton,
    mode: Callable[[Mode], Mode] = lambda mode: mode,
    edge: Callable[[Edge], Edge] = lambda edge: edge,
) -> HybridAutomaton:
    """The automaton with a function applied to each mode and each edge."""
    return replace(automaton, modes=tuple(map(mode, automaton.modes)), edges=tuple(map(edge, automaton.edges)))


def augment_state(
    automaton: HybridAutomaton, added: Sequence[Coordinate], weights: Weights | None = None
) -> HybridAutomaton:
    """The automaton over (x, e), with k coordinates e appended to x as described in the module.

    Args:
        added: (k,) the coordinates e.
        weights: of e in invariants and guards; None: these depend on x alone.
    """
    return _with_coordinates(automaton, (*automaton.coordinates, *added), weights)


def fix_augmented_state(automaton: HybridAutomaton, n: int, values: Sequence[float] = ()) -> HybridAutomaton:
    """The automaton over its first n coordinates x that steps as the one over (x, e) does with e at values.

    Args:
        values: (k,) of the additional coordinates e; none: nothing depends on e, as after `augment_state` without
            weights.
    """
    return _with_coordinates(automaton, automaton.coordinates[:n], values=values)


def _with_coordinates(
    automaton: HybridAutomaton,
    coordinates: tuple[Coordinate, ...],
    weights: Weights | None = None,
    values: Sequence[float] = (),
) -> HybridAutomaton:
    """The automaton with appended coordinates and their weights, or with the last ones fixed at values and removed."""
    n, nothing, noise = len(coordinates), (0.0,) * automaton.m, automaton.noise

    def plain(region: Region) -> Region:
        return region.mapped(lambda h: replace(h, a=_padded(h.a, n, 0.0), c=h.c - sum(map(mul, h.a[n:], values))))

    def dependent(region: Region, mode: Mode | None = None) -> Region:
        if weights is None:
            return plain(region)
        return region.mapped(lambda h: replace(h, a=(*h.a, *map(float, weights(h, mode)))))

    def at_value(pin: Pin) -> Pin:
        if pin.follows is None or not values:
            return pin
        return replace(pin, value=pin.value + values[pin.follows - n], follows=None)

    def resized_mode(mode: Mode) -> Mode:
        return replace(
            mode,
            input_matrix=_padded(mode.input_matrix, n, nothing),
            invariant=dependent(mode.invariant, mode),
            inputs=plain(mode.inputs),
            pins=tuple(map(at_value, mode.pins)),
            ties=tuple(replace(tie, weights=_padded(tie.weights, n, 0.0)) for tie in mode.ties),
        )

    def resized_edge(edge: Edge) -> Edge:
        return replace(edge, guard=dependent(edge.guard), reset=_resized_reset(edge.reset, n, nothing))

    return replace(
        automaton,
        modes=tuple(map(resized_mode, automaton.modes)),
        edges=tuple(map(resized_edge, automaton.edges)),
        coordinates=coordinates,
        noise=Noise(
            _padded(noise.process_std, n, 0.0),
            _padded(noise.observation_std, n, float("inf")),
            None if noise.light is None else replace(noise.light, growth=_padded(noise.light.growth, n, 0.0)),
        ),
        init=tuple((name, plain(region)) for name, region in automaton.init),
    )


def _resized_reset(reset: Reset, n: int, nothing: tuple[float, ...]) -> Reset:
    A = None
    if reset.A is not None:
        kept = tuple(_padded(row, n, 0.0) for row in reset.A[:n])
        A = (*kept, *(tuple(float(i == k) for k in range(n)) for i in range(len(kept), n)))
    B = None if reset.B is None else _padded(reset.B, n, nothing)
    return Reset(A, B, None if reset.c is None else _padded(reset.c, n, 0.0))


def _padded(values: tuple[_T, ...], n: int, further: _T) -> tuple[_T, ...]:
    """The first n values, filled up to n with a further one."""
    return values[:n] + (further,) * (n - len(values))
