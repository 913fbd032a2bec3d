"""Offers: changes to a problem that a remedy can name, as words, as a changed problem, and with their number."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from micah_plan.planning.limits import limits_of
from micah_plan.quantities import plain
from micah_plan.task.problem import Problem
from micah_plan.task.reason import Offer, OfferKind

# Factors of 2 and 1/2 are tried first where no amount was computed.
MORE_KNOTS = Offer("raise max_knots", "raise max_knots to", "max_knots", ((0, 2.0),))
MORE_STATES = Offer("raise samples_per_mode", "raise samples_per_mode to", "samples_per_mode", ((0, 2.0),))
LONGER_SEARCH = Offer("raise search_limit", "raise search_limit to", "search_limit", ((0, 2.0),))
MORE_CANDIDATES = Offer("raise candidates", "raise candidates to", "candidates", ((0, 2.0),))
LARGER_STEPS = Offer("raise max_step", "", "max_step", ((0, 2.0),))
LESS_NOISE = Offer("lower the noise", "", "noise", ((0, 0.5),))
SURER_START = Offer("lower the start's std", "", "start_std", ((0, 0.5),))
MORE_CONFIDENCE = Offer("raise `confidence` (more room)", "raise `confidence` (more room) to", "surer", ((0, 2.0),))
# Of what has no number to be written: how much of it, by factors that are tried.
_SHARES = {0.125: "an eighth of it", 0.5: "half of it", 2.0: "twice as much", 8.0: "eight times as much"}
# What counted factors are multiplied with if they do not suffice.
_MARGIN = 2.0
# Offers that change a setting; what is no count among them has a rule of its own (`_setting`).
_SETTINGS: tuple[OfferKind, ...] = (
    "confidence", "surer", "revisits", "max_step", "max_knots", "samples_per_mode", "search_limit", "candidates",
)  # fmt: skip


def more_knots(factor: float) -> Offer:
    """The offer of `factor` times as many knots, where the need was counted; only a margin is added."""
    return replace(MORE_KNOTS, values=((0, factor),), growth=_MARGIN)


def larger_steps(factor: float) -> Offer:
    """The offer of steps larger by a computed factor."""
    return replace(LARGER_STEPS, values=((0, factor),), growth=_MARGIN)


def lower_confidence(confidence: float) -> Offer:
    """The offer of a lower confidence."""
    return Offer("lower `confidence`", "lower `confidence` to", "confidence", ((0, confidence),))


def moved_target(index: int, value: float) -> Offer:
    """The offer to move the target of a coordinate into the range."""
    return Offer("move its target into the range", "move its target to", "target", ((index, value),))


def more_revisits(revisits: int, words: str = "raise revisits") -> Offer:
    """The offer to allow `revisits` returns to a mode."""
    return Offer(words, f"{words} to", "revisits", ((0, revisits),))


def changed(problem: Problem, offer: Offer) -> Problem:
    """The problem with the change."""
    values = dict(offer.values)
    if offer.kind in _SETTINGS:
        name, value = _setting(problem, offer)
        return replace(problem, settings=replace(problem.settings, **{name: value}))
    if offer.kind == "noise":
        noise, factor = problem.automaton.noise, values[0]
        process, seen = (tuple(factor * s for s in stds) for stds in (noise.process_std, noise.observation_std))
        quieter = replace(noise, process_std=process, observation_std=seen)
        return replace(problem, automaton=replace(problem.automaton, noise=quieter))
    if offer.kind == "start_std":
        return replace(problem, start=replace(problem.start, std=tuple(values[0] * s for s in problem.start.std)))
    if offer.kind == "root" and problem.robot is not None:
        return replace(problem, robot=replace(problem.robot, position=(values[0], values[1], values[2])))
    if offer.kind == "start":
        mean = tuple(values.get(i, mean) for i, mean in enumerate(problem.start.mean))
        return replace(problem, start=replace(problem.start, mean=mean))
    target = tuple(
        (i, values.get(i, value), tol) if offer.kind == "target" else (i, value, values.get(i, tol))
        for i, value, tol in problem.goal.target
    )
    return replace(problem, goal=replace(problem.goal, target=target))


def _setting(problem: Problem, offer: Offer) -> tuple[str, Any]:
    """(name, new value) of the setting that an offer changes."""
    kind, value = offer.kind, offer.values[0][1]
    if kind == "surer":
        return "confidence", _with_fewer_failures(problem, value)
    if kind == "max_step":
        return kind, tuple((value * limits_of(problem).max_step).tolist())
    if kind in ("confidence", "revisits"):
        return kind, int(value) if kind == "revisits" else value
    return kind, round(value * getattr(problem.settings, kind))


def _with_fewer_failures(problem: Problem, factor: float) -> float:
    """The confidence whose failure probability is divided by the square of a factor, to four digits."""
    return round(1.0 - (1.0 - problem.settings.confidence) / (factor * factor), 4)


def with_printable_numbers(offer: Offer) -> Offer:
    """The offer with printable numbers: tolerances rounded up, confidences down."""
    if offer.kind == "confidence":
        return replace(offer, values=((0, math.floor(100.0 * offer.values[0][1] + 1e-9) / 100.0),))
    if offer.kind == "root":
        return replace(offer, values=tuple((i, round(value, 2)) for i, value in offer.values))
    if offer.kind in _SETTINGS:
        return offer
    if offer.kind != "tolerance":
        return replace(offer, values=tuple((i, float(f"{value:.4g}")) for i, value in offer.values))
    return replace(offer, values=tuple((i, _rounded_up(value)) for i, value in offer.values))


def _rounded_up(value: float) -> float:
    """The next larger number of three significant digits."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return float(f"{math.ceil(value / unit - 1e-9) * unit:.3g}")


def in_words(problem: Problem, offer: Offer) -> str:
    """The offer in words with its numbers as in the file; noise and steps as factors."""
    value = offer.values[0][1]
    if offer.kind in ("noise", "start_std", "max_step"):
        return f"{offer.words} ({_SHARES.get(value, f'{value:,.0f} times as much')} suffices)"
    if offer.kind in _SETTINGS:
        _, number = _setting(problem, offer)
        return f"{offer.named} {number:.2f}" if offer.kind == "confidence" else f"{offer.named} {number}"
    return f"{offer.named} {_numbers(problem, offer)}"


def _numbers(problem: Problem, offer: Offer) -> str:
    """The values of tolerances, targets, starts and places, as text with units."""
    if offer.kind == "root":
        return f"[{', '.join(_text(value) for _, value in offer.values)}] m"
    coordinates = problem.automaton.coordinates
    # The coordinate that the words name comes first: its number follows them.
    named = sorted(offer.values, key=lambda pair: f"'{coordinates[pair[0]].name}'" not in offer.words)
    first, *others = [(coordinates[i], value) for i, value in named]
    texts = [f"{_text(first[1])} {first[0].unit}"]
    texts += [f"that of '{c.name}' to {_text(value)} {c.unit}" for c, value in others]
    return texts[0] if len(texts) == 1 else ", ".join(texts[:-1]) + f" and {texts[-1]}"


def _text(value: float) -> str:
    return plain(value, 6)
