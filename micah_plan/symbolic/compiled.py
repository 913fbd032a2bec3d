"""The hybrid automaton as CasADi functions, one set per mode and per edge.

Inputs and outputs: x, mean (n, 1); u (m, 1); factor (n, n), structurally lower triangular: the lower Cholesky factor L
of the covariance P = L L', entries above the diagonal ignored on input and zero on output. Units as in the automaton. u
is the command; guards and motion use the output of the automaton's memories of inputs.

Noise and pins: the process noise acts on the coordinates that a mode leaves free, so a pinned one has none. A pin at a
value is one piece of information (N(value, std²)), counted once, when the mode is entered (`CompiledEdge.belief_reset`)
or when a belief starts in it (`CompiledMode.condition`). Counting it at every step would shrink the belief without end.
If the mode is entered through a guard on the coordinate itself, the pin replaces the belief: the previous state has no
information about where exactly it is pinned.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from micah_plan.arrays import SMALLEST_STD, Floats
from micah_plan.automaton.effects.motion import motions
from micah_plan.automaton.hybrid import Edge, HybridAutomaton, Mode, Pin, Tie
from micah_plan.automaton.input_memory import passed_on
from micah_plan.automaton.input_reversal import InputReversal, input_reversal_of
from micah_plan.automaton.memo import memoised, memoised_of_motion
from micah_plan.automaton.region import Region
from micah_plan.automaton.sensing import Sensing
from micah_plan.automaton.step_noise import free_gain_std, free_process_std
from micah_plan.symbolic.casadi_operations import CasadiOperations
from micah_plan.symbolic.square_root import add_noise, lower_factor, norm, observe, put_at


@dataclass(frozen=True, eq=False)
class CompiledMode:
    """CasADi functions of one mode; those that depend on boundaries are compiled on demand.

    Attributes:
        automaton, mode: of the functions.
        step: (x, u) -> x_next: the mode's flow, without guards.
        invariant: (x, u) -> margins (k, 1), positive inside, of its half-spaces in their order; k may be 0.
        inputs: (x, u) -> margins (k, 1) of the half-spaces of the admissible inputs; k may be 0.
        predict: (mean, factor, u) -> (mean_next, factor_next): flow and process noise.
        belief_step: (mean, factor, u) -> (mean_next, factor_next): predict, then update with the most likely
            observation, with the precision of a measurement at the predicted mean.
        condition: (mean, factor) -> (mean_next, factor_next): given that the mode's pins hold.
    """

    automaton: HybridAutomaton
    mode: Mode
    step: ca.Function
    predict: ca.Function
    belief_step: ca.Function

    @cached_property
    def invariant(self) -> ca.Function:
        """Margins (r, 1) of the invariant at (x, u)."""
        s = _Symbols(self.automaton)
        passed = _passed_on(self.automaton, self.mode.name, s)[0]
        return s.map("invariant", margins=_margins(self.mode.invariant, s.x, passed))

    @cached_property
    def inputs(self) -> ca.Function:
        """Margins (r, 1) of the admissible inputs at (x, u)."""
        s = _Symbols(self.automaton)
        return s.map("inputs", margins=_margins(self.mode.inputs, s.x, s.u))

    @cached_property
    def condition(self) -> ca.Function:
        """Belief conditioned on the mode's pins, see the class."""
        s = _Symbols(self.automaton)
        mean, factor = _condition(s.x, s.factor, self.mode.pins)
        return ca.Function(
            "condition", [s.x, s.factor], [mean, factor], ["mean", "factor"], ["mean_next", "factor_next"]
        )


@dataclass(frozen=True, eq=False)
class CompiledEdge:
    """The CasADi functions of one transition.

    Attributes:
        edge: of the functions.
        guard: (x, u) -> margins (k, 1) of its half-spaces in their order, positive where the transition is taken.
        guard_belief: (mean, factor, u) -> (margin, std), each (k, 1): std is that of the margin, ||L'a||.
        belief_reset: (mean, factor, u) -> (mean_next, factor_next): for a mean behind the guard after a whole step, the
            part of that step that the target mode reverses (`automaton.input_reversal`); the affine reset through the
            covariance; then the pins of the target mode (a contact is information): replaced if the guard locates them,
            otherwise conditioned on.
    """

    edge: Edge
    guard: ca.Function
    guard_belief: ca.Function
    belief_reset: ca.Function


