"""Verdict on a coordinate: an ordered list of outcomes, of which the first that applies is returned."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from micah_plan.residual import messages
from micah_plan.residual.messages import Verdict

UNEXPLAINED = 0.5
"""Share of the explainable residual that effects leave to a correction without a name, from which on they only imitate
it."""


@dataclass(frozen=True)
class Facts:
    """Facts about a coordinate after the search for effects.

    Attributes:
        effects: how many have a name; modes: how many the automaton lacks.
        is_open: whether an effect may come from this command or from earlier ones.
        is_contradicted: whether one of few runs is evidence against effects fitted to the others.
        is_longer: whether held-out roll-outs get worse with the effects.
        is_noisier: whether held-out single steps get worse with the effects.
        is_single: whether there is only one run with few motions, which no other run can confirm.
        is_following: whether innovations certainly follow something, and by more than a trifle.
        is_changing: whether effects have different onsets: it changed twice, so it may still be changing.
        is_averaged: whether steps follow averages of commands over rows before and after.
        smooth: share of the explainable residual that a correction without a name takes out on top; 0: none.
        is_passing: whether one run alone shows an additional effect or its onset.
        is_corrected: whether the nominal model already had an unnamed correction.
    """

    effects: int
    modes: int
    is_open: bool
    smooth: float
    is_passing: bool = False
    is_corrected: bool = False
    is_contradicted: bool = False
    is_longer: bool = False
    is_noisier: bool = False
    is_single: bool = False
    is_changing: bool = False
    is_following: bool = False
    is_averaged: bool = False

    @property
    def is_kept_out(self) -> bool:
        """Whether a wrong effect would be worse than the model without it."""
        return self.is_open or self.is_contradicted or self.is_longer


@dataclass(frozen=True)
class Outcome:
    """A possible conclusion about a coordinate, with its verdict."""

    name: str
    verdict: Verdict

    @property
    def sentence(self) -> str:
        """The conclusion in words."""
        return messages.OUTCOMES[self.name]


OUTCOMES: tuple[tuple[Outcome, Callable[[Facts], bool]], ...] = (
    (Outcome("mode", "partly"), lambda f: f.modes > 0),
    (Outcome("averaged", "partly"), lambda f: f.is_averaged and f.effects > 0),
    (Outcome("averaged alone", "none"), lambda f: f.is_averaged),
    (
        Outcome("unnamed", "unexplained"),
        lambda f: (
            f.smooth > UNEXPLAINED
            or (not f.effects and (f.smooth > 0 or f.is_corrected or (f.is_following and not f.is_passing)))
        ),
    ),
    (Outcome("remembered", "partly"), lambda f: f.is_open),
    (Outcome("longer", "partly"), lambda f: f.is_longer),
    (Outcome("passing", "partly"), lambda f: f.is_passing),
    (Outcome("more", "partly"), lambda f: f.smooth > 0.0 or f.is_corrected),
    (Outcome("contradicted", "partly"), lambda f: f.is_contradicted),
    (Outcome("single", "partly"), lambda f: f.effects > 0 and f.is_single),
    (Outcome("changing", "partly"), lambda f: f.is_changing),
    (Outcome("noisier", "partly"), lambda f: f.is_noisier),
    (Outcome("not white", "partly"), lambda f: f.is_following),
    (Outcome("named", "explained"), lambda f: f.effects > 0),
    (Outcome("nothing", "none"), lambda _: True),
)
"""Outcomes with their conditions, in order of precedence."""


def outcome_of(facts: Facts) -> Outcome:
    """The first outcome that applies to the facts."""
    return next(outcome for outcome, holds in OUTCOMES if holds(facts))


def overall(verdicts: list[Verdict]) -> Verdict:
    """The joint verdict of several coordinates: `none` is neutral, differing verdicts give `partly`."""
    found = {verdict for verdict in verdicts if verdict != "none"}
    if not found:
        return "none"
    return found.pop() if len(found) == 1 else "partly"
