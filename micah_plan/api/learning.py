"""`learn`: from a recording to a model, or the reason why there is none."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from micah_plan import __version__
from micah_plan.api import inputs
from micah_plan.api.inputs import Measured, Source
from micah_plan.api.result import SUREST, Result, save_model
from micah_plan.automaton.graph import BASE, KinematicGraph
from micah_plan.automaton.hybrid import HybridAutomaton, Part
from micah_plan.errors import InputError
from micah_plan.learning.settings import FEWEST_ROWS, LearnSettings
from micah_plan.message import codes_of
from micah_plan.quantities import count, duration, in_degrees, percent, plain, progression, quantity
from micah_plan.recording.conventions import Conventions
from micah_plan.recording.value import Recording
from micah_plan.summaries import Progress, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from micah_plan.automaton.certainty import ActionChannel, Deviation
    from micah_plan.automaton.graph import KinematicEdge, Segment
    from micah_plan.automaton.joint import Joint

Method = Literal["act-champ", "champ"]
_COLUMNS = ("joint", "rows", "configuration", "axis", "radius", "P(kind)", "start row\n(95 %)")
_TURNED_BACK = 0.2
"""Share of its range by which a part goes further than where it begins and ends, from which on that is told."""


@dataclass(frozen=True, eq=False, repr=False)
class LearningResult(Result):
    """Result of `learn`: the measured segments, the automaton built from them, and the duration.

    Attributes:
        recording: the data.
        graph: the segments of every part, with their joints.
        automaton: None if some rows follow no single joint; see `graph`.
        seconds: wall-clock time.
        reason: why there is no automaton, with a remedy; empty if there is one.
        warnings: likely mistakes in the recording (units, order of columns), or too little data, one line each.
        base: reference of the poses: the part used as base, else "base".
        seed: as given; learning is deterministic.
    """

    recording: Recording
    graph: KinematicGraph
    automaton: HybridAutomaton | None
    seconds: float
    reason: str = ""
    warnings: tuple[str, ...] = ()
    base: str = BASE
    seed: int = 0

    @property
    def success(self) -> bool:
        """Whether there is an automaton."""
        return self.automaton is not None

    @property
    def outcome(self) -> str:
        """``"learned"`` or ``"no_model"``."""
        return "learned" if self.success else "no_model"

    def heading(self, edge: KinematicEdge) -> str:
        """Which part moves relative to which."""
        return f"{edge.child} relative to {self.base if edge.parent == BASE else edge.parent}"

    def report(self) -> list[str | Table]:
        """Segments of every part with how sure they are, how actions move it, and the modes made of them."""
        from micah_plan.view.learned_words import action_words, deviation_notes

        lines: list[str | Table] = []
        for edge in self.graph.edges:
            rows = tuple(segment_row(segment) for segment in edge.segments)
            lines.append(Table(_COLUMNS, rows, self.heading(edge), firm=("joint", "rows", "P(kind)")))
            lines += deviation_notes(edge.segments)
            if edge.certainty is not None and edge.certainty.channel is not None:
                lines.append(f"actions: {action_words(edge.certainty.channel)}")
        if self.graph.probability is not None:
            lines.append(f"probability of this tree of parts: {percent(min(self.graph.probability, SUREST), 0)}")
        if self.automaton is None:
            return [*lines, f"no model: {self.reason}"]
        return [*lines, f"learned {count(len(self.automaton.modes), 'mode')} in {duration(self.seconds)}"]

    def json(self) -> dict[str, Any]:
        """Segments, changepoints and actions of the part, seconds, seed.

        For several parts the first three are in `edges`, and `tree_probability` is that of this tree of parts. Missing
        estimates are null.
        """
        edges = [{"parent": edge.parent, "child": edge.child, **_edge(edge)} for edge in self.graph.edges]
        tree = {"edges": edges, "tree_probability": self.graph.probability}
        summary = tree if len(edges) > 1 else _edge(self.graph.edges[0])
        modes = () if self.automaton is None else self.automaton.mode_names
        outcome = {"modes": modes, "reason": self.reason}
        noticed = {"warnings": self.warnings, "warning_codes": codes_of(self.warnings)}
        return {**summary, **outcome, **noticed, "seconds": self.seconds, "seed": self.seed}

    def plot(self) -> Figure:
        """The segmented track, its axes and the evidence over time."""
        from micah_plan.view.learning_figure import learning_figure

        return learning_figure(self.recording, self.graph)

    def page(self, title: str = "") -> str:
        """The segmented track in 3-D."""
        from micah_plan.view.recording_page import recording_page

        return recording_page(self.recording, self.graph, title=title or self.title)

    def save(self, path: str | Path) -> None:
        """Write the model (YAML)."""
        save_model(self.automaton, self.reason, path)


def learn(
    recording: Measured,
    *,
    method: Method = "act-champ",
    seed: int = 0,
    parts: Source | Sequence[Part] = (),
    settings: LearnSettings | None = None,
    base: str | None = None,
    conventions: Conventions | None = None,
    progress: Progress | None = None,
    **changes: Any,
) -> LearningResult:
    """A hybrid automaton from a recording, or the reason why there is none.

    Args:
        recording: a path, a recording, or executed runs, of at least `learning.settings.FEWEST_ROWS` rows per run.
        method: ``"act-champ"`` uses the actions, ``"champ"`` the poses alone.
        seed: stored in the result, as of every command; learning is deterministic, so the same rows give the same
            model.
        parts: shapes and handles of the parts, for drawing and physics: a path or values.
        settings: None: the defaults, which are meant for every recording.
        base: a tracked part on which the object stands, as a door on a cart that is pushed: the model is in its frame,
            and the rows that are returned are those of the other parts.
        conventions: of the file; None: its own, or those of a file next to it.
        progress: called with a message and the fraction done.
        **changes: settings by name, e.g. ``kinds=("rigid", "prismatic")``.

    Raises:
        InputError: if the recording cannot be learned from, or a setting is none.
    """
    measured, shapes = inputs.demonstration_of(recording, conventions), inputs.parts_of(parts)
    chosen = inputs.learn_settings(settings, changes)
    with inputs.located(recording):
        return _learned(measured, method, seed, shapes, chosen, base, progress)


def is_long_enough(recording: Recording) -> bool:
    """Whether every run has enough rows of each part for `learn`."""
    rows = Counter(zip(recording.run.tolist(), recording.part, strict=True))
    return min(rows.values(), default=0) >= FEWEST_ROWS


def _learned(
    recording: Recording,
    method: Method,
    seed: int,
    parts: tuple[Part, ...],
    settings: LearnSettings,
    base: str | None,
    progress: Progress | None,
) -> LearningResult:
    """Segment the recording, fit its joints and build the automaton."""
    from micah_plan.automaton.build import build_automaton, no_single_joint_error
    from micah_plan.automaton.effects.commanded_places import as_commanded
    from micah_plan.learning.learn import learn_graph
    from micah_plan.learning.parts.relative import relative_to
    from micah_plan.learning.small_motions import small_motions
    from micah_plan.recording.suspicion import suspicions_of_recording, turned_grips

    begin = time.perf_counter()
    if base is not None:
        recording = relative_to(recording, base)
    graph = learn_graph(recording, method=method, settings=settings, progress=progress)
    provenance = {"recording": recording.digest(), "method": method, "seed": str(seed), "micah_plan": __version__}
    if base is not None:
        provenance["frame"] = f"part {base}"
    if recording.conventions:
        provenance["conventions"] = "; ".join(f"{name} {text}" for name, text in recording.conventions.items())
    _check_names(graph, parts)
    refusal = no_single_joint_error(graph)
    on_paths = {edge.child for edge in graph.edges if any(each.joint.knots for each in edge.segments)}
    grips = tuple(line for part, line in turned_grips(recording).items() if part not in on_paths)
    warnings = recording.notes + suspicions_of_recording(recording) + grips + small_motions(recording, settings)
    automaton = (
        None
        if refusal is not None
        else as_commanded(build_automaton(graph, parts=parts, provenance=provenance), recording)
    )
    reason = "" if refusal is None else str(refusal)
    seconds = time.perf_counter() - begin
    return LearningResult(recording, graph, automaton, seconds, reason, warnings, base or BASE, seed)


def _check_names(graph: KinematicGraph, parts: Sequence[Part]) -> None:
    names = {name for edge in graph.edges for name in (edge.parent, edge.child)}
    for part in parts:
        if part.name not in names:
            raise InputError(
                f"the shapes are of a part '{part.name}', the recording has {', '.join(sorted(names))}",
                remedy="rename the part in the shapes file",
            )


def _edge(edge: KinematicEdge) -> dict[str, Any]:
    sure = edge.certainty
    return {
        "segments": [_segment(segment) for segment in edge.segments],
        "changepoints": list(edge.changepoints),
        "changepoint_counts": None if sure is None else sure.changepoint_counts,
        "action_channel": None if sure is None or sure.channel is None else _channel(sure.channel),
    }


def _segment(segment: Segment) -> dict[str, Any]:
    sure, no_single_joint = segment.certainty, segment.no_single_joint
    start = None if sure is None else sure.start
    data: dict[str, Any] = {
        "model": segment.joint.kind,
        "start": segment.start,
        "end": segment.end,
        "run": segment.run,
        "start_interval": None if start is None else start.interval(),
    }
    fitted = {
        "parameters": _parameters(segment.joint),
        **_spread(segment.joint),
        "configuration": [segment.configuration_start, segment.configuration_end],
        "probability": segment.probability,
        "probabilities": None if sure is None else dict(sure.kinds),
        "deviation": None if sure is None or sure.deviation is None else _deviation(sure.deviation),
    }
    if no_single_joint is None:
        return data | fitted
    misses = {
        "position_m": no_single_joint.position,
        "rotation_rad": no_single_joint.rotation,
        "position_noise_m": no_single_joint.position_noise,
        "rotation_noise_rad": no_single_joint.rotation_noise,
        "log_odds": no_single_joint.log_odds,
    }
    best = {"model": segment.joint.kind, **fitted}
    return data | {"model": "none", "parameters": {}, "best": best, "misfit": misses}


def _deviation(deviation: Deviation) -> dict[str, Any]:
    return {"position_m": deviation.position, "rotation_rad": deviation.rotation, "probability": deviation.probability}


def _parameters(joint: Joint) -> dict[str, Any]:
    """Pose at configuration 0; knots, or axis (unit, base frame), center, radius [m], pitch [m/rad] if they apply."""
    from micah_plan.automaton.joint import radius

    parameters: dict[str, Any] = {"position": joint.position, "orientation": joint.quaternion}
    if joint.knots:
        parameters["knots"] = joint.knots
    if joint.has_axis:
        parameters["axis"] = joint.axis
    if joint.turns:
        parameters |= {"center": joint.center, "radius": float(radius(joint))}
    if joint.climbs:
        parameters["pitch"] = joint.pitch
    return parameters


def _spread(joint: Joint) -> dict[str, Any]:
    """Covariance of a joint's parameters and their standard deviations, by name [rad, m, m/rad]."""
    if joint.covariance is None:
        return {"stds": None, "covariance": None}
    stds = dict(zip(joint.covariance.names, _stds(joint.covariance.matrix), strict=True))
    return {"stds": stds, "covariance": asdict(joint.covariance)}


