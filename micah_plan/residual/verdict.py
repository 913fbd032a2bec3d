"""Verdict on a coordinate: an ordered list of outcomes, of which the first that applies is returned."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

Verdict = Literal["none", "explained", "partly", "unexplained"]
SENTENCES: dict[Verdict, str] = {
    "none": "the model lacks nothing that this recording can show",
    "explained": "the effects explain what the model lacked",
    "partly": "the effects explain a part of what the model lacks",
    "unexplained": "the model lacks something that no effect of the library explains",
}

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
        is_longer: whether roll-outs of held-out rows get longer with what was found.
        is_noisier: whether single steps of held-out rows get longer with what was found.
        is_single: whether there is one run of few motions alone, which no other run can confirm.
        is_following: whether innovations certainly follow something, and by more than a trifle.
        is_changing: whether effects began at different times: what changed twice may be changing still.
        is_averaged: whether steps follow averages of commands over rows before and after.
        smooth: share of the explainable residual that a correction without a name takes out on top; 0: none.
        is_passing: whether one run alone shows that there is something more, or that it began.
        is_corrected: whether the model came with a correction without a name.
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
    """A possible conclusion with its verdict.

    Attributes:
        sentence: of a coordinate, in plain words.
    """

    name: str
    verdict: Verdict
    sentence: str


OUTCOMES: tuple[tuple[Outcome, Callable[[Facts], bool]], ...] = (
    (Outcome("mode", "partly", "a mode of its own is missing"), lambda f: f.modes > 0),
    (
        Outcome(
            "averaged",
            "partly",
            "steps follow averages of the commands over rows before and after, so effects are blurred",
        ),
        lambda f: f.is_averaged and f.effects > 0,
    ),
    (
        Outcome(
            "averaged alone",
            "none",
            "the model leaves noise alone, but for commands that are averaged over rows before and after",
        ),
        lambda f: f.is_averaged,
    ),
    (
        Outcome("unnamed", "unexplained", "what is left follows something that no effect names"),
        lambda f: (
            f.smooth > UNEXPLAINED
            or (not f.effects and (f.smooth > 0 or f.is_corrected or (f.is_following and not f.is_passing)))
        ),
    ),
    (
        Outcome("remembered", "partly", "with runs like these the effect may as well come from earlier commands"),
        lambda f: f.is_open,
    ),
    (
        Outcome("longer", "partly", "roll-outs of rows that were held out get longer with it"),
        lambda f: f.is_longer,
    ),
    (
        Outcome("passing", "partly", "one run alone shows that there is more, and no other run can confirm it"),
        lambda f: f.is_passing,
    ),
    (
        Outcome("more", "partly", "a correction without a name predicts clearly better on top of the effects"),
        lambda f: f.smooth > 0.0 or f.is_corrected,
    ),
    (
        Outcome(
            "contradicted",
            "partly",
            "one of so few runs is predicted worse by what the others show, so more runs must tell",
        ),
        lambda f: f.is_contradicted,
    ),
    (
        Outcome("single", "partly", "one run of a few motions shows it, and no other run can confirm it"),
        lambda f: f.effects > 0 and f.is_single,
    ),
    (
        Outcome(
            "changing",
            "partly",
            "it changed more than once on the way, by steps or little by little, so it may go on changing",
        ),
        lambda f: f.is_changing,
    ),
    (
        Outcome(
            "noisier", "partly", "single steps get longer with it, so what it leaves is no noise of readings alone"
        ),
        lambda f: f.is_noisier,
    ),
    (
        Outcome("not white", "partly", "what is left is no noise, but nothing that helps in roll-outs names it"),
        lambda f: f.is_following,
    ),
    (Outcome("named", "explained", "the effects leave noise alone"), lambda f: f.effects > 0),
    (Outcome("nothing", "none", "the model leaves noise alone"), lambda _: True),
)
"""What may be said of a coordinate, and whether the facts allow it."""


def outcome_of(facts: Facts) -> Outcome:
    """The first outcome that applies to the facts."""
    return next(outcome for outcome, holds in OUTCOMES if holds(facts))


def overall(verdicts: list[Verdict]) -> Verdict:
    """The joint verdict of several coordinates: `none` is neutral, differing verdicts give `partly`."""
    said = {verdict for verdict in verdicts if verdict != "none"}
    if not said:
        return "none"
    return said.pop() if len(said) == 1 else "partly"
