"""An automaton whose uncertain boundaries are coordinates of its state: what a filter needs to learn where they are.

With b uncertain boundaries a state is (x, s), s (b,) by how much each of them truly lies elsewhere than the model says.
Nothing moves s and no sensor shows it; guards and invariants read ``a'x - scale s >= c``, and a mode that holds a
coordinate at such a boundary holds it at value + s. So a step of (x, s) is exactly a step of x with the automaton of
`thresholds.with_shifted_thresholds` at s, and every passage of an object goes through the same boundary.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Mode, Noise, Pin, Reset
from micah_plan.automaton.region import HalfSpace, Region
from micah_plan.automaton.thresholds import Boundary, boundaries_of_pins, boundary_of, boundary_stds, held_coordinate

Floats = NDArray[np.float64]


def with_boundary_states(automaton: HybridAutomaton) -> HybridAutomaton:
    """The automaton over (x, s), made once; the automaton itself where all thresholds are certain."""
    made: HybridAutomaton | None = automaton.derived.get("boundary_states")
    if made is None:
        made = _extended(automaton) if boundary_stds(automaton) else automaton
        automaton.derived["boundary_states"] = made
    return made


def _extended(automaton: HybridAutomaton) -> HybridAutomaton:
    stds = boundary_stds(automaton)
    numbers = {boundary: automaton.n + i for i, boundary in enumerate(stds)}
    noise, known, unseen = automaton.noise, (0.0,) * len(stds), (float("inf"),) * len(stds)
    light = None if noise.light is None else replace(noise.light, growth=noise.light.growth + known)
    return replace(
        automaton,
        coordinates=(*automaton.coordinates, *(Coordinate(f"boundary {i + 1}", "") for i in range(len(stds)))),
        modes=tuple(_mode(automaton, mode, stds, numbers) for mode in automaton.modes),
        edges=tuple(_edge(edge, automaton, numbers) for edge in automaton.edges),
        noise=Noise(noise.process_std + known, noise.observation_std + unseen, light),
        init=tuple((name, _region(region, numbers)) for name, region in automaton.init),
    )


def _mode(automaton: HybridAutomaton, mode: Mode, stds: dict[Boundary, float], numbers: dict[Boundary, int]) -> Mode:
    at = {i: b for i, b in boundaries_of_pins(automaton, mode).items() if b in numbers}
    still = ((0.0,) * automaton.m,) * len(numbers)
    return replace(
        mode,
        input_matrix=mode.input_matrix + still,
        invariant=_region(mode.invariant, numbers, {i: numbers[b] for i, b in at.items()}),
        inputs=_region(mode.inputs, numbers),
        pins=tuple(_pin(pin, at[pin.coordinate], stds, numbers) if pin.coordinate in at else pin for pin in mode.pins),
        ties=tuple(replace(tie, weights=tie.weights + (0.0,) * len(numbers)) for tie in mode.ties),
    )


def _pin(pin: Pin, at: Boundary, stds: dict[Boundary, float], numbers: dict[Boundary, int]) -> Pin:
    """A pin at a boundary: its std includes that of the boundary, which is a state of its own here."""
    rest = float(np.sqrt(max(0.0, pin.std**2 - stds[at] ** 2)))
    return replace(pin, std=rest, follows=numbers[at])


def _edge(edge: Edge, automaton: HybridAutomaton, numbers: dict[Boundary, int]) -> Edge:
    reset, b = edge.reset, len(numbers)
    if not reset.is_identity:
        moved, driven, offset = reset.matrices(automaton.n, automaton.m)
        whole = np.block([[moved, np.zeros((automaton.n, b))], [np.zeros((b, automaton.n)), np.eye(b)]])
        rows = np.vstack([driven, np.zeros((b, automaton.m))])
        reset = Reset(_tuples(whole), _tuples(rows), (*map(float, offset), *(0.0,) * b))
    return replace(edge, guard=_region(edge.guard, numbers), reset=reset, threshold_std=0.0)


def _region(region: Region, numbers: dict[Boundary, int], held: dict[int, int] | None = None) -> Region:
    """The region over (x, s).

    Args:
        held: the state of the boundary at which a coordinate is held, by coordinate.
    """
    return Region(tuple(_half_space(h, numbers, held or {}) for h in region.half_spaces))


def _half_space(half_space: HalfSpace, numbers: dict[Boundary, int], held: dict[int, int]) -> HalfSpace:
    first = len(half_space.a)
    weights = np.zeros(len(numbers))
    boundary, scale = boundary_of(half_space)
    coordinate = held_coordinate(half_space, held)
    if boundary in numbers:
        weights[numbers[boundary] - first] = -scale
    elif coordinate is not None:
        weights[held[coordinate] - first] = -half_space.a[coordinate]
    return replace(half_space, a=(*half_space.a, *map(float, weights)))


def _tuples(matrix: Floats) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(map(float, row)) for row in matrix)
