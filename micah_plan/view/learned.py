"""What learning found, as pages and figures show it: segments with colours and names, and the series of each run.

Source: Page, Biometrika 1954, for cumulated evidence that a floor keeps ready to rise (`EvidenceLine`).

**In words.** What learning found and how sure it is, in words: sentences for pages and figures, and the labels of their
charts.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.arrays import Floats, Ints
from micah_plan.automaton.graph import (
    BASE,
    CHANNEL_NAMES,
    ActionChannel,
    Deviation,
    EvidenceTrace,
    KinematicEdge,
    KinematicGraph,
    Segment,
)
from micah_plan.automaton.joint import Joint, JointKind, radius
from micah_plan.automaton.kinematics import inverse
from micah_plan.quantities import in_degrees, listed, percent, quantity, with_spread
from micah_plan.recording.value import Recording
from micah_plan.view.palette import NO_SINGLE_JOINT, category

FLOOR = -10.0
"""Where a model counts as ruled out [nats]: odds of 1 to 22,000 against the best single one."""

_IMPOSSIBLE = -1e6
_REPLACED = 2.0
"""Around a start with a posterior over single rows, traced rows within this many of their distances are left out."""
_NEARLY_A_TURN = 0.9 * np.pi


NO_JOINT = "no single joint"

_SAME_DIRECTION = np.cos(np.radians(20.0))
_SAME_SHARE = 0.2
_SAME_PLACE_M = 0.01


@dataclass(frozen=True, eq=False)
class ColoredSegment:
    """A segment as pages and figures show it.

    Attributes:
        segment, edge: the segment and whose it is.
        color: one colour stands for one joint: a segment that returns to an earlier joint of its part has its again.
        name, label: the joint's kind, and the entry in the legend.
        rows: (k,) of the recording that belong to it.
    """

    segment: Segment
    edge: KinematicEdge
    color: str
    name: str
    label: str
    rows: Ints


def colored_segments(recording: Recording, graph: KinematicGraph | None) -> tuple[ColoredSegment, ...]:
    """All segments of a graph in order, each with the colour of its joint; what fits no joint has its own colour."""
    edges = () if graph is None else graph.edges
    coloured: list[ColoredSegment] = []
    joints = 0
    for edge in edges:
        earlier: list[tuple[Joint, str]] = []
        visited = [c for s in edge.segments for c in s.configuration_range]
        for segment in edge.segments:
            name, color = NO_JOINT, NO_SINGLE_JOINT
            if not fits_no_joint(segment):
                same = [shade for joint, shade in earlier if _same_joint(joint, segment.joint, float(np.ptp(visited)))]
                name, color = segment.joint.kind, same[0] if same else category(joints)
                if not same:
                    earlier.append((segment.joint, color))
                    joints += 1
            label = f"{name}, rows {segment.start} to {segment.end}"
            label = f"{edge.child}: {label}" if len(edges) > 1 else label
            of_run = rows_of_run(recording, edge, segment.run)
            rows = of_run[(of_run >= segment.start) & (of_run <= segment.end)]
            coloured.append(ColoredSegment(segment, edge, color, name, label, rows))
    return tuple(coloured)


def fits_no_joint(segment: Segment) -> bool:
    """Whether no single joint explains the segment."""
    return segment.certainty is not None and segment.certainty.no_single_joint is not None


def rows_of_run(recording: Recording, edge: KinematicEdge, run: int) -> Ints:
    """Rows of the recording in which the edge's part was measured in a run, in order."""
    of_run = recording.run == run
    if edge.child in recording.parts:
        of_run = of_run & (np.array(recording.part) == edge.child)
    return np.flatnonzero(of_run)


def parent_poses(recording: Recording, edge: KinematicEdge, run: int, rows: Ints) -> RigidTransform:
    """(k,) poses of the edge's parent in the base frame, measured closest in time to the rows (k,) of a run."""
    of_parent = np.flatnonzero((np.array(recording.part) == edge.parent) & (recording.run == run))
    if edge.parent == BASE or not len(of_parent):
        return RigidTransform.identity(len(rows))
    times, wanted = recording.time[of_parent], recording.time[rows]
    after = np.clip(np.searchsorted(times, wanted), 1, max(len(times) - 1, 1)) % len(times)
    before = np.maximum(after - 1, 0)
    nearest = np.where(wanted - times[before] <= times[after] - wanted, before, after)
    return recording.poses()[of_parent[nearest]]


