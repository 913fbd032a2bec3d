"""Candidate terms for a coordinate's model: forms of effects with the initial values of their fits.

Each form provides its own starting values (`EffectForm.initial_guess`). Position commands are one complete form
(`follow`) in three sizes. Two unnamed corrections compete as well: a smooth function of configuration and command, and
one of earlier commands. Their evidence measures the structure that no effect of the library explains.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import accumulate
from typing import final

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.effects.fit_start import FitStart
from micah_plan.automaton.effects.forces import SMOOTH_BUMPS
from micah_plan.automaton.effects.form import EffectForm, Memory, Operations, Parameter, Value, Values
from micah_plan.automaton.effects.memories import AS_COMMANDED
from micah_plan.automaton.effects.registry import form, forms
from micah_plan.automaton.effects.value import Effect
from micah_plan.residual.coordinate_data import CoordinateData
from micah_plan.residual.onsets import is_active

FOLLOW, DRIVE = "follow", "drive"
MEMORY = "earlier commands"
UNNAMED = "unexplained"
"""The form of a smooth correction without a name."""
# Gating columns after a term's own parameters: since which place in the recording (0 to 1) and since when in a run [s].
GATES = 2
NEVER_GATED = (-np.inf, -np.inf)


@dataclass(frozen=True)
class Term:
    """A form that acts in some modes (empty: in all)."""

    form: EffectForm
    modes: tuple[str, ...] = ()

    @property
    def size(self) -> int:
        """Number of parameter columns: those of the form, then the gates."""
        return len(self.form.parameters) + GATES


Model = tuple[Term, ...]


def columns(model: Model) -> int:
    """Number of parameters of a model, gates included."""
    return sum(term.size for term in model)


@lru_cache(maxsize=1024)
def term_columns(model: Model) -> tuple[slice, ...]:
    """Columns of each term, gates included."""
    ends = accumulate(term.size for term in model)
    return tuple(slice(end - term.size, end) for term, end in zip(model, ends, strict=True))


@dataclass(frozen=True, eq=False)
class TermCandidate:
    """A term with initial parameter values.

    Attributes:
        starts: (M, size) parameters with gates; those that are not free differ between starts only.
        free: columns within the term that are fitted.
        scale: (k,) large values of the free parameters.
        bounds: (lower, upper) of columns that the data bound more than the form does: beyond them it would be another
            effect (a spring whose rest position is far away is a bias).
    """

    term: Term
    starts: Floats
    free: tuple[int, ...]
    scale: Floats
    bounds: Mapping[int, tuple[float, float]] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return self.term.form.name


def gated(part: TermCandidate, since_order: Sequence[float], since_time: Sequence[float]) -> TermCandidate:
    """A candidate with an onset, for each combination of its starts with an order and a time."""
    gates = [(order, NEVER_GATED[1]) for order in since_order] + [(NEVER_GATED[0], time) for time in since_time]
    starts = np.repeat(part.starts, len(gates), axis=0)
    starts[:, -GATES:] = np.tile(gates, (len(part.starts), 1))
    return replace(part, starts=starts)


def always(part: TermCandidate) -> TermCandidate:
    """The candidate without an onset."""
    starts = part.starts.copy()
    starts[:, -GATES:] = NEVER_GATED
    return replace(part, starts=starts)


def gates_of(effect: Effect, data: CoordinateData) -> tuple[float, float]:
    """(order, time) of an effect's onset in the recording and in a run."""
    since = effect.since
    if since is None:
        return NEVER_GATED
    if since.run is None:
        return -np.inf, since.time
    acting = np.stack([is_active(since, run, time) for run, time in zip(data.run.tolist(), data.time, strict=True)])
    return float(data.order[acting & data.counted_starts].min(initial=np.inf)), -np.inf


def candidates(data: CoordinateData) -> tuple[TermCandidate, ...]:
    """Candidates of all forms that the data can show, without onset and in all modes."""
    possible = []
    for effect_form in forms():
        made = (
            effect_form.initial_guess(data)
            if effect_form.in_library and effect_form.equivalent_effect(data) is None
            else None
        )
        if made is not None:
            whole = _candidate(effect_form, made)
            possible += [*_without_options(whole), whole]
    return tuple(possible)


def equivalent_candidate(name: str, data: CoordinateData) -> TermCandidate:
    """A form that was not fitted since it is indistinguishable from another in the data (`indistinguishable`)."""
    return _candidate(form(name), form(name).guess_from_neutral(data))


def _candidate(effect_form: EffectForm, made: FitStart) -> TermCandidate:
    starts = np.atleast_2d(made.values)
    full = np.hstack([starts, np.tile(NEVER_GATED, (len(starts), 1))])
    return TermCandidate(Term(effect_form), full, made.free, np.asarray(made.scale, dtype=float), made.bounds)


