"""The forms of effects as candidates on a lane, where each form says that its search begins."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.effects.forces import SMOOTH_BUMPS
from micah_plan.automaton.effects.form import EffectForm
from micah_plan.automaton.effects.registry import form, forms
from micah_plan.automaton.effects.shown import Start
from micah_plan.residual.lane import Lane
from micah_plan.residual.simulation import GATES, Term

NEVER_GATED = (-np.inf,) * GATES
# The form of a correction without a name.
UNNAMED = "unexplained"


@dataclass(frozen=True, eq=False)
class Candidate:
    """A term with starts for its parameters.

    Attributes:
        starts: (M, size) parameters with gates; those that are not free differ between starts only.
        free: columns within the term that are fitted.
        scale: (k,) what a large value of each of those is.
        bounds: (lower, upper) of columns that the lane bounds more than the form does: beyond them it would be another
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


def candidates(lane: Lane) -> tuple[Candidate, ...]:
    """All forms that the lane can show, each acting always and everywhere."""
    found = []
    for own in forms():
        made = own.begun(lane) if own.is_sought and own.same_as(lane) is None else None
        if made is not None:
            found.append(_candidate(own, made))
    return tuple(found)


def untried(name: str, lane: Lane) -> Candidate:
    """A form that was not tried since it would do the same as another (`indistinguishable`)."""
    return _candidate(form(name), form(name).from_neutral(lane))


def _candidate(own: EffectForm, made: Start) -> Candidate:
    starts = np.atleast_2d(made.values)
    full = np.hstack([starts, np.tile(NEVER_GATED, (len(starts), 1))])
    return Candidate(Term(own), full, made.free, np.asarray(made.scale, dtype=float), made.bounds)


def indistinguishable(part: Candidate, lane: Lane) -> tuple[str, ...]:
    """Forms that were not tried because on this lane they would do exactly the same as another; plainest first."""
    same = []
    for own in sorted(forms(), key=lambda own: own.plainness):
        other = own.same_as(lane) if own.is_sought else None
        if other is not None and other.name == part.name and abs(part.starts[0, 0]) < other.below:
            same.append(own.name)
    return tuple(same)


def smooth(lane: Lane, *, is_lean: bool = False) -> Candidate:
    """The correction without a name: a smooth function of configuration, direction and speed of the command.

    Args:
        is_lean: fit only what depends on the command alone.
    """
    low, high = lane.visited
    margin = 0.02 * (high - low) + 1e-6
    size = lane.command_size
    start = [low - margin, high - low + 2 * margin, size, *(0.0,) * (3 + 2 * SMOOTH_BUMPS), *NEVER_GATED]
    free = tuple(range(3, 6 if is_lean else 6 + 2 * SMOOTH_BUMPS))
    scale = [0.3, 0.5, 0.5 * size, *(0.5 * size,) * SMOOTH_BUMPS, *(0.5,) * SMOOTH_BUMPS]
    return Candidate(Term(form(UNNAMED)), np.array([start]), free, np.array(scale[: len(free)]))
