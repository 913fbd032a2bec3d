"""What stands beside and above the curves of learning, and where: names of segments and models, probabilities."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from micah_plan.automaton.graph import Segment
from micah_plan.view.certainty_words import NO_FIT
from micah_plan.view.learned import FLOOR, EvidenceLine, LearnedRun
from micah_plan.view.segments import is_misfit

LEVELS = 2
_AT_FLOOR = 0.5
_LINE_OF_NAMES = 17  # letters


@dataclass(frozen=True)
class SegmentLabel:
    """A segment's name and probability, centred at a row, on a level above the panel (0 is the lowest)."""

    text: str
    row: float
    level: int
    misfit: bool


def segment_labels(learned: LearnedRun, rows_per_letter: float) -> tuple[SegmentLabel, ...]:
    """Names of the segments; what would overlap goes a level up, or away."""
    ends = [-float("inf")] * LEVELS
    found = []
    for stretch in learned.stretches:
        segment = stretch.segment
        wrong = is_misfit(segment)
        text = NO_FIT if wrong else f"{segment.joint.kind} {percents(kind_probability(segment))}"
        half = rows_per_letter * len(text) / 2
        first, last = float(learned.rows[0]), float(learned.rows[-1])
        middle = min(max((segment.start + segment.end) / 2, first + half), max(last - half, first))
        level = next((i for i, end in enumerate(ends) if middle - half > end), None)
        if level is not None:
            ends[level] = middle + half
            found.append(SegmentLabel(text, middle, level, wrong))
    return tuple(found)


def line_labels(lines: Sequence[EvidenceLine], step: float) -> list[tuple[float, str, bool]]:
    """(height [nats], text, whether a segment has this model), moved `step` apart; what is ruled out shares a label."""
    ending = [(float(line.values[-1]), model_name(line.model), line.color is not None) for line in lines]
    wanted = [label for label in ending if label[0] > FLOOR + _AT_FLOOR]
    names = [name for value, name, _ in ending if value <= FLOOR + _AT_FLOOR]
    out = ["ruled out:", *_lines(names)] if names else []
    placed = [(FLOOR - step * i, text, False) for i, text in enumerate(out)]
    below = FLOOR if placed else -float("inf")
    for value, text, used in sorted(wanted):
        below = max(value, below + step)
        placed.append((below, text, used))
    return placed


def _lines(names: Sequence[str]) -> list[str]:
    """Names with commas, in short lines; a name that has a space stays in one."""
    listed = ", ".join(name.replace(" ", "\N{NO-BREAK SPACE}") for name in names)
    return [line.replace("\N{NO-BREAK SPACE}", " ") for line in textwrap.wrap(listed, _LINE_OF_NAMES)]


def model_name(model: str) -> str:
    """A model's name as people read it: ``"rigid_2"`` is the second pose at rest."""
    kind, _, number = model.partition("_")
    kind = "free motion" if kind == "free" else kind
    return f"{kind} ({number})" if number else kind


def kind_probability(segment: Segment) -> float:
    """Probability of a segment's own kind of joint."""
    kinds = () if segment.certainty is None else segment.certainty.kinds
    return dict(kinds).get(segment.joint.kind, segment.probability)


def kind_probabilities(segment: Segment) -> list[tuple[str, float]]:
    """Kinds of joint and free motion with their probabilities, the most probable first."""
    kinds = [] if segment.certainty is None else [(str(kind), p) for kind, p in segment.certainty.kinds]
    free = max(0.0, 1.0 - sum(p for _, p in kinds))
    return sorted([*kinds, ("free motion", free)], key=lambda pair: -pair[1])


def shown_counts(learned: LearnedRun, least: int = 3) -> tuple[float, ...]:
    """Probabilities of 0, 1, 2, ... changepoints, as far as they matter, and at least so many."""
    counts = learned.counts + (0.0,) * (least - len(learned.counts))
    matter = [number for number, probability in enumerate(counts) if probability >= 0.005]
    return counts[: max(least, max(matter, default=0) + 1)]


def percents(probability: float) -> str:
    """Whole percents, but never a false 0 or 100."""
    if 0.0 < probability < 0.005:
        return "<1 %"
    return ">99 %" if 0.995 < probability < 1.0 else f"{100 * probability:.0f} %"
