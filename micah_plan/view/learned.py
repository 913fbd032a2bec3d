"""What learning found in one run of one part, as series to draw: configurations, evidence over time, posteriors.

Source: Page, Biometrika 1954, for cumulated evidence that a floor keeps ready to rise (`EvidenceLine`).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from micah_plan.automaton.certainty import ActionChannel, EvidenceTrace
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.kinematics import inverse
from micah_plan.recording.value import Recording
from micah_plan.view.segments import (
    UNITS,
    ColoredSegment,
    colored_segments,
    is_misfit,
    parent_poses,
    rows_of,
    rows_of_run,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

FLOOR = -10.0
"""Where a model counts as ruled out [nats]: odds of 1 to 22,000 against the best single one."""

_IMPOSSIBLE = -1e6
_REPLACED = 2.0
"""Around a start with a posterior over single rows, traced rows up to so many of their distances away are left out."""
_NEARLY_A_TURN = 0.9 * np.pi


@dataclass(frozen=True, eq=False)
class Stretch:
    """A segment in a run.

    Attributes:
        colored: the segment with its colour and name.
        rows: (k,) its rows.
        measured: (k,) configuration by the closest joint that moves, or displacement from the run's first row [m].
        interval: rows (both inclusive) between which it starts with 95 % probability; None if not estimated.
    """

    colored: ColoredSegment
    rows: Ints
    measured: Floats
    interval: tuple[int, int] | None

    @property
    def segment(self) -> Segment:
        return self.colored.segment


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
class LearnedRun:
    """One run of one part: everything that its picture shows.

    Attributes:
        edge, run: the part and the run.
        rows: (n,) rows of the recording.
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

    @property
    def in_base(self) -> bool:
        """Whether positions are in the base frame."""
        return self.edge.parent == BASE


def learned_runs(recording: Recording, graph: KinematicGraph) -> tuple[LearnedRun, ...]:
    """Every part's runs, parts in the order of the graph."""
    segments = colored_segments(graph)
    found = []
    for edge in graph.edges:
        runs = list(dict.fromkeys(segment.run for segment in edge.segments))
        for number, run in enumerate(runs):
            own = tuple(c for c in segments if c.edge is edge and c.segment.run == run)
            if len(rows_of_run(recording, edge, run)):
                found.append(_learned_run(recording, edge, run, number, own))
    return tuple(found)


def _learned_run(
    recording: Recording, edge: KinematicEdge, run: int, number: int, own: tuple[ColoredSegment, ...]
) -> LearnedRun:
    rows = rows_of_run(recording, edge, run)
    poses = parent_poses(recording, edge, run, rows).inv() * recording.poses()[rows]
    moving = [s for s in edge.segments if s.joint.kind != "rigid" and not is_misfit(s)]
    stretches = []
    for colored in own:
        chosen = np.isin(rows, rows_of(recording, colored))
        if moving:
            closest = min(moving, key=lambda s: (s is not colored.segment, s.run != run, _gap(s, colored.segment)))
            rotation = poses.rotation[chosen] if recording.has_orientation else None
            measured = _configuration(closest, poses.translation[chosen], rotation)
        else:
            measured = np.linalg.norm(poses.translation[chosen] - poses.translation[0], axis=1)
        start = None if colored.segment.certainty is None else colored.segment.certainty.start
        stretches.append(Stretch(colored, rows[chosen], measured, None if start is None else start.interval()))
    certainty = edge.certainty
    trace_rows, lines, changes = _traced(None if certainty is None else certainty.trace, rows, stretches)
    counts = certainty.changepoint_counts if certainty is not None else ()
    units = dict.fromkeys(UNITS[s.joint.kind] for s in moving)
    return LearnedRun(
        edge, run, rows, poses.translation, tuple(stretches),
        "configuration" if moving else "displacement", " or ".join(units) if moving else "m",
        trace_rows, lines, changes, counts[number] if number < len(counts) else (),
        None if certainty is None else certainty.channel, certainty is not None,
    )  # fmt: skip


def _gap(a: Segment, b: Segment) -> int:
    return max(a.start - b.end, b.start - a.end, 0)


def _configuration(segment: Segment, position: Floats, rotation: Rotation | None) -> Floats:
    """(k,) configurations by a segment's joint; turns are counted where it turns nearly all the way round."""
    low, high = segment.configuration_range
    if high - low < _NEARLY_A_TURN or segment.joint.kind == "prismatic":
        return inverse(segment.joint, position, rotation, near=(low + high) / 2)
    c = np.unwrap(inverse(segment.joint, position, rotation))
    turns = np.round((segment.configuration_start - c[:1]) / (2 * np.pi))
    return np.asarray(c + 2 * np.pi * turns)


def _traced(
    trace: EvidenceTrace | None, rows: Ints, stretches: list[Stretch]
) -> tuple[Ints, tuple[EvidenceLine, ...], tuple[ChangeBar, ...]]:
    traced = np.array(() if trace is None else trace.rows, dtype=np.int64)
    own = np.isin(traced, rows)
    if trace is None or not own.any():
        return traced[own], (), ()
    density = np.nan_to_num(np.array(trace.log_density, dtype=float)[own], nan=_IMPOSSIBLE, neginf=_IMPOSSIBLE)
    colors = _model_colors(trace.models, density, traced[own], stretches)
    lines = tuple(map(EvidenceLine, trace.models, colors, relative_evidence(density).T))
    return traced[own], lines, _change_bars(traced[own], np.array(trace.changepoint, dtype=float)[own], rows, stretches)


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
        kind = "free" if is_misfit(stretch.segment) else stretch.segment.joint.kind
        same = [i for i, model in enumerate(models) if model.split("_")[0] == kind]
        if same:
            total = density[np.isin(rows, stretch.rows)].sum(axis=0)
            colors[max(same, key=lambda i: float(total[i]))] = stretch.colored.color
    return colors
