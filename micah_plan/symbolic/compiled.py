"""The hybrid automaton as CasADi functions, one set per mode and per edge.

Inputs and outputs: x, mean (n, 1); u (m, 1); factor (n, n), structurally lower triangular: the lower Cholesky factor L
of the covariance P = L L', entries above the diagonal ignored on input and zero on output. Units as in the automaton.
u is what is commanded; guards and motion see what of it comes out of the automaton's memories of inputs.

Noise and pins: the process noise acts on the coordinates that a mode leaves free, so a pinned one gets none. That the
mode pins it at a value is one piece of information (N(value, std²)), counted once, when the mode is entered
(`CompiledEdge.belief_reset`) or when a belief starts in it (`CompiledMode.condition`). Counting it at every step would
shrink the belief without end. Entering through a guard on the coordinate itself, the pin replaces the belief: where
the state was before says nothing of where exactly it is pinned.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import casadi as ca
import numpy as np

from micah_plan.automaton.effects.motion import motions
from micah_plan.automaton.hybrid import Edge, HybridAutomaton, Mode, Pin
from micah_plan.automaton.input_memory import passed_on
from micah_plan.automaton.region import Region
from micah_plan.automaton.sensing import Sensing
from micah_plan.automaton.step_noise import free_gain_std, free_process_std
from micah_plan.automaton.turning import Turn, turn_of
from micah_plan.symbolic.effects import CasadiOperations
from micah_plan.symbolic.square_root import SMALLEST_STD, add_noise, lower_factor, norm, observe, put_at

Key = TypeVar("Key")
Made = TypeVar("Made")

_MEMO = "compiled"


@dataclass(frozen=True, eq=False)
class CompiledMode:
    """The CasADi functions of one mode.

    Attributes:
        mode: what was compiled.
        step: (x, u) -> x_next: the mode's flow, without guards.
        invariant: (x, u) -> margins (k, 1), positive inside; rows named by `invariant_names`; k may be 0.
        inputs: (x, u) -> margins (k, 1) of the admissible inputs; rows named by `input_names`; k may be 0.
        invariant_belief: (mean, factor, u) -> (margin, std), each (k, 1): std is that of the margin, ||L'a||.
        observation: x -> z (n, 1).
        observation_std: x -> std (n, 1) of a measurement there; infinite: not measured.
        predict: (mean, factor, u) -> (mean, factor): flow and process noise.
        update: (mean, factor, z) -> (mean, factor, log_likelihood): the EKF measurement update.
        belief_step: (mean, factor, u) -> (mean_next, factor_next): predict, then update with the most likely
            observation, as precise as one is at the predicted mean.
        condition: (mean, factor) -> (mean, factor): given that the mode's pins hold.
    """

    mode: Mode
    step: ca.Function
    invariant: ca.Function
    inputs: ca.Function
    invariant_belief: ca.Function
    observation: ca.Function
    observation_std: ca.Function
    predict: ca.Function
    update: ca.Function
    belief_step: ca.Function
    condition: ca.Function

    @property
    def invariant_names(self) -> tuple[str, ...]:
        return tuple(h.name for h in self.mode.invariant.half_spaces)

    @property
    def input_names(self) -> tuple[str, ...]:
        return tuple(h.name for h in self.mode.inputs.half_spaces)


@dataclass(frozen=True, eq=False)
class CompiledEdge:
    """The CasADi functions of one transition.

    Attributes:
        edge: what was compiled.
        guard: (x, u) -> margins (k, 1), positive where the transition is taken; rows named by `names`.
        guard_belief: (mean, factor, u) -> (margin, std), each (k, 1).
        reset: (x, u) -> x.
        belief_reset: (mean, factor, u) -> (mean, factor): of a mean that a whole step led behind the guard, what the
            target mode turns back within that step (`automaton.turning`); the affine reset through the covariance; then
            the pins of the target mode (a contact is information): put there if the guard locates them, else
            conditioned on.
    """

    edge: Edge
    guard: ca.Function
    guard_belief: ca.Function
    reset: ca.Function
    belief_reset: ca.Function

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(h.name for h in self.edge.guard.half_spaces)


@dataclass(frozen=True, eq=False)
class CompiledAutomaton:
    """A compiled automaton: `modes` by name, `edges` by their number in `automaton.edges`.

    Each is compiled when it is first asked for: of 64 modes a plan visits a few.
    """

    automaton: HybridAutomaton
    modes: Mapping[str, CompiledMode]
    edges: Mapping[int, CompiledEdge]


@dataclass(frozen=True)
class _Symbols:
    """The arguments of all functions: x (also the mean), factor, u, z."""

    x: ca.SX
    factor: ca.SX
    u: ca.SX
    z: ca.SX


class _Lazy(Mapping[Key, Made]):
    """What is made of each key when it is first asked for."""

    def __init__(self, keys: Sequence[Key], make: Callable[[Key], Made]) -> None:
        self._keys, self._make = keys, make
        self._made: dict[Key, Made] = {}

    def __getitem__(self, key: Key) -> Made:
        if key not in self._made:
            if key not in self._keys:
                raise KeyError(key)
            self._made[key] = self._make(key)
        return self._made[key]

    def __iter__(self) -> Iterator[Key]:
        return iter(self._keys)

    def __len__(self) -> int:
        return len(self._keys)


def compile_automaton(automaton: HybridAutomaton) -> CompiledAutomaton:
    """All CasADi functions of an automaton, memoised with it: asked again, for a replan, they are there already."""
    if _MEMO not in automaton.derived:
        n, m = automaton.n, automaton.m
        z, u = ca.SX.sym("z", n), ca.SX.sym("u", m)
        symbols = _Symbols(ca.SX.sym("x", n), ca.SX.sym("L", ca.Sparsity.lower(n)), u, z)
        modes = _Lazy(automaton.mode_names, lambda name: _compile_mode(automaton, automaton.mode(name), symbols))
        numbers = range(len(automaton.edges))
        edges = _Lazy(numbers, lambda number: _compile_edge(automaton, automaton.edges[number], symbols))
        automaton.derived[_MEMO] = CompiledAutomaton(automaton, modes, edges)
    compiled: CompiledAutomaton = automaton.derived[_MEMO]
    return compiled


def _compile_mode(automaton: HybridAutomaton, mode: Mode, s: _Symbols) -> CompiledMode:
    sensing = automaton.sensing(mode)
    given, remembered = _passed_on(automaton, mode.name, s)
    flowed = _flow(automaton, mode, s, given)
    for i, value in remembered.items():
        flowed[i] = value
    carried = _carried(flowed, s) if automaton.effects else s.factor
    if mode.ties:
        # The state keeps to the ties already, so its factor does; so must what an effect or noise does to it.
        tied = ca.SX.eye(automaton.n)
        for tie in mode.ties:
            tied[tie.coordinate, :] = ca.DM(tie.weights).T
            flowed[tie.coordinate] = tie.offset + ca.dot(ca.DM(tie.weights), flowed)
        noise = ca.mtimes(ca.sparsify(tied), ca.diag(ca.vertcat(*_step_noise_std(automaton, mode, given))))
        noise = ca.sparsify(noise)
        spread = lower_factor(ca.sparsify(ca.horzcat(ca.mtimes(ca.sparsify(tied), carried), noise)))
    else:
        spread = add_noise(carried, _step_noise_std(automaton, mode, given))
    updated = _update(s.x, s.factor, sensing_std(sensing, s.x), s.z)
    stepped = _update(flowed, spread, sensing_std(sensing, flowed), None)
    conditioned = _condition(s.x, s.factor, mode.pins)
    belief = [s.x, s.factor, s.u]
    names = ["mean", "factor"]
    return CompiledMode(
        mode=mode,
        step=ca.Function("step", [s.x, s.u], [flowed], ["x", "u"], ["x_next"]),
        invariant=_margins("invariant", mode.invariant, s, given),
        inputs=_margins("inputs", mode.inputs, s, s.u),
        invariant_belief=_margins_of_belief("invariant_belief", mode.invariant, s, given),
        observation=ca.Function("observation", [s.x], [s.x], ["x"], ["z"]),
        observation_std=ca.Function("observation_std", [s.x], [ca.vertcat(*sensing_std(sensing, s.x))], ["x"], ["std"]),
        predict=ca.Function("predict", belief, [flowed, spread], [*names, "u"], ["mean_next", "factor_next"]),
        update=ca.Function(
            "update", [s.x, s.factor, s.z], list(updated), [*names, "z"], ["mean_next", "factor_next", "log_likelihood"]
        ),
        belief_step=ca.Function("belief_step", belief, list(stepped[:2]), [*names, "u"], ["mean_next", "factor_next"]),
        condition=ca.Function("condition", [s.x, s.factor], list(conditioned), names, ["mean_next", "factor_next"]),
    )


def _passed_on(automaton: HybridAutomaton, mode: str, s: _Symbols) -> tuple[ca.SX, dict[int, ca.SX]]:
    """The input (m, 1) that comes out of the automaton's memories in a mode, and their next values by index."""
    if not automaton.input_memories:
        return s.u, {}
    x, u = ([symbols[i] for i in range(symbols.numel())] for symbols in (s.x, s.u))
    passed, after = passed_on(CasadiOperations(), automaton.input_memories, mode, x, u)
    return ca.SX(ca.vertcat(*passed)), after


