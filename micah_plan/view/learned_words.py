"""Learned results in words: sentences for pages and figures, and labels of their charts."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from micah_plan.automaton.certainty import CHANNEL_NAMES, ActionChannel, Deviation
from micah_plan.automaton.graph import Segment
from micah_plan.automaton.joint import Joint, JointKind, radius
from micah_plan.quantities import in_degrees, percent, quantity, with_spread
from micah_plan.summaries import listed
from micah_plan.view.learned import FLOOR, EvidenceLine, RunPicture, fits_no_joint

NO_BREAK = "\N{NO-BREAK SPACE}"
NO_FIT = "no single-joint model fits"
LEVELS = 2
"""Rows of names above a chart: what would overlap goes to the second."""

_AT_FLOOR = 0.5
_LEAST_REPORTED = 0.5  # probability of a deviation from which on it is reported
_LINE_OF_NAMES = 17  # letters

# Standard deviation of a turn [rad], and of a gain as a share of it, from which on a number would only mislead: motion
# along one straight line determines the gain along it but no rotation about it.
_OPEN = 0.35


def block_title(learned: RunPicture, *, several_runs: bool) -> str:
    """Part, run and finding: ``"door, run 2: revolute → rigid"``."""
    name = learned.edge.child + (f", run {learned.run}" if several_runs else "")
    return f"{name}: {headline(learned)}"


def block_words(learned: RunPicture) -> list[str]:
    """Changepoints, and the parameters of each joint that moves, one sentence each."""
    joints = {s.colored.color: s.segment for s in learned.stretches if not fits_no_joint(s.segment)}
    moving = [f"{s.joint.kind}: {joint_words(s)}" for s in joints.values() if s.joint.moves]
    return [changepoint_words(learned), *moving]


def block_notes(learned: RunPicture, *, recorded: bool) -> list[str]:
    """Notes on segments that joints explain badly, and on the action channel, one sentence each.

    Args:
        recorded: whether there are actions.
    """
    notes = [
        *(no_single_joint_sentence(stretch.segment) for stretch in learned.stretches),
        *deviation_notes([stretch.segment for stretch in learned.stretches]),
        channel_words(learned, recorded=recorded),
    ]
    return [capital(note) for note in notes if note]


def capital(words: str) -> str:
    """The words as the beginning of a sentence."""
    return words[:1].upper() + words[1:]


def any_fits_no_joint(learned: RunPicture) -> bool:
    """Whether some rows have no single joint."""
    return any(fits_no_joint(stretch.segment) for stretch in learned.stretches)


def headline(learned: RunPicture) -> str:
    """The finding in one line: ``"revolute → rigid"``, or that no single-joint model fits."""
    names = [NO_FIT if fits_no_joint(s.segment) else s.segment.joint.kind for s in learned.stretches]
    return " → ".join(names) if names else "no segments"


def changepoint_words(learned: RunPicture) -> str:
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
    if not joint.has_axis:
        return f"travels {quantity(travel, 'm')} along a curve"
    words = [f"travels {quantity(travel, 'm')}" if joint.slides else f"turns {in_degrees(travel)}"]
    words += [] if joint.slides else [f"radius {quantity(radius(joint), 'm')}"]
    words += [f"pitch {quantity(joint.pitch, 'm/rad')}"] if joint.climbs else []
    axis, center = _spread(joint, "axis"), _spread(joint, "center")
    words += [f"axis ± {in_degrees(axis, digits=2)}"] if axis is not None else []
    words += [f"centre ± {quantity(center, 'm', digits=2)}"] if center is not None else []
    return ", ".join(words)


def no_single_joint_sentence(segment: Segment) -> str:
    """The evidence against a single joint for a segment, in a sentence; empty if one fits."""
    no_single_joint = None if segment.certainty is None else segment.certainty.no_single_joint
    if no_single_joint is None:
        return ""
    missed = f"{quantity(no_single_joint.position, 'm')} (noise alone: {quantity(no_single_joint.position_noise, 'm')})"
    if no_single_joint.rotation is not None and no_single_joint.rotation_noise is not None:
        missed += (
            f" and {in_degrees(no_single_joint.rotation)} (noise alone: {in_degrees(no_single_joint.rotation_noise)})"
        )
    return (
        f"{NO_FIT} rows {segment.start} to {segment.end}: the best, {segment.joint.kind}, misses by {missed}; "
        f"log odds of free motion against it: {no_single_joint.log_odds:+.0f} nats"
    )


def deviation_notes(segments: Sequence[Segment]) -> list[str]:
    """Deviations of a part from its joints where they are unusually large, one sentence per joint."""
    rows: dict[tuple[JointKind, Deviation], list[str]] = {}
    for segment in segments:
        deviation = (
            None if segment.certainty is None or segment.no_single_joint is not None else segment.certainty.deviation
        )
        if deviation is not None and deviation.probability >= _LEAST_REPORTED:
            rows.setdefault((segment.joint.kind, deviation), []).append(f"{segment.start} to {segment.end}")
    notes = []
    for (kind, deviation), spans in rows.items():
        off = quantity(deviation.position, "m", digits=2)
        off += f" and {in_degrees(deviation.rotation, digits=2)}" if deviation.rotation else ""
        notes.append(
            f"rows {listed(spans)} lie off this {kind} joint by {off}, further than real joints usually do: it may be "
            "a mechanism of more than one axis"
        )
    return notes


def channel_words(learned: RunPicture, *, recorded: bool) -> str:
    """The action channel in words, with one standard deviation; empty without an estimate."""
    if not learned.assessed:
        return ""
    if not recorded:
        return "actions: none recorded"
    channel = learned.channel
    if any(stretch.colored.segment.joint.knots for stretch in learned.stretches):
        return "actions: their channel is not estimated along a path"
    if channel is None:
        return "actions: they do not explain the motion"
    return f"actions: {action_words(channel)}"


def action_words(channel: ActionChannel) -> str:
    """The action channel with one standard deviation each; undetermined quantities are named."""
    std = dict(zip(CHANNEL_NAMES, np.sqrt(np.diag(np.array(channel.covariance))), strict=True))
    turned, spread = channel_turn(channel)
    texts = {
        "gain": (with_spread(channel.gain, std["gain"], ""), std["gain"] < _OPEN * abs(channel.gain)),
        "delay": (with_spread(channel.delay, std["delay"], "s"), True),
        "frame rotation": (in_degrees(turned, spread), spread < _OPEN),
    }
    if channel.commands == "position":
        del texts["frame rotation"]
    words = [", ".join(f"{name} {text}" for name, (text, is_told) in texts.items() if is_told)]
    left_open = [name for name, (_, is_told) in texts.items() if not is_told]
    words += [f"{' and '.join(left_open)} not determined by this motion"] if left_open else []
    places = "places to get to; " if channel.commands == "position" else ""
    return f"{places}{'; '.join(words)}; they explain {percent(channel.explained, 0)} of the steps"


def channel_turn(channel: ActionChannel) -> tuple[float, float]:
    """(rotation of the action frame against the base frame, its std) [rad].

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
    """A segment's name and probability, centred at a time [s], on a level above the panel (0 is the lowest)."""

    text: str
    time: float
    level: int
    no_single_joint: bool