def indistinguishable(part: TermCandidate, data: CoordinateData) -> tuple[str, ...]:
    """Forms that are equivalent to another in these data and were not fitted; simplest first."""
    same = []
    for effect_form in sorted(forms(), key=lambda effect_form: effect_form.complexity_rank):
        equivalent = effect_form.equivalent_effect(data) if effect_form.in_library else None
        if equivalent is not None and equivalent.name == part.name and abs(part.starts[0, 0]) < equivalent.below:
            same.append(effect_form.name)
    return tuple(same)


@final
class EarlierCommands(EffectForm):
    """Finite impulse response to the last three commands, plus the first step after a rest or a reversal."""

    name = MEMORY
    sentence = "What is done depends on earlier commands."
    source = "Ljung, System Identification, 2nd ed., ch. 4.2 (finite impulse response)"
    parameters = (
        Parameter("size", "coordinate", None, 1e-12),
        *(Parameter(f"before_{k + 1}", "1", 0.0) for k in range(3)),
        Parameter("after_rest", "1", 0.0),
        Parameter("side_after_rest", "coordinate", 0.0),
        Parameter("side_before", "coordinate", 0.0),
    )
    in_library = False

    def at_rest(self, p: Values) -> Memory:
        return (0.0 * p[0],) * 3

    def remember(self, ops: Operations, v: Value, memory: Memory, p: Values) -> tuple[Value, Memory]:
        out = v + p[1] * (memory[0] - v) + p[2] * (memory[1] - v) + p[3] * (memory[2] - v)
        rested = ops.exp(-3.0 * ops.abs(memory[0]) / p[0])
        out = out + rested * (p[4] * v + p[5] * _side(ops, v / p[0])) + p[6] * _side(ops, memory[0] / p[0])
        return out, (v, *memory[:2])


# One instance, as of the forms of the library: its formula is read once.
_EARLIER_COMMANDS = EarlierCommands()


def _side(ops: Operations, x: Value) -> Value:
    """tanh(3 x)."""
    return 1.0 - 2.0 / (1.0 + ops.exp(ops.minimum(ops.maximum(6.0 * x, -40.0), 40.0)))


def _without_options(part: TermCandidate) -> list[TermCandidate]:
    """The effect with its options off, as a rival with fewer parameters; empty if it has none that are fitted."""
    options = part.term.form.options()
    at = [k for k, parameter in enumerate(part.term.form.parameters) if parameter.name in options]
    kept = [k for k, column in enumerate(part.free) if column not in at]
    if not at or len(kept) == len(part.free):
        return []
    starts = part.starts.copy()
    starts[:, at] = list(options.values())
    free = tuple(part.free[k] for k in kept)
    return [replace(part, starts=np.unique(starts, axis=0), free=free, scale=part.scale[kept])]


def variants(part: TermCandidate) -> list[TermCandidate]:
    """A candidate for each value of its unfitted columns."""
    fixed = [k for k in range(part.starts.shape[1]) if k not in part.free]
    kinds = np.unique(part.starts[:, fixed], axis=0)
    return [replace(part, starts=part.starts[(part.starts[:, fixed] == kind).all(axis=1)]) for kind in kinds]


def at_commanded_places() -> TermCandidate:
    """The parameter-free candidate: the part is at the commanded position after each step."""
    values = np.array([[*(value for _, value in AS_COMMANDED), *NEVER_GATED]])
    return TermCandidate(Term(form(FOLLOW)), values, (), np.zeros(0))


def smooth(data: CoordinateData, *, is_lean: bool = False) -> TermCandidate:
    """Unnamed correction: a smooth function of configuration, direction and speed of the command.

    Args:
        is_lean: whether it is a function of direction and speed alone.
    """
    low, high = data.visited
    margin = 0.02 * (high - low) + 1e-6
    size = data.command_size
    start = [low - margin, high - low + 2 * margin, size, *(0.0,) * (3 + 2 * SMOOTH_BUMPS), *NEVER_GATED]
    scale = [0.3, 0.3, 0.3 * size, *(0.2 * size,) * SMOOTH_BUMPS, *(0.3,) * SMOOTH_BUMPS]
    free = tuple(range(3, 6 if is_lean else 6 + 2 * SMOOTH_BUMPS))
    return TermCandidate(Term(form(UNNAMED)), np.array([start]), free, np.array(scale[: len(free)]))


def earlier_commands(data: CoordinateData) -> TermCandidate:
    """Unnamed correction by earlier commands."""
    size = data.command_size
    start = np.array([[size, *(0.0,) * 6, *NEVER_GATED]])
    scale = np.array([0.3, 0.2, 0.2, 0.3, 0.2 * size, 0.2 * size])
    return TermCandidate(Term(_EARLIER_COMMANDS), start, tuple(range(1, 7)), scale)
