"""What learning found and how sure it is, in words: sentences for pages and figures, and the labels of their charts."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from micah_plan.automaton.certainty import CHANNEL_NAMES, ActionChannel
from micah_plan.automaton.graph import Segment
from micah_plan.automaton.joint import Joint, radius
from micah_plan.quantities import in_degrees, percent, quantity, with_spread
from micah_plan.view.learned import FLOOR, EvidenceLine, LearnedRun, is_misfit

NO_BREAK = "\N{NO-BREAK SPACE}"
NO_FIT = "no single-joint model fits"
LEVELS = 2
"""Rows of names above a chart: what would overlap goes to the second."""

_AT_FLOOR = 0.5
_LINE_OF_NAMES = 17  # letters


def block_title(learned: LearnedRun, *, several_runs: bool) -> str:
    """Part, run and finding: ``"door, run 2: revolute → rigid"``."""
    name = learned.edge.child + (f", run {learned.run}" if several_runs else "")
    return f"{name}: {headline(learned)}"


def block_words(learned: LearnedRun) -> list[str]:
    """Changepoints, and the parameters of each joint that moves, one sentence each."""
    joints = {s.colored.color: s.segment for s in learned.stretches if not is_misfit(s.segment)}
    moving = [f"{s.joint.kind}: {joint_words(s)}" for s in joints.values() if s.joint.moves]
    return [changepoint_words(learned), *moving]


def block_notes(learned: LearnedRun, *, recorded: bool) -> list[str]:
    """What no joint explains, and how actions move the part, one sentence each; `recorded`: whether there are any."""
    notes = [
        *(misfit_words(stretch.segment) for stretch in learned.stretches),
        channel_words(learned, recorded=recorded),
    ]
    return [capital(note) for note in notes if note]


def capital(words: str) -> str:
    """The words as the beginning of a sentence."""
    return words[:1].upper() + words[1:]


def has_misfit(learned: LearnedRun) -> bool:
    """Whether no single joint explains some of the rows."""
    return any(is_misfit(stretch.segment) for stretch in learned.stretches)


def headline(learned: LearnedRun) -> str:
    """The finding in one line: ``"revolute → rigid"``, or that no single-joint model fits."""
    names = [NO_FIT if is_misfit(s.segment) else s.segment.joint.kind for s in learned.stretches]
    return " → ".join(names) if names else "no segments"


def changepoint_words(learned: LearnedRun) -> str:
    """Where segments start: ``"changepoint at row 40 (95 % interval: 38 to 42)"``."""
    starts = []
    for stretch in learned.stretches[1:]:
        low, high = stretch.interval or (0, 0)
        sure = f" (95 % interval: {low} to {high})" if stretch.interval else ""
        starts.append(f"row {stretch.segment.start}{sure}")
    if not starts:
        return "no changepoint"
    return f"changepoint{'s' if len(starts) > 1 else ''} at {', '.join(starts)}"


def joint_words(segment: Segment) -> str:
    """A joint's parameters with one standard deviation: ``"turns 69°, radius 300 mm, axis ± 0.8°, centre ± 2 mm"``."""
    joint = segment.joint
    if not joint.moves:
        return "at rest"
    travel = segment.configuration_range[1] - segment.configuration_range[0]
    if joint.kind == "path":
        return f"travels {quantity(travel, 'm')} along a curve"
    words = [f"travels {quantity(travel, 'm')}" if joint.kind == "prismatic" else f"turns {in_degrees(travel)}"]
    words += [] if joint.kind == "prismatic" else [f"radius {quantity(radius(joint), 'm')}"]
    words += [f"pitch {quantity(joint.pitch, 'm/rad')}"] if joint.kind == "screw" else []
    axis, center = _spread(joint, "axis"), _spread(joint, "center")
    words += [f"axis ± {in_degrees(axis, digits=2)}"] if axis is not None else []
    words += [f"centre ± {quantity(center, 'm', digits=2)}"] if center is not None else []
    return ", ".join(words)


def misfit_words(segment: Segment) -> str:
    """Why no single joint explains a segment, with the numbers; empty if one does."""
    misfit = None if segment.certainty is None else segment.certainty.misfit
    if misfit is None:
        return ""
    missed = f"{quantity(misfit.position, 'm')} (noise alone: {quantity(misfit.position_noise, 'm')})"
    if misfit.rotation is not None and misfit.rotation_noise is not None:
        missed += f" and {in_degrees(misfit.rotation)} (noise alone: {in_degrees(misfit.rotation_noise)})"
    return (
        f"{NO_FIT} rows {segment.start} to {segment.end}: the best, {segment.joint.kind}, misses by {missed}; "
        f"log odds of free motion against it: {misfit.log_odds:+.0f} nats"
    )


def channel_words(learned: LearnedRun, *, recorded: bool) -> str:
    """How the recorded actions move the part, with one standard deviation; empty if it was not estimated."""
    if not learned.assessed:
        return ""
    if not recorded:
        return "actions: none recorded"
    channel = learned.channel
    if any(stretch.colored.segment.joint.kind == "path" for stretch in learned.stretches):
        return "actions: their channel is not estimated along a path"
    if channel is None:
        return "actions: they do not explain the motion"
    return f"actions: {action_words(channel)}"