def _same_joint(a: Joint, b: Joint, span: float) -> bool:
    """Whether two joints of one part look like one; `span` is the range of its configurations [rad or m]."""
    if a.kind != b.kind:
        return False
    apart = np.subtract(b.position, a.position)
    if not a.moves:
        by_pose = float(np.linalg.norm(apart)) <= _SAME_PLACE_M
        return abs(a.fixed_at - b.fixed_at) <= _SAME_SHARE * span if span > 0 else by_pose
    if not a.has_axis:
        return a.knots == b.knots
    if abs(float(np.dot(a.axis, b.axis))) < _SAME_DIRECTION:
        return False
    between = np.subtract(b.center, a.center)
    aside = np.linalg.norm(between - np.dot(between, a.axis) * np.array(a.axis))
    return a.slides or float(aside) <= _SAME_SHARE * max(radius(a), radius(b)) + _SAME_PLACE_M


@dataclass(frozen=True, eq=False)
class Stretch:
    """A segment in a run.

    Attributes:
        colored: the segment with its colour and name.
        rows: (k,) its rows.
        measured: (k,) configuration by the closest joint that moves, or displacement from the run's first row [m].
    """

    colored: ColoredSegment
    rows: Ints
    measured: Floats

    @property
    def segment(self) -> Segment:
        return self.colored.segment

    @property
    def interval(self) -> tuple[int, int] | None:
        """Rows (both inclusive) between which it starts with 95 % probability; None if not estimated."""
        certainty = self.segment.certainty
        return None if certainty is None or certainty.start is None else certainty.start.interval()


@dataclass(frozen=True, eq=False)
class EvidenceLine:
    """The evidence for one model against the best single one, cumulated from row to row but never below `FLOOR`.

    Attributes:
        model: its name.
        color: of the joint that it stands for in this run; None if it governs no segment.
        values: (n,) [nats]; all 0 for the best single model itself.
    """

    model: str
    color: str | None
    values: Floats


@dataclass(frozen=True)
class ChangeBar:
    """The posterior probability that a segment starts at a row, or at one of the `width` rows around it."""

    row: float
    probability: float
    width: float


@dataclass(frozen=True, eq=False)
class RunPicture:
    """One run of one part: everything that its picture shows.

    Attributes:
        edge, run: the part and the run.
        rows, time: (n,) rows of the recording, and when they were measured [s].
        position: (n, 3) of the part's origin in the frame of its parent [m].
        stretches: its segments.
        quantity, unit: what `measured` counts: ``"configuration"`` or ``"displacement"``, in rad, m, "rad or m".
        evidence_rows, evidence: (k,) rows and the models; empty if not traced.
        changepoints: where a segment may start; empty if not traced.
        counts: probabilities of 0, 1, 2, ... changepoints; empty if not estimated.
        channel: how the actions move the part.
        assessed: whether learning estimated probabilities.
    """

    edge: KinematicEdge
    run: int
    rows: Ints
    time: Floats
    position: Floats
    stretches: tuple[Stretch, ...]
    quantity: str
    unit: str
    evidence_rows: Ints
    evidence: tuple[EvidenceLine, ...]
    changepoints: tuple[ChangeBar, ...]
    counts: tuple[float, ...]
    channel: ActionChannel | None
    assessed: bool

    def when(self, rows: ArrayLike) -> Floats:
        """When rows were measured [s]; halves of a row are half-way to the next one."""
        wanted = np.asarray(rows, dtype=float)
        if len(self.rows) < 2:
            return np.asarray(self.time[0] + (wanted - self.rows[0]))
        step = float(np.median(np.diff(self.time))) / max(float(np.median(np.diff(self.rows))), 1.0)
        inside = np.interp(wanted, self.rows, self.time)
        outside = wanted - np.clip(wanted, self.rows[0], self.rows[-1])
        return np.asarray(inside + outside * step)

    @property
    def span(self) -> tuple[float, float]:
        """From half a row before the first row to half a row after the last one [s]."""
        first, last = self.when([self.rows[0] - 0.5, self.rows[-1] + 0.5])
        return float(first), float(last)

    @property
    def evidence_range(self) -> tuple[float, float]:
        """Range of an axis of the evidence [nats]."""
        top = max([12.0, *(float(line.values.max()) for line in self.evidence)])
        return FLOOR - 0.08 * (top - FLOOR), top + 0.08 * (top - FLOOR)

    @property
    def changepoint_range(self) -> tuple[float, float]:
        """Range of an axis of the changepoints' probabilities."""
        return 0.0, 1.08 * max([0.05, *(bar.probability for bar in self.changepoints)])

    @property
    def in_base(self) -> bool:
        """Whether positions are in the base frame."""
        return self.edge.parent == BASE


