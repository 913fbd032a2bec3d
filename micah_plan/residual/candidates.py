"""What may be missing of a coordinate's model: forms of effects as terms, with where the search for each begins.

Each form says itself where its parameters begin (`EffectForm.begun`). Commands that are places are one whole form
(`follow`) in three sizes. Two corrections have no name: a smooth function of place and command, and one of earlier
commands; they say how much is left that no effect of the library explains.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import accumulate
from typing import final

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.effects.fit_start import FitStart, step_sizes
from micah_plan.automaton.effects.forces import SMOOTH_BUMPS
from micah_plan.automaton.effects.form import EffectForm, Memory, Operations, Parameter, Value, Values
from micah_plan.automaton.effects.memories import AS_COMMANDED
from micah_plan.automaton.effects.registry import form, forms
from micah_plan.automaton.effects.value import Effect
from micah_plan.residual.coordinate_data import CoordinateData
from micah_plan.residual.versions import acts

FOLLOW = "follow"
MEMORY = "earlier commands"
UNNAMED = "unexplained"
"""The form of a smooth correction without a name."""
# Gating columns after a term's own parameters: since which place in the recording (0 to 1) and since when in a run [s].
GATES = 2
NEVER_GATED = (-np.inf, -np.inf)
# Share of commands that lead to where the part can be, give or take the range that was seen, if they are places.
_REACHABLE = 0.5
# Commands that differ by less than this share of their size are the same, except for their digits.
_DIGITS = 1e-3
# Where fits of machines with limits begin: delays [steps]; shares with momenta; the quantile of steps that limits cut.
_DELAYS = (0.5, 1.5, 2.5, 4.0, 6.0, 9.0)
_RESPONSES = ((0.6, 0.0), (0.2, 0.0), (0.1, 0.5), (0.05, 0.9), (0.02, 0.8))
_FASTEST = 0.98


@dataclass(frozen=True)
class Term:
    """A form that acts in some modes (empty: in all)."""

    form: EffectForm
    modes: tuple[str, ...] = ()

    @property
    def size(self) -> int:
        """Columns of parameters: those of the form, then the gates."""
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
    """A term with starts for its parameters.

    Attributes:
        starts: (M, size) parameters with gates; those that are not free differ between starts only.
        free: columns within the term that are fitted.
        scale: (k,) what a large value of each of those is.
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
    """A candidate that acts only since a place or a time, each of its starts since each of them."""
    gates = [(order, NEVER_GATED[1]) for order in since_order] + [(NEVER_GATED[0], time) for time in since_time]
    starts = np.repeat(part.starts, len(gates), axis=0)
    starts[:, -GATES:] = np.tile(gates, (len(part.starts), 1))
    return replace(part, starts=starts)


def always(part: TermCandidate) -> TermCandidate:
    """The same effect from the start."""
    starts = part.starts.copy()
    starts[:, -GATES:] = NEVER_GATED
    return replace(part, starts=starts)


def gates_of(effect: Effect, data: CoordinateData) -> tuple[float, float]:
    """From which place in a recording and which time in a run an effect of the model acts."""
    since = effect.since
    if since is None:
        return NEVER_GATED
    if since.run is None:
        return -np.inf, since.time
    acting = np.stack([acts(since, run, time) for run, time in zip(data.run.tolist(), data.time, strict=True)])
    return float(data.order[acting & data.counted_starts].min(initial=np.inf)), -np.inf


def candidates(data: CoordinateData) -> tuple[TermCandidate, ...]:
    """All forms that the data can show, each acting always and everywhere."""
    possible = []
    for effect_form in forms():
        made = effect_form.begun(data) if effect_form.is_sought and effect_form.same_as(data) is None else None
        if made is not None:
            possible.append(_candidate(effect_form, made))
    return tuple(possible)


def untried(name: str, data: CoordinateData) -> TermCandidate:
    """A form that was not tried since it would do the same as another (`indistinguishable`)."""
    return _candidate(form(name), form(name).from_neutral(data))


def _candidate(effect_form: EffectForm, made: FitStart) -> TermCandidate:
    starts = np.atleast_2d(made.values)
    full = np.hstack([starts, np.tile(NEVER_GATED, (len(starts), 1))])
    return TermCandidate(Term(effect_form), full, made.free, np.asarray(made.scale, dtype=float), made.bounds)


def indistinguishable(part: TermCandidate, data: CoordinateData) -> tuple[str, ...]:
    """Forms that were not tried because in these data they would do exactly the same as another; plainest first."""
    same = []
    for effect_form in sorted(forms(), key=lambda effect_form: effect_form.complexity_rank):
        equivalent = effect_form.same_as(data) if effect_form.is_sought else None
        if equivalent is not None and equivalent.name == part.name and abs(part.starts[0, 0]) < equivalent.below:
            same.append(effect_form.name)
    return tuple(same)


@final
class EarlierCommands(EffectForm):
    """A correction by the commands before: shares of the last three, and what starts after a rest or a reversal."""

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
    is_sought = False

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


def variants(part: TermCandidate) -> list[TermCandidate]:
    """A candidate for each of the values of its columns that are not fitted: each is a rival of its own."""
    fixed = [k for k in range(part.starts.shape[1]) if k not in part.free]
    kinds = np.unique(part.starts[:, fixed], axis=0)
    return [replace(part, starts=part.starts[(part.starts[:, fixed] == kind).all(axis=1)]) for kind in kinds]