def _flow(automaton: HybridAutomaton, mode: Mode, s: _Symbols, u: ca.SX) -> ca.SX:
    """x⁺ = x + B u with the effects of the mode that have no memory."""
    moved = ca.mtimes(ca.DM(mode.B), u)
    for i, motion in motions(automaton, mode).items():
        moved[i] = motion.displacement(CasadiOperations(), s.x[i], moved[i])
    return s.x + moved


def _step_noise_std(automaton: HybridAutomaton, mode: Mode, u: ca.SX) -> list[float | ca.SX]:
    """`HybridAutomaton.step_noise_std`: numbers where the gain is certain."""
    free, gains, moved = free_process_std(automaton, mode), free_gain_std(automaton, mode), ca.mtimes(ca.DM(mode.B), u)
    return [
        std if gain == 0.0 else ca.sqrt(max(std, SMALLEST_STD) ** 2 + (gain * moved[i]) ** 2)
        for i, (std, gain) in enumerate(zip(free, gains, strict=True))
    ]


def _carried(flowed: ca.SX, s: _Symbols) -> ca.SX:
    """The factor carried along by the flow; effects act on each coordinate by itself, so the slope is diagonal."""
    slope = ca.diag(ca.jacobian(flowed, s.x))
    return ca.tril(ca.mtimes(ca.diag(slope), s.factor))


