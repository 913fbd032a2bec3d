"""Learned segments for pages and figures: colours, names, and series of each run.

Source: Page, Biometrika 1954, for cumulated evidence that a floor keeps ready to rise (`EvidenceLine`).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.arrays import Floats, Ints
from micah_plan.automaton.certainty import ActionChannel, EvidenceTrace
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.joint import Joint, radius
from micah_plan.automaton.kinematics import inverse
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
    """All segments of a graph in order, coloured by joint; segments without a joint have a colour of their own."""
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
    """(k,) poses of the edge's parent in the base frame, nearest in time to the rows (k,) of a run."""
    of_parent = np.flatnonzero((np.array(recording.part) == edge.parent) & (recording.run == run))
    if edge.parent == BASE or not len(of_parent):
        return RigidTransform.identity(len(rows))
    times, wanted = recording.time[of_parent], recording.time[rows]
    after = np.clip(np.searchsorted(times, wanted), 1, max(len(times) - 1, 1)) % len(times)
    before = np.maximum(after - 1, 0)
    nearest = np.where(wanted - times[before] <= times[after] - wanted, before, after)
    return recording.poses()[of_parent[nearest]]


def _same_joint(a: Joint, b: Joint, span: float) -> bool:
    """Whether two joints of one part are visually equal; `span` is the range of its configurations [rad or m]."""
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
    """A segment within a run.

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
    """Cumulative evidence of one model relative to the best single one, clipped at `FLOOR`.

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
    """Posterior probability that a segment starts at a row, or within `width` rows around it."""

    row: float
    probability: float
    width: float


@dataclass(frozen=True, eq=False)
class RunPicture:
    """One run of one part with everything that is drawn of it.

    Attributes:
        edge, run: the part and the run.
        rows, time: (n,) rows of the recording, and when they were measured [s].
        position: (n, 3) of the part's origin in the frame of its parent [m].
        stretches: its segments.
        quantity, unit: of `measured`: ``"configuration"`` or ``"displacement"``, in rad, m, "rad or m".
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
        """Times of rows [s]; fractional rows are interpolated."""
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
    """(k,) configurations on a segment's joint, unwrapped if it covers nearly a full turn."""
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
    """Bars of the traced rows, refined around starts with a posterior over single rows."""
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
    """Spacing of rows."""
    return float(np.median(np.diff(rows))) if len(rows) > 1 else 1.0


def relative_evidence(log_density: Floats) -> Floats:
    """(n, m) cumulative log density of each model relative to the best single one, clipped at `FLOOR`.

    The floor makes a model that was far off rise as soon as it explains rows better, which is where it takes over.
    """
    if not len(log_density):
        return log_density
    gain = log_density - log_density[:, [int(log_density.sum(axis=0).argmax())]]
    sums = accumulate(gain, lambda total, step: np.maximum(total + step, FLOOR), initial=np.zeros(gain.shape[1]))
    return np.array(list(sums)[1:])


def _model_colors(models: tuple[str, ...], density: Floats, rows: Ints, stretches: list[Stretch]) -> list[str | None]:
    """The colour of the segment that each model explains best among its kind; None if there is none."""
    colors: list[str | None] = [None] * len(models)
    for stretch in stretches:
        kind = "free" if fits_no_joint(stretch.segment) else stretch.segment.joint.kind
        same = [i for i, model in enumerate(models) if model.split("_")[0] == kind]
        if same:
            total = density[np.isin(rows, stretch.rows)].sum(axis=0)
            colors[max(same, key=lambda i: float(total[i]))] = stretch.colored.color
    return colors