def learned_runs(recording: Recording, graph: KinematicGraph) -> tuple[RunPicture, ...]:
    """Every part's runs, parts in the order of the graph."""
    segments = colored_segments(recording, graph)
    stretches_of_runs = []
    for edge in graph.edges:
        runs = list(dict.fromkeys(segment.run for segment in edge.segments))
        for number, run in enumerate(runs):
            coloured = tuple(c for c in segments if c.edge is edge and c.segment.run == run)
            if len(rows_of_run(recording, edge, run)):
                stretches_of_runs.append(_learned_run(recording, edge, run, number, coloured))
    return tuple(stretches_of_runs)


def _learned_run(
    recording: Recording, edge: KinematicEdge, run: int, number: int, coloured: tuple[ColoredSegment, ...]
) -> RunPicture:
    rows = rows_of_run(recording, edge, run)
    poses = parent_poses(recording, edge, run, rows).inv() * recording.poses()[rows]
    moving = [s for s in edge.segments if s.joint.moves and not fits_no_joint(s)]
    stretches = []
    for colored in coloured:
        chosen = np.isin(rows, colored.rows)
        if moving:
            closest = min(moving, key=lambda s: (s is not colored.segment, s.run != run, _gap(s, colored.segment)))
            rotation = poses.rotation[chosen] if recording.has_orientation else None
            measured = _configuration(closest, poses.translation[chosen], rotation)
        else:
            measured = np.linalg.norm(poses.translation[chosen] - poses.translation[0], axis=1)
        stretches.append(Stretch(colored, rows[chosen], measured))
    certainty = edge.certainty
    trace_rows, lines, changes = _traced(None if certainty is None else certainty.trace, rows, stretches)
    counts = certainty.changepoint_counts if certainty is not None else ()
    units = dict.fromkeys(s.joint.unit for s in moving)
    return RunPicture(
        edge, run, rows, recording.time[rows], poses.translation, tuple(stretches),
        "configuration" if moving else "displacement", " or ".join(units) if moving else "m",
        trace_rows, lines, changes, counts[number] if number < len(counts) else (),
        None if certainty is None else certainty.channel, certainty is not None,
    )  # fmt: skip


def _gap(a: Segment, b: Segment) -> int:
    return max(a.start - b.end, b.start - a.end, 0)


def _configuration(segment: Segment, position: Floats, rotation: Rotation | None) -> Floats:
    """(k,) configurations by a segment's joint; turns are counted where it turns nearly all the way round."""
    low, high = segment.configuration_range
    if high - low < _NEARLY_A_TURN or segment.joint.unit == "m":
        return inverse(segment.joint, position, rotation, near=(low + high) / 2)
    c = np.unwrap(inverse(segment.joint, position, rotation))
    turns = np.round((segment.configuration_start - c[:1]) / (2 * np.pi))
    return np.asarray(c + 2 * np.pi * turns)


def _traced(
    trace: EvidenceTrace | None, rows: Ints, stretches: list[Stretch]
) -> tuple[Ints, tuple[EvidenceLine, ...], tuple[ChangeBar, ...]]:
    traced = np.array(() if trace is None else trace.rows, dtype=np.int64)
    is_row = np.isin(traced, rows)
    if trace is None or not is_row.any():
        return traced[is_row], (), ()
    density = np.nan_to_num(np.array(trace.log_density, dtype=float)[is_row], nan=_IMPOSSIBLE, neginf=_IMPOSSIBLE)
    colors = _model_colors(trace.models, density, traced[is_row], stretches)
    lines = tuple(map(EvidenceLine, trace.models, colors, relative_evidence(density).T))
    return (
        traced[is_row],
        lines,
        _change_bars(traced[is_row], np.array(trace.changepoint, dtype=float)[is_row], rows, stretches),
    )


def _change_bars(traced: Ints, posterior: Floats, rows: Ints, stretches: list[Stretch]) -> tuple[ChangeBar, ...]:
    """Bars of the traced rows; around a start with a posterior over single rows, the finer bars of that."""
    apart, fine = _apart(traced), _apart(rows)
    widths = np.gradient(traced.astype(float)) if len(traced) > 1 else np.ones(len(traced))
    bars = [ChangeBar(*map(float, bar)) for bar in zip(traced, posterior, widths, strict=True)]
    for stretch in stretches:
        start = None if stretch.segment.certainty is None else stretch.segment.certainty.start
        if start is None or apart <= fine:
            continue
        low, high = start.rows[0] - _REPLACED * apart, start.rows[-1] + _REPLACED * apart
        bars = [bar for bar in bars if not low <= bar.row <= high]
        bars += [ChangeBar(float(row), p, fine) for row, p in zip(start.rows, start.probabilities, strict=True)]
    return tuple(sorted(bars, key=lambda bar: bar.row))


def _apart(rows: Ints) -> float:
    """How far apart rows lie."""
    return float(np.median(np.diff(rows))) if len(rows) > 1 else 1.0