def follows(data: CoordinateData) -> list[TermCandidate]:
    """Responses to commands that are places: of first order, late, of second order, with a dead zone, and with limits.

    None where most commands lead to where the part cannot be, or all are the same: places are then the measured ones.
    """
    size = data.command_size
    low, high = data.visited
    places = (data.z + data.u)[data.counted_starts]
    if np.ptp(data.u[data.counted_starts]) <= _DIGITS * size:
        return []
    if np.mean((places > low - (high - low)) & (places < high + (high - low))) < _REACHABLE:
        return []
    share, offset, gain, delay, momentum, width, pull, acceleration, speed = range(9)
    fastest = max(step_sizes(data, _FASTEST), default=size)

    def begun(free: Sequence[int], starts: Sequence[Mapping[int, float]]) -> TermCandidate:
        values = np.repeat([[0.5, *(value for _, value in AS_COMMANDED[1:]), *NEVER_GATED]], len(starts), axis=0)
        for row, start in zip(values, starts, strict=True):
            for column, value in start.items():
                parameter = form(FOLLOW).parameters[column]
                row[column] = min(max(value, parameter.lower), parameter.upper)
        large = {share: 0.3, offset: 0.3 * size, gain: 0.1, delay: 1.0, momentum: 0.3, width: 0.2 * size}
        large |= dict.fromkeys((pull, acceleration, speed), 0.3 * fastest)
        return TermCandidate(Term(form(FOLLOW)), values, tuple(free), np.array([large[k] for k in free]))

    regressed = [_regressed(data, late) for late in range(3)]
    first = [{share: 0.9}, {share: 0.4}, {share: 0.1}, {share: 0.02}]
    second = [{share: 0.5, momentum: 0.2}, {share: 0.1, momentum: 0.7}, {share: 0.01, momentum: 0.9}, *regressed[:1]]
    delayed = [
        {share: s, momentum: m, width: w * size, delay: late}
        for s, m in ((0.6, 0.0), (0.2, 0.6))
        for w in (0.02, 0.5)
        for late in (0.05, 1.0)
    ]
    delayed += [{**one, width: w * size} for one in regressed for w in (0.001, 0.1, 0.3)]
    late_ones = [{share: s, delay: late} for s in (0.5, 0.15) for late in (1.0, 2.0, 3.0)]
    slow = [{delay: d, share: s, momentum: m} for d in _DELAYS for s, m in _RESPONSES]
    at_once = [one for one in slow if not one[momentum]]
    pulled = [one | {pull: k * fastest * (1.0 - one[momentum])} for one in slow for k in (1.0, 0.4)]
    profiles = [one | {speed: fastest, acceleration: k * fastest} for one in at_once for k in (0.3, 0.1)]
    whole = (share, offset, gain, delay, momentum, width)
    return [
        begun((share,), first),
        begun((share, offset), first),
        begun((share, delay), late_ones),
        begun((share, offset, gain, momentum), second),
        begun(whole, delayed),
        begun((share, delay, pull), [one | {pull: k * fastest} for one in at_once for k in (1.0, 0.4)]),
        begun((*whole, pull), pulled),
        begun((*whole, speed), [one | {speed: fastest} for one in slow]),
        begun((share, delay, acceleration, speed), profiles),
    ]


def _regressed(data: CoordinateData, late: int) -> dict[int, float]:
    """Parameters of `follow` by least squares of measured steps, with places so many rows late and up to one more.

    Where fits begin: a delay between two rows is a share of the place in each.
    """
    first = late + 1
    rows = data.z.shape[1] - 1
    now, before, after = data.z[:, first:rows], data.z[:, first - 1 : rows - 1], data.z[:, first + 1 :]
    places = [data.place[:, first - lag : rows - lag] for lag in (late, late + 1)]
    counts = data.counted[:, first + 1 :] & data.is_measured[:, first:rows] & data.is_measured[:, first - 1 : rows - 1]
    terms = [np.ones(counts.sum()), (now - before)[counts], *(place[counts] for place in places), now[counts]]
    offset, momentum, *of_places, of_part = np.linalg.lstsq(np.stack(terms, axis=1), (after - now)[counts], rcond=None)[
        0
    ].tolist()
    share, whole = max(-of_part, 1e-4), sum(of_places)
    between = min(max(of_places[1] / whole, 0.01), 1.0) if whole > 0.0 else 0.01
    return {0: share, 1: offset / share, 2: whole / share, 3: late + between, 4: momentum}


def at_commanded_places() -> TermCandidate:
    """That the part is at the commanded place after each step: nothing of it is fitted."""
    values = np.array([[*(value for _, value in AS_COMMANDED), *NEVER_GATED]])
    return TermCandidate(Term(form(FOLLOW)), values, (), np.zeros(0))


def smooth(data: CoordinateData, *, is_lean: bool = False) -> TermCandidate:
    """The correction by a smooth function of configuration, direction and speed of the command.

    Args:
        is_lean: of direction and speed alone.
    """
    low, high = data.visited
    margin = 0.02 * (high - low) + 1e-6
    size = data.command_size
    start = [low - margin, high - low + 2 * margin, size, *(0.0,) * (3 + 2 * SMOOTH_BUMPS), *NEVER_GATED]
    scale = [0.3, 0.3, 0.3 * size, *(0.2 * size,) * SMOOTH_BUMPS, *(0.3,) * SMOOTH_BUMPS]
    free = tuple(range(3, 6 if is_lean else 6 + 2 * SMOOTH_BUMPS))
    return TermCandidate(Term(form(UNNAMED)), np.array([start]), free, np.array(scale[: len(free)]))


def earlier_commands(data: CoordinateData) -> TermCandidate:
    """The correction by earlier commands."""
    size = data.command_size
    start = np.array([[size, *(0.0,) * 6, *NEVER_GATED]])
    scale = np.array([0.3, 0.2, 0.2, 0.3, 0.2 * size, 0.2 * size])
    return TermCandidate(Term(_EARLIER_COMMANDS), start, tuple(range(1, 7)), scale)