def segment_labels(learned: RunPicture, letter: float) -> tuple[SegmentLabel, ...]:
    """Labels of the segments; overlapping ones move up a level, or are omitted.

    Args:
        letter: how long one is on the axis [s].
    """
    ends = [-float("inf")] * LEVELS
    stretches_of_run = []
    for stretch in learned.stretches:
        segment = stretch.segment
        wrong = fits_no_joint(segment)
        share = dict(probability_words(segment)).get(segment.joint.kind, segment.probability)
        text = NO_FIT if wrong else f"{segment.joint.kind} {percent(share, 0)}"
        half = letter * len(text) / 2
        first, last = float(learned.time[0]), float(learned.time[-1])
        middle = float(np.mean(learned.when([segment.start, segment.end])))
        middle = min(max(middle, first + half), max(last - half, first))
        level = next((i for i, end in enumerate(ends) if middle - half > end), None)
        if level is not None:
            ends[level] = middle + half
            stretches_of_run.append(SegmentLabel(text, middle, level, wrong))
    return tuple(stretches_of_run)


def interval_labels(learned: RunPicture) -> list[tuple[int, str]]:
    """First row and name of every interval in which a segment starts with 95 % probability."""
    intervals = [stretch.interval for stretch in learned.stretches[1:] if stretch.interval is not None]
    return [(low, f"95 %: {low} to {high}" if high > low else f"95 %: {low}") for low, high in intervals]


def line_labels(lines: Sequence[EvidenceLine], step: float) -> list[tuple[float, str, bool]]:
    """(height [nats], text, whether a segment has this model) at least `step` apart; models that are ruled out share
    one.
    """
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
    """A model's display name: ``"rigid_2"`` is the second pose at rest."""
    kind, _, number = model.partition("_")
    kind = "free motion" if kind == "free" else kind
    return f"{kind} ({number})" if number else kind


def probability_words(segment: Segment) -> list[tuple[str, float]]:
    """Kinds of joint, and no single joint, with their probabilities, the most probable first."""
    kinds = [] if segment.certainty is None else [(str(kind), p) for kind, p in segment.certainty.kinds]
    none = max(0.0, 1.0 - sum(p for _, p in kinds))
    return sorted([*kinds, ("no single joint", none)], key=lambda pair: -pair[1])


def kind_words(segment: Segment) -> tuple[str, str]:
    """The most probable kind with its probability, and the second one unless excluded."""
    ranked = [f"{name} {percent(p, 0)}" if p >= 0.005 else "" for name, p in probability_words(segment)]
    return ranked[0], "".join(ranked[1:2])


def shown_counts(learned: RunPicture, least: int = 3) -> tuple[float, ...]:
    """Probabilities of 0, 1, 2, ... changepoints that matter, at least `least` of them."""
    counts = learned.counts + (0.0,) * (least - len(learned.counts))
    matter = [number for number, probability in enumerate(counts) if probability >= 0.005]
    return counts[: max(least, max(matter, default=0) + 1)]