def relative_evidence(log_density: Floats) -> Floats:
    """(n, m) cumulated log density of each model less that of the best single one (largest sum), never below `FLOOR`.

    The floor makes a model that was far off rise as soon as it explains rows better, which is where it takes over.
    """
    if not len(log_density):
        return log_density
    gain = log_density - log_density[:, [int(log_density.sum(axis=0).argmax())]]
    sums = accumulate(gain, lambda total, step: np.maximum(total + step, FLOOR), initial=np.zeros(gain.shape[1]))
    return np.array(list(sums)[1:])


def _model_colors(models: tuple[str, ...], density: Floats, rows: Ints, stretches: list[Stretch]) -> list[str | None]:
    """The colour of the segment that each model explains best among the models of its kind; None if there is none."""
    colors: list[str | None] = [None] * len(models)
    for stretch in stretches:
        kind = "free" if fits_no_joint(stretch.segment) else stretch.segment.joint.kind
        same = [i for i, model in enumerate(models) if model.split("_")[0] == kind]
        if same:
            total = density[np.isin(rows, stretch.rows)].sum(axis=0)
            colors[max(same, key=lambda i: float(total[i]))] = stretch.colored.color
    return colors


NO_BREAK = "\N{NO-BREAK SPACE}"
NO_FIT = "no single-joint model fits"
LEVELS = 2
"""Rows of names above a chart: what would overlap goes to the second."""

_AT_FLOOR = 0.5
_TOLD = 0.5  # probability of a deviation from which on it is told
_LINE_OF_NAMES = 17  # letters


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
    """What joints explain badly or not at all, and how actions move the part, one sentence each.

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
    """Whether no single joint explains some of the rows."""
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
    """Why no single joint explains a segment, with the numbers; empty if one does."""
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
    """How far a part leaves its joints where that is further than usual, one sentence for each joint."""
    rows: dict[tuple[JointKind, Deviation], list[str]] = {}
    for segment in segments:
        deviation = (
            None if segment.certainty is None or segment.no_single_joint is not None else segment.certainty.deviation
        )
        if deviation is not None and deviation.probability >= _TOLD:
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
    """How the recorded actions move the part, with one standard deviation; empty if it was not estimated."""
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


# Standard deviation of a turn [rad], and of a gain as a share of it, from which on a number would only mislead: motion
# along one straight line tells the gain along it and no turn about it.
_OPEN = 0.35


def action_words(channel: ActionChannel) -> str:
    """What actions make of the part's steps, with one standard deviation each; what the motion leaves open is named."""
    std = dict(zip(CHANNEL_NAMES, np.sqrt(np.diag(np.array(channel.covariance))), strict=True))
    turned, spread = channel_turn(channel)
    told = {
        "gain": (with_spread(channel.gain, std["gain"], ""), std["gain"] < _OPEN * abs(channel.gain)),
        "delay": (with_spread(channel.delay, std["delay"], "s"), True),
        "frame rotation": (in_degrees(turned, spread), spread < _OPEN),
    }
    words = [", ".join(f"{name} {text}" for name, (text, is_told) in told.items() if is_told)]
    left_open = [name for name, (_, is_told) in told.items() if not is_told]
    words += [f"{' and '.join(left_open)} not determined by this motion"] if left_open else []
    return f"{'; '.join(words)}; they explain {percent(channel.explained, 0)} of the steps"


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
    """A segment's name and probability, centred at a time [s], on a level above the panel (0 is the lowest)."""

    text: str
    time: float
    level: int
    no_single_joint: bool


def segment_labels(learned: RunPicture, letter: float) -> tuple[SegmentLabel, ...]:
    """Names of the segments; what would overlap goes a level up, or away.

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


def probability_words(segment: Segment) -> list[tuple[str, float]]:
    """Kinds of joint, and no single joint, with their probabilities, the most probable first."""
    kinds = [] if segment.certainty is None else [(str(kind), p) for kind, p in segment.certainty.kinds]
    none = max(0.0, 1.0 - sum(p for _, p in kinds))
    return sorted([*kinds, ("no single joint", none)], key=lambda pair: -pair[1])


def kind_words(segment: Segment) -> tuple[str, str]:
    """The most probable kind with its probability, and the next one, empty if it is out of the question."""
    ranked = [f"{name} {percent(p, 0)}" if p >= 0.005 else "" for name, p in probability_words(segment)]
    return ranked[0], "".join(ranked[1:2])


def shown_counts(learned: RunPicture, least: int = 3) -> tuple[float, ...]:
    """Probabilities of 0, 1, 2, ... changepoints, as far as they matter, and at least `least`."""
    counts = learned.counts + (0.0,) * (least - len(learned.counts))
    matter = [number for number, probability in enumerate(counts) if probability >= 0.005]
    return counts[: max(least, max(matter, default=0) + 1)]