class _Symbols:
    """The arguments of all functions: x (also the mean), factor, u."""

    def __init__(self, automaton: HybridAutomaton) -> None:
        self.x, self.u = ca.SX.sym("x", automaton.n), ca.SX.sym("u", automaton.m)
        self.factor = ca.SX.sym("L", ca.Sparsity.lower(automaton.n))

    def map(self, name: str, **results: ca.SX) -> ca.Function:
        """(x, u) -> results."""
        return ca.Function(name, [self.x, self.u], list(results.values()), ["x", "u"], list(results))

    def belief_map(self, name: str, **results: ca.SX) -> ca.Function:
        """(mean, factor, u) -> results."""
        arguments = [self.x, self.factor, self.u]
        return ca.Function(name, arguments, list(results.values()), ["mean", "factor", "u"], list(results))


@memoised
def compiled_mode(automaton: HybridAutomaton, name: str) -> CompiledMode:
    """The functions of a mode by name, compiled on demand: a plan visits few of up to 64 modes."""
    return CompiledMode(automaton, automaton.mode(name), *_motion(automaton, name))


@memoised
def passed_input(automaton: HybridAutomaton, name: str) -> ca.Function:
    """(x, u) -> input (m, 1) behind the automaton's memories in a mode, as guards and flow see it."""
    s = _Symbols(automaton)
    return s.map("passed_input", passed=ca.densify(_passed_on(automaton, name, s)[0]))


@memoised_of_motion
def _motion(automaton: HybridAutomaton, name: str) -> tuple[ca.Function, ca.Function, ca.Function]:
    """`CompiledMode.step`, `predict` and `belief_step`, cached since they do not depend on boundaries."""
    s, mode = _Symbols(automaton), automaton.mode(name)
    passed, remembered = _passed_on(automaton, name, s)
    flowed = _flow(automaton, mode, s, passed)
    for i, value in remembered.items():
        flowed[i] = value
    factor = _carried(flowed, s) if automaton.effects else s.factor
    noise = _step_noise_std(automaton, mode, passed)
    if mode.ties:
        # The state keeps to the ties already, so its factor does; so must what an effect or noise does to it.
        tied = _tied(mode.ties, flowed)
        spread = ca.sparsify(ca.mtimes(tied, ca.diag(ca.vertcat(*noise))))
        factor = lower_factor(ca.sparsify(ca.horzcat(ca.mtimes(tied, factor), spread)))
    else:
        factor = add_noise(factor, noise)
    mean, measured_factor = flowed, factor
    for index, std in enumerate(sensing_std(automaton.sensing(mode), flowed)):
        # One coordinate after the other is exact: their noise is independent. An infinite std: not observed.
        if isinstance(std, ca.SX) or np.isfinite(std):
            mean, measured_factor = observe(mean, measured_factor, index, std)
    return (
        s.map("step", x_next=flowed),
        s.belief_map("predict", mean_next=flowed, factor_next=factor),
        s.belief_map("belief_step", mean_next=ca.densify(mean), factor_next=measured_factor),
    )


@memoised
def compiled_edge(automaton: HybridAutomaton, number: int) -> CompiledEdge:
    """The functions of an edge by its number in `automaton.edges`, compiled on demand."""
    s, edge = _Symbols(automaton), automaton.edges[number]
    a, b, c = edge.reset.matrices(automaton.n, automaton.m)
    passed = _passed_on(automaton, edge.source, s)[0]
    mean, factor = ca.mtimes(ca.DM(a), s.x) + ca.mtimes(ca.DM(b), passed) + ca.DM(c), s.factor
    if reversal := input_reversal_of(automaton, edge):
        mean, factor = _reversed(reversal, s)
    # DM(a) keeps explicit zeros; without them a reset that drops a coordinate stays sparse.
    factor = factor if edge.reset.A is None else lower_factor(ca.mtimes(ca.sparsify(ca.DM(a)), factor))
    mean, factor = put_at(mean, factor, automaton.pins_located_by(edge))
    mean, factor = _condition(mean, factor, automaton.pins_met_by(edge))
    ties = automaton.mode(edge.target).ties
    if ties and not _keeps(ties, a, c):
        tied = _tied(ties, mean)
        factor = lower_factor(ca.sparsify(ca.mtimes(tied, factor)))
    margins = _margins(edge.guard, s.x, passed)
    stds = [norm(ca.mtimes(s.factor.T, ca.DM(h.a))) for h in edge.guard.half_spaces]
    return CompiledEdge(
        edge=edge,
        guard=s.map("guard", margins=margins),
        guard_belief=s.belief_map("guard_belief", margin=margins, std=ca.vertcat(*stds) if stds else ca.SX(0, 1)),
        belief_reset=s.belief_map("belief_reset", mean_next=mean, factor_next=factor),
    )