def _compile_edge(automaton: HybridAutomaton, edge: Edge, s: _Symbols) -> CompiledEdge:
    a, b, c = edge.reset.matrices(automaton.n, automaton.m)
    given = _passed_on(automaton, edge.source, s)[0]
    moved = ca.mtimes(ca.DM(a), s.x) + ca.mtimes(ca.DM(b), given) + ca.DM(c)
    mean, factor = _turned(turn, s) if (turn := turn_of(automaton, edge)) else (moved, s.factor)
    # DM(a) keeps explicit zeros; without them a reset that drops a coordinate stays sparse.
    factor = factor if edge.reset.A is None else lower_factor(ca.mtimes(ca.sparsify(ca.DM(a)), factor))
    located = automaton.pins_located_by(edge)
    mean, factor = put_at(mean, factor, [(pin.coordinate, pin.value, pin.std, pin.follows) for pin in located])
    after = _condition(mean, factor, automaton.pins_met_by(edge))
    return CompiledEdge(
        edge=edge,
        guard=_margins("guard", edge.guard, s, given),
        guard_belief=_margins_of_belief("guard_belief", edge.guard, s, given),
        reset=ca.Function("reset", [s.x, s.u], [moved], ["x", "u"], ["x_next"]),
        belief_reset=ca.Function(
            "belief_reset", [s.x, s.factor, s.u], list(after), ["mean", "factor", "u"], ["mean_next", "factor_next"]
        ),
    )


def _turned(turn: Turn, s: _Symbols) -> tuple[ca.SX, ca.SX]:
    """Mean and factor after a turn, whose edge has an identity reset."""
    A, spread = ca.sparsify(ca.DM(turn.A)), ca.sparsify(ca.DM(turn.spread))
    factor = lower_factor(ca.sparsify(ca.horzcat(ca.mtimes(A, s.factor), spread)))
    return ca.mtimes(A, s.x) + ca.DM(turn.c), factor


def _margins(name: str, region: Region, s: _Symbols, u: ca.SX) -> ca.Function:
    return ca.Function(name, [s.x, s.u], [_margin_rows(region, s.x, u)], ["x", "u"], ["margins"])


def _margins_of_belief(name: str, region: Region, s: _Symbols, u: ca.SX) -> ca.Function:
    stds = [norm(ca.mtimes(s.factor.T, ca.DM(h.a))) for h in region.half_spaces]
    outputs = [_margin_rows(region, s.x, u), ca.vertcat(*stds) if stds else ca.SX(0, 1)]
    return ca.Function(name, [s.x, s.factor, s.u], outputs, ["mean", "factor", "u"], ["margin", "std"])


def _margin_rows(region: Region, x: ca.SX, u: ca.SX) -> ca.SX:
    rows = [ca.dot(ca.DM(h.a), x) + ca.dot(ca.DM(h.b), u) - h.c for h in region.half_spaces]
    return ca.densify(ca.vertcat(*rows)) if rows else ca.SX(0, 1)


def sensing_std(sensing: Sensing, x: ca.SX) -> list[float | ca.SX]:
    """Std of a measurement of each coordinate at x: numbers where it is the same everywhere."""
    squared = ca.sumsqr(ca.vertcat(*[x[i] - value for i, value in sensing.at])) if sensing.at else ca.SX(0)
    # A floor keeps the square root differentiable at a light whose own std is tiny.
    return [
        std if growth == 0.0 or not np.isfinite(std) else ca.sqrt(max(std, SMALLEST_STD) ** 2 + growth**2 * squared)
        for std, growth in zip(sensing.std, sensing.growth, strict=True)
    ]


def _update(mean: ca.SX, factor: ca.SX, stds: list[float | ca.SX], z: ca.SX | None) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Sequential scalar updates, exact because the observation noise is diagonal; infinite std: not observed."""
    log_likelihood = ca.SX(0)
    for index, std in enumerate(stds):
        if not isinstance(std, ca.SX) and not np.isfinite(std):
            continue
        seen = observe(mean, factor, index, std, None if z is None else z[index])
        mean, factor = seen.mean, seen.factor
        log_likelihood -= (ca.log(2 * np.pi * seen.variance) + seen.innovation**2 / seen.variance) / 2
    return ca.densify(mean), factor, log_likelihood


def _condition(mean: ca.SX, factor: ca.SX, pins: tuple[Pin, ...]) -> tuple[ca.SX, ca.SX]:
    for pin in pins:
        seen = observe(mean, factor, pin.coordinate, pin.std, pin.value, pin.follows)
        mean, factor = seen.mean, seen.factor
    return ca.densify(mean), factor
