"""The page of a recording: the measured track by segment, the fitted joints, and the part moving as it was measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.graph import KinematicGraph
from micah_plan.automaton.joint import radius
from micah_plan.quantities import interval, percent, plain, quantity
from micah_plan.recording.value import Recording
from micah_plan.view.camera import camera
from micah_plan.view.chart import evenly
from micah_plan.view.drawing import JointLook, draw_frame, draw_ground, draw_joint
from micah_plan.view.learned import (
    ColoredSegment,
    colored_segments,
    fits_no_joint,
    learned_runs,
    parent_poses,
    rows_of_run,
)
from micah_plan.view.learned_words import NO_FIT, no_single_joint_sentence
from micah_plan.view.learning_charts import learning_charts
from micah_plan.view.motion import LONGEST_S, SHORTEST_S
from micah_plan.view.page import Band, LegendEntry, ScenePage, Timeline, render_scene
from micah_plan.view.palette import FRAME_AXES, GRID, INK, MUTED, category
from micah_plan.view.scene import DrawnScene, slug
from micah_plan.view.solids import beads

_MOST_BEADS = 1500
_MOST_KEYFRAMES = 400
_MOST_LANES = 5


def recording_page(
    recording: Recording,
    graph: KinematicGraph | None = None,
    *,
    title: str = "Recording",
    pictures: Sequence[tuple[float, bytes]] = (),
    points: Mapping[str, Floats] | None = None,
) -> str:
    """The page as HTML text.

    Args:
        recording: at least one row.
        graph: the segments learned from it; None shows the track alone.
        pictures: (time [s], JPEG) of the camera of a recording with one run, shown next to the scene.
        points: (k, 3) tracked on each part, in its frame [m]; those of no part, in the base frame.
    """
    scene = DrawnScene()
    scene.reserve(recording.position)
    size = max(float(np.linalg.norm(np.ptp(recording.position, axis=0))), 0.02)
    segments = colored_segments(recording, graph)
    shown_rows = np.zeros(len(recording), dtype=bool)
    for number, colored in enumerate(segments):
        shown_rows[colored.rows] = True
        _draw_track(scene, f"track/{number}", recording.position[colored.rows], colored.color, size)
        if not fits_no_joint(colored.segment):
            _draw_segment_joint(scene, f"joints/{number}", recording, colored, size)
    _draw_track(scene, "track/rest", recording.position[~shown_rows], MUTED, size)
    shown, duration = _shown_times(recording)
    timeline = _animate(scene, recording, segments, size, shown, duration)
    of_points = _draw_points(scene, recording, segments, points or {}, size, shown)
    spacing = draw_ground(scene)
    legend = [LegendEntry(c.color, c.label, shape="dot") for c in segments]
    if segments and not shown_rows.all():
        legend.append(LegendEntry(MUTED, "rows in no segment", shape="dot"))
    legend.append(LegendEntry(MUTED, "all measured positions" if segments else "measured positions", "track", "dot"))
    no_single_joints = [c for c in segments if fits_no_joint(c.segment)]
    if len(no_single_joints) < len(segments):
        legend.append(LegendEntry(INK, "fitted joints: axis and centre, arc, line, ring (rigid)", "joints", "line"))
    legend += of_points
    legend.append(LegendEntry(FRAME_AXES[0], "measured frame of the part (x red, y green, z blue)", "frames", "line"))
    legend.append(LegendEntry(GRID, f"grid of {quantity(spacing, 'm')}, base frame, z up", "ground", "line"))
    page = ScenePage(
        title=title,
        kind="recording",
        camera=camera(scene, recording.position),
        badge=(NO_FIT if len(no_single_joints) == len(segments) else f"{NO_FIT} some rows", "bad")
        if no_single_joints
        else None,
        facts=_facts(recording, segments),
        details=[("Fitted joints", [_described(c) for c in segments])] if segments else [],
        legend=legend,
        timeline=timeline,
        charts=() if graph is None else learning_charts(recording, learned_runs(recording, graph), shown),
        pictures=_shown_pictures(recording, shown, pictures),
    )
    return render_scene(page, scene)


def _draw_track(scene: DrawnScene, path: str, points: Floats, color: str, size: float) -> None:
    if len(points):
        scene.mesh(path, beads(points[evenly(len(points), _MOST_BEADS)], 0.014 * size), color)


def _draw_points(
    scene: DrawnScene,
    recording: Recording,
    segments: tuple[ColoredSegment, ...],
    points: Mapping[str, Floats],
    size: float,
    shown: Floats,
) -> list[LegendEntry]:
    """Draw the points of each body in its colour, moving with it; returns the legend entries."""
    poses, entries = recording.poses(), list[LegendEntry]()
    for number, (name, places) in enumerate(points.items()):
        own = [c.color for c in segments if c.edge.child == name and c.segment.joint.moves]
        color = MUTED if name not in recording.parts else own[0] if own else category(number)
        path = f"points/{slug(name, number)}"
        scene.mesh(path, beads(places, 0.018 * size), color)
        entries.append(LegendEntry(color, f"{len(places)} points on {name}", shape="dot"))
        if name in recording.parts:
            rows = np.flatnonzero([part == name for part in recording.part])
            rows = rows[evenly(len(rows), _MOST_KEYFRAMES)]
            scene.animate(path, shown[rows], poses[rows])
        else:
            scene.reserve(places)
    if entries:
        entries.append(LegendEntry(MUTED, "tracked points", "points", "dot"))
    return entries


def _draw_segment_joint(
    scene: DrawnScene, path: str, recording: Recording, colored: ColoredSegment, size: float
) -> None:
    """The joint in the frame of its parent, which stands where it was measured at the segment's first row."""
    segment = colored.segment
    draw_joint(scene, path, segment.joint, segment.configuration_range, JointLook(INK, size, thickness=0.5))
    if segment.joint.turns:
        scene.mesh(f"{path}/center", beads(np.array([segment.joint.center]), 0.03 * size), INK)
    scene.place(path, parent_poses(recording, colored.edge, segment.run, np.array([segment.start]))[0])