def action_words(channel: ActionChannel) -> str:
    """What actions make of the part's steps, with one standard deviation each."""
    std = dict(zip(CHANNEL_NAMES, np.sqrt(np.diag(np.array(channel.covariance))), strict=True))
    delay = f"{with_spread(abs(channel.delay), std['delay'], 's')} {'after' if channel.delay >= 0 else 'before'} it"
    if abs(channel.delay) < std["delay"]:
        delay = f"at the same time (± {quantity(std['delay'], 's', digits=2)})"
    angle, spread = channel_turn(channel)
    turned = f"turned by {in_degrees(angle, spread)}"
    frame = f"in a frame {turned}" if angle > 2 * spread else f"in the base frame ({turned})"
    return (
        f"they explain {percent(channel.explained, 0)} of the steps; the part makes "
        f"{with_spread(channel.gain, std['gain'], '')} of a recorded action, {delay}; it is given {frame}"
    )


def channel_turn(channel: ActionChannel) -> tuple[float, float]:
    """By how much the frame of the actions is turned against the base frame, and one standard deviation [rad].

    Along the rotation's own axis its spread is that of the angle; without a rotation the widest direction counts.
    """
    vector = np.array(channel.frame_rotation)
    covariance = np.array(channel.covariance)[:3, :3]
    angle = float(np.linalg.norm(vector))
    if angle > 1e-9:
        return angle, math.sqrt(max(float(vector @ covariance @ vector), 0.0)) / angle
    return angle, math.sqrt(max(float(np.linalg.eigvalsh(covariance).max()), 0.0))


def _spread(joint: Joint, name: str) -> float | None:
    """One standard deviation of axis [rad] or centre [m] in its widest direction; None if not estimated."""
    if joint.covariance is None:
        return None
    names = joint.covariance.names
    index = [names.index(f"{name}_{i}") for i in (1, 2) if f"{name}_{i}" in names]
    if len(index) < 2:
        return None
    block = np.array(joint.covariance.matrix)[np.ix_(index, index)]
    return math.sqrt(max(float(np.linalg.eigvalsh(block).max()), 0.0))


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
        own = dict(kind_probabilities(segment)).get(segment.joint.kind, segment.probability)
        text = NO_FIT if wrong else f"{segment.joint.kind} {percent(own, 0)}"
        half = rows_per_letter * len(text) / 2
        first, last = float(learned.rows[0]), float(learned.rows[-1])
        middle = min(max((segment.start + segment.end) / 2, first + half), max(last - half, first))
        level = next((i for i, end in enumerate(ends) if middle - half > end), None)
        if level is not None:
            ends[level] = middle + half
            found.append(SegmentLabel(text, middle, level, wrong))
    return tuple(found)


def interval_labels(learned: LearnedRun) -> list[tuple[int, str]]:
    """First row and name of every interval in which a segment starts with 95 % probability."""
    found = [stretch.interval for stretch in learned.stretches[1:] if stretch.interval is not None]
    return [(low, f"95 %: {low} to {high}" if high > low else f"95 %: {low}") for low, high in found]


def line_labels(lines: Sequence[EvidenceLine], step: float) -> list[tuple[float, str, bool]]:
    """(height [nats], text, whether a segment has this model), moved `step` apart; what is ruled out shares a label."""
    ending = [(float(line.values[-1]), model_name(line.model), line.color is not None) for line in lines]
    wanted = [label for label in ending if label[0] > FLOOR + _AT_FLOOR]
    names = [name for value, name, _ in ending if value <= FLOOR + _AT_FLOOR]
    listed = ", ".join(name.replace(" ", NO_BREAK) for name in names)
    out = ["ruled out:", *wrapped(listed, _LINE_OF_NAMES)] if names else []
    placed = [(FLOOR - step * i, text, False) for i, text in enumerate(out)]
    below = FLOOR if placed else -float("inf")
    for value, text, used in sorted(wanted):
        below = max(value, below + step)
        placed.append((below, text, used))
    return placed


def wrapped(text: str, most: int) -> list[str]:
    """Lines of at most `most` letters, broken where spaces are not no-break ones, which become plain."""
    return [line.replace(NO_BREAK, " ") for line in textwrap.wrap(text, most)]


def model_name(model: str) -> str:
    """A model's name as people read it: ``"rigid_2"`` is the second pose at rest."""
    kind, _, number = model.partition("_")
    kind = "free motion" if kind == "free" else kind
    return f"{kind} ({number})" if number else kind


def kind_probabilities(segment: Segment) -> list[tuple[str, float]]:
    """Kinds of joint and free motion with their probabilities, the most probable first."""
    kinds = [] if segment.certainty is None else [(str(kind), p) for kind, p in segment.certainty.kinds]
    free = max(0.0, 1.0 - sum(p for _, p in kinds))
    return sorted([*kinds, ("free motion", free)], key=lambda pair: -pair[1])


def kind_words(segment: Segment) -> tuple[str, str]:
    """The most probable kind with its probability, and the next one, empty if it is out of the question."""
    ranked = [f"{name} {percent(p, 0)}" if p >= 0.005 else "" for name, p in kind_probabilities(segment)]
    return ranked[0], "".join(ranked[1:2])


def shown_counts(learned: LearnedRun, least: int = 3) -> tuple[float, ...]:
    """Probabilities of 0, 1, 2, ... changepoints, as far as they matter, and at least `least`."""
    counts = learned.counts + (0.0,) * (least - len(learned.counts))
    matter = [number for number, probability in enumerate(counts) if probability >= 0.005]
    return counts[: max(least, max(matter, default=0) + 1)]