def _channel(channel: ActionChannel) -> dict[str, Any]:
    from micah_plan.automaton.certainty import CHANNEL_NAMES

    *turned, gain, delay = _stds(channel.covariance)
    return {
        **asdict(channel),
        "stds": {"frame_rotation": turned, "gain": gain, "delay": delay},
        "covariance": {"names": CHANNEL_NAMES, "matrix": channel.covariance},
    }


def _stds(matrix: Sequence[Sequence[float]]) -> list[float]:
    """Square roots of the diagonal of a covariance."""
    return [math.sqrt(max(row[i], 0.0)) for i, row in enumerate(matrix)]


def segment_row(segment: Segment) -> tuple[str, ...]:
    """One line of the table, within 80 columns: kind, rows, path, axis, radius, probability, start."""
    from micah_plan.automaton.joint import axis_std, radius, radius_std

    joint, rows = segment.joint, f"{segment.start}-{segment.end}"
    no_single_joint, sure = segment.no_single_joint, segment.certainty
    start = ""
    if sure is not None and sure.start is not None:
        first, last = sure.start.interval()
        start = f"{first}" if first == last else f"{first}-{last}"
    if no_single_joint is not None:
        return ("none", rows, f"misses by {quantity(no_single_joint.position, 'm')}", "", "", "", start)
    axis = " ".join(f"{round(value, 2) + 0.0:.2f}" for value in joint.axis) if joint.has_axis else ""
    arm = quantity(radius(joint), "m") if joint.turns else ""
    if joint.covariance is not None:
        axis += f"\n± {in_degrees(axis_std(joint), digits=2)}" if axis else ""
        arm += f"\n± {quantity(radius_std(joint), 'm', digits=2)}" if arm else ""
    passed = _endpoints_text(segment) if joint.moves else plain(segment.configuration_end)
    probability = segment.probability if sure is None else dict(sure.kinds).get(joint.kind, 0.0)
    return (joint.kind, rows, passed, axis, arm, percent(min(probability, SUREST), 0), start)


def _endpoints_text(segment: Segment) -> str:
    """The start and end of a moving segment, with the turning point if it comes back."""
    ends = [segment.configuration_start, segment.configuration_end]
    low, high = segment.configuration_range
    furthest = max((low, high), key=lambda value: min(abs(value - end) for end in ends))
    turned = min(abs(furthest - end) for end in ends) > _TURNED_BACK * (high - low)
    stops = [ends[0], furthest, ends[1]] if turned else ends
    return progression(stops, segment.joint.unit)
