"""An automaton whose effects with a memory have it in the state: what planner and filter need to plan with them.

The state is (x, m): m holds, for each such effect, the values that it remembers: the inputs of the last steps for a
delay, the command that arrives for a lag, the place within the play for a backlash. Inputs are known, so m starts at
rest, is known exactly, no noise moves it and no sensor shows it. A step of (x, m) is a step of x with the input that
comes out of the memory (`passing.passed_on`). Everything else stays as it is; goals, guards and joints know x only.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from micah_plan.automaton.effects.registry import form
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Mode, Noise, Reset
from micah_plan.automaton.passing import at_rest
from micah_plan.automaton.region import Region
from micah_plan.automaton.register import Register


def with_memory_states(automaton: HybridAutomaton) -> HybridAutomaton:
    """The automaton over (x, m), made once; the automaton itself where nothing remembers or m is there already."""
    made: HybridAutomaton | None = automaton.derived.get("memory_states")
    if made is None:
        registers = () if automaton.registers else _registers(automaton)
        made = _extended(automaton, registers) if registers else automaton
        automaton.derived["memory_states"] = made
    return made


def without_memory_states(automaton: HybridAutomaton) -> HybridAutomaton:
    """The automaton over x, whose steps then leave the effects with a memory out."""
    size = sum(register.size for register in automaton.registers)
    return replace(_resized(automaton, automaton.n - size), registers=()) if size else automaton


def memory_at_rest(automaton: HybridAutomaton) -> tuple[float, ...]:
    """(k,) the values of m before any input; empty where the automaton has none."""
    return tuple(value for register in automaton.registers for value in at_rest(register))


def remembering_input(automaton: HybridAutomaton, effect: Effect) -> tuple[int, float] | None:
    """The input that an effect's memory is about, and the coordinate's command per unit of it.

    None where the memory cannot be a state: if the coordinate is not moved by one input of its own, in the same way
    in every mode that moves it, or if a reset adds that input at once.
    """
    i = automaton.index(effect.coordinate)
    rows = {mode.input_matrix[i] for mode in automaton.modes if any(mode.input_matrix[i])}
    if len(rows) != 1 or np.count_nonzero(next(iter(rows))) != 1:
        return None
    j = int(np.flatnonzero(next(iter(rows)))[0])
    alone = all(not row[j] for mode in automaton.modes for k, row in enumerate(mode.input_matrix) if k != i)
    added = any(edge.reset.B is not None and np.any(np.array(edge.reset.B)[:, j]) for edge in automaton.edges)
    return (j, float(next(iter(rows))[j])) if alone and not added else None


def _registers(automaton: HybridAutomaton) -> tuple[Register, ...]:
    found: list[Register] = []
    first = automaton.n
    for effect in automaton.effects:
        given = remembering_input(automaton, effect) if form(effect.name).layer == "memory" else None
        if given is not None:
            size = len(form(effect.name).at_rest(effect.values))
            found.append(Register(effect, *given, first, size))
            first += size
    return tuple(register for register in found if register.size)


def _extended(automaton: HybridAutomaton, registers: tuple[Register, ...]) -> HybridAutomaton:
    size = sum(register.size for register in registers)
    names = [
        Coordinate(f"{r.effect.coordinate} {r.effect.name} {k + 1}", automaton.inputs[r.input].unit)
        for r in registers
        for k in range(r.size)
    ]
    larger = _resized(automaton, automaton.n + size)
    return replace(larger, coordinates=(*automaton.coordinates, *names), registers=registers)


def _resized(automaton: HybridAutomaton, n: int) -> HybridAutomaton:
    """The automaton over the first n coordinates, or with further ones that nothing moves, sees or asks for."""
    noise = automaton.noise
    light = None if noise.light is None else replace(noise.light, growth=_fit(noise.light.growth, n))
    return replace(
        automaton,
        coordinates=automaton.coordinates[:n],
        modes=tuple(_mode(mode, n, automaton.m) for mode in automaton.modes),
        edges=tuple(_edge(edge, n) for edge in automaton.edges),
        noise=Noise(_fit(noise.process_std, n), _fit(noise.observation_std, n, float("inf")), light),
        init=tuple((name, _region(region, n)) for name, region in automaton.init),
    )


def _mode(mode: Mode, n: int, m: int) -> Mode:
    rows = mode.input_matrix[:n]
    return replace(
        mode,
        input_matrix=rows + ((0.0,) * m,) * (n - len(rows)),
        invariant=_region(mode.invariant, n),
        inputs=_region(mode.inputs, n),
        ties=tuple(replace(tie, weights=_fit(tie.weights, n)) for tie in mode.ties),
    )


def _edge(edge: Edge, n: int) -> Edge:
    reset = edge.reset
    A = None
    if reset.A is not None:
        kept, A = reset.A[:n], np.eye(n)
        A[: len(kept), : len(kept)] = [row[:n] for row in kept]
    rows = () if reset.B is None else reset.B[:n]
    B = None if reset.B is None else rows + ((0.0,) * len(rows[0]),) * (n - len(rows))
    c = None if reset.c is None else _fit(reset.c, n)
    reset = Reset(None if A is None else tuple(tuple(map(float, row)) for row in A), B, c)
    return replace(edge, guard=_region(edge.guard, n), reset=reset)


def _region(region: Region, n: int) -> Region:
    return Region(tuple(replace(h, a=_fit(h.a, n)) for h in region.half_spaces))


def _fit(values: tuple[float, ...], n: int, further: float = 0.0) -> tuple[float, ...]:
    return values[:n] + (further,) * (n - len(values))


def left_out(automaton: HybridAutomaton, memory: bool = False) -> tuple[str, ...]:
    """One line per effect that prediction and calibration know, and planner, filter and nominal plant do not.

    Args:
        memory: whether those with a memory are left out even where it can be a state.
    """
    carried = [automaton.coordinates[link.coordinate].name for link in automaton.links if link.parent != BASE]
    told = []
    for effect in automaton.effects:
        layer, why = form(effect.name).layer, ""
        if layer == "memory" and (memory or remembering_input(automaton, effect) is None):
            why = "it depends on earlier inputs"
        elif layer == "frame" and effect.coordinate in carried:
            why = "commands are given in the base frame"
        if why:
            named = f"the {effect.name} of {effect.coordinate}"
            told.append(f"planner, filter and nominal plant leave out {named}: {why}")
    return tuple(told)