def _tied(ties: Sequence[Tie], x: ca.SX) -> ca.SX:
    """(x with tied coordinates set, matrix (n, n) of the same map on deviations)."""
    matrix = ca.SX.eye(x.numel())
    for tie in ties:
        matrix[tie.coordinate, :] = ca.DM(tie.weights).T
        x[tie.coordinate] = tie.offset + ca.dot(ca.DM(tie.weights), x)
    return ca.sparsify(matrix)


def _keeps(ties: Sequence[Tie], a: Floats, c: Floats) -> bool:
    """Whether a reset to a x + c satisfies the ties for all x."""
    at = [(np.array(tie.weights), tie.coordinate, tie.offset) for tie in ties]
    return all(np.allclose(w @ a, a[i], atol=1e-12) and abs(w @ c + offset - c[i]) < 1e-12 for w, i, offset in at)


def _passed_on(automaton: HybridAutomaton, mode: str, s: _Symbols) -> tuple[ca.SX, dict[int, ca.SX]]:
    """(input (m, 1) behind the automaton's memories in a mode, their next values by index)."""
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
    """`automaton.step_noise.step_noise_std`; numeric where the gain is certain."""
    free, gains, moved = free_process_std(automaton, mode), free_gain_std(automaton, mode), ca.mtimes(ca.DM(mode.B), u)
    return [
        std if gain == 0.0 else ca.sqrt(max(std, SMALLEST_STD) ** 2 + (gain * moved[i]) ** 2)
        for i, (std, gain) in enumerate(zip(free, gains, strict=True))
    ]


def _carried(flowed: ca.SX, s: _Symbols) -> ca.SX:
    """The factor after the flow; effects act on coordinates separately, so the Jacobian is diagonal."""
    slope = ca.diag(ca.jacobian(flowed, s.x))
    return ca.tril(ca.mtimes(ca.diag(slope), s.factor))


def _reversed(reversal: InputReversal, s: _Symbols) -> tuple[ca.SX, ca.SX]:
    """Mean and factor after a reversal of the input, whose edge has an identity reset."""
    A, spread = ca.sparsify(ca.DM(reversal.A)), ca.sparsify(ca.DM(reversal.spread))
    factor = lower_factor(ca.sparsify(ca.horzcat(ca.mtimes(A, s.factor), spread)))
    return ca.mtimes(A, s.x) + ca.DM(reversal.c), factor


def _margins(region: Region, x: ca.SX, u: ca.SX) -> ca.SX:
    """(r, 1) margins of a region's half-spaces."""
    rows = region.half_spaces
    if not rows:
        return ca.SX(0, 1)
    a, b, c = (ca.DM(np.array([getattr(h, name) for h in rows], dtype=float)) for name in ("a", "b", "c"))
    return ca.densify(ca.mtimes(a, x) + ca.mtimes(b, u) - c)


def sensing_std(sensing: Sensing, x: ca.SX) -> list[float | ca.SX]:
    """Std of a measurement of each coordinate at x; numeric where constant."""
    squared = ca.sumsqr(ca.vertcat(*[x[i] - value for i, value in sensing.at])) if sensing.at else ca.SX(0)
    # A floor keeps the square root differentiable at a light whose own std is tiny.
    return [
        std if growth == 0.0 or not np.isfinite(std) else ca.sqrt(max(std, SMALLEST_STD) ** 2 + growth**2 * squared)
        for std, growth in zip(sensing.std, sensing.growth, strict=True)
    ]


def _condition(mean: ca.SX, factor: ca.SX, pins: Sequence[Pin]) -> tuple[ca.SX, ca.SX]:
    """(mean, factor) conditioned on pins as measurements."""
    for pin in pins:
        mean, factor = observe(mean, factor, pin.coordinate, pin.std, pin.value, pin.follows)
    return ca.densify(mean), factor