def _shown_times(recording: Recording) -> tuple[Floats, float]:
    """((n,) time of every row on the player with runs in sequence, duration [s]); 0 for a static recording."""
    starts: dict[int, float] = {}
    clock = 0.0
    for run in recording.runs:
        time = recording.time[recording.run == run]
        starts[run] = clock - float(time.min())
        clock += float(np.ptp(time)) + (0.1 * float(np.ptp(time)) if run != recording.runs[-1] else 0.0)
    if clock <= 0.0:
        return np.zeros(len(recording)), 0.0
    scale = min(max(clock, SHORTEST_S), LONGEST_S) / clock
    return scale * (recording.time + np.array([starts[int(run)] for run in recording.run])), clock * scale


def _shown_pictures(
    recording: Recording, shown: Floats, pictures: Sequence[tuple[float, bytes]]
) -> tuple[tuple[float, bytes], ...]:
    """Pictures at their times on the player, restricted to the range of the rows."""
    order = np.argsort(recording.time, kind="stable")
    time, place = recording.time[order], shown[order]
    inside = [(at, jpeg) for at, jpeg in pictures if time[0] - 1e-9 <= at <= time[-1] + 1e-9]
    return tuple((float(np.interp(at, time, place)), jpeg) for at, jpeg in inside)


def _animate(
    scene: DrawnScene,
    recording: Recording,
    segments: tuple[ColoredSegment, ...],
    size: float,
    shown: Floats,
    duration: float,
) -> Timeline:
    """Animate each part's frame along its rows, at times (n,); the clock shows the recording's time."""
    if duration <= 0.0:
        return Timeline()
    poses = recording.poses()
    for number, part in enumerate(recording.parts):
        rows = np.flatnonzero([name == part for name in recording.part])
        rows = rows[evenly(len(rows), _MOST_KEYFRAMES)]
        path = f"frames/{slug(part, number)}"
        draw_frame(scene, path, 0.3 * size)
        scene.animate(path, shown[rows], poses[rows])
    bands = _bands(recording, segments, shown)
    drawn = tuple(band for band in bands if band.lane < _MOST_LANES)
    return Timeline(duration, drawn, _readouts(recording, bands, shown))


def _bands(recording: Recording, segments: tuple[ColoredSegment, ...], shown: Floats) -> list[Band]:
    """Bands of the segments, with one lane per part."""
    parts = list(dict.fromkeys(c.edge.child for c in segments))
    bands = []
    for colored in segments:
        rows, part = colored.rows, colored.edge.child
        label = f"{part}: {colored.name}" if len(parts) > 1 else colored.name
        of_run = rows_of_run(recording, colored.edge, colored.segment.run)
        following = of_run[of_run > rows[-1]]
        end = shown[following[0]] if len(following) else shown[rows[-1]]
        bands.append(Band(float(shown[rows[0]]), float(end), colored.color, label, parts.index(part)))
    return bands


def _readouts(recording: Recording, bands: list[Band], shown: Floats) -> tuple[tuple[float, tuple[str, ...]], ...]:
    """Row, time and segments of all parts at some of the rows."""
    several = len(recording.runs) > 1
    readouts = []
    for row in np.argsort(shown, kind="stable")[evenly(len(shown), _MOST_KEYFRAMES)]:
        time = float(shown[row])
        lines = [f"row {row}, t = {recording.time[row]:.2f} s"]
        lines += [f"run {recording.run[row]}"] if several else []
        now = {band.lane: band.label for band in bands if band.start <= time <= band.end}
        lines += [now[lane] for lane in sorted(now)[:_MOST_LANES]]
        readouts.append((time, tuple(lines)))
    return tuple(readouts)


def _facts(recording: Recording, segments: tuple[ColoredSegment, ...]) -> list[tuple[str, str]]:
    changes = [c.segment.start for c in segments if c.segment is not c.edge.segments[0]]
    facts = [
        ("Rows", f"{len(recording):,}"),
        ("Runs", f"{len(recording.runs):,}"),
        ("Parts", ", ".join(recording.parts)),
        ("Orientation", "measured" if recording.has_orientation else "not measured"),
        ("Actions", "recorded" if recording.has_actions else "not recorded"),
    ]
    if segments:
        rows = f"at {'row' if len(changes) == 1 else 'rows'} {', '.join(map(str, changes))}"
        facts.append(("Changepoints", rows if changes else "none"))
    return facts


def _described(colored: ColoredSegment) -> str:
    joint, segment = colored.segment.joint, colored.segment
    if fits_no_joint(segment):
        return no_single_joint_sentence(segment)
    words = []
    if joint.turns:
        words.append(f"radius {quantity(radius(joint), 'm')}")
    if joint.climbs:
        words.append(f"pitch {quantity(joint.pitch, 'm/rad')}")
    if joint.has_axis:
        words.append(f"axis ({', '.join(plain(a) for a in joint.axis)})")
    if joint.moves:
        words.append(f"from {interval(*segment.configuration_range, joint.unit)}")
    joined = f"{colored.label}: {', '.join(words)}" if words else colored.label
    return f"{joined}; probability {percent(segment.probability)}"
