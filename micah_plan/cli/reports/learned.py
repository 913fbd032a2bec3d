"""What `learn` says: segments, changepoints and action channel of every part."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from micah_plan.automaton.certainty import CHANNEL_NAMES, ActionChannel, Misfit
from micah_plan.automaton.graph import KinematicEdge, Segment
from micah_plan.automaton.joint import Joint, radius
from micah_plan.cli.console import out, print_files, table
from micah_plan.quantities import count, duration, in_degrees, percent, plain, quantity, way, with_spread
from micah_plan.view.learning_words import channel_turn

if TYPE_CHECKING:
    from micah_plan.workflow import Learned

_COLUMNS = ("joint", "rows", "configuration", "axis", "radius", "sure", "first row\n(95 %)")
_NARROW = ("joint", "rows", "sure")
_SUREST = 0.999  # a recording is never surer than ">99 %", whatever is left of the odds in floating point


def joint_parameters(joint: Joint) -> dict[str, Any]:
    """Axis (unit, base frame), center [m], radius [m], pitch [m/rad], pose at configuration 0, as far as they apply."""
    parameters: dict[str, Any] = {"position": list(joint.position), "orientation": list(joint.quaternion)}
    if joint.kind != "rigid":
        parameters["axis"] = list(joint.axis)
    if joint.kind in ("revolute", "screw"):
        parameters |= {"center": list(joint.center), "radius": float(radius(joint))}
    if joint.kind == "screw":
        parameters["pitch"] = joint.pitch
    return parameters


def learned(result: Learned, seed: int) -> dict[str, Any]:
    """Keys of `learn`: segments, changepoints and actions of the part (in `edges` for several parts), seconds, seed.

    What was not estimated is null.
    """
    edges = [{"parent": edge.parent, "child": edge.child, **_edge(edge)} for edge in result.graph.edges]
    found = {"edges": edges} if len(edges) > 1 else _edge(result.graph.edges[0])
    modes = [] if result.automaton is None else list(result.automaton.mode_names)
    outcome = {"modes": modes, "reason": result.reason, "warnings": list(result.warnings)}
    return {**found, **outcome, "seconds": result.seconds, "seed": seed}


def _edge(edge: KinematicEdge) -> dict[str, Any]:
    sure = edge.certainty
    return {
        "segments": [_segment(segment) for segment in edge.segments],
        "changepoints": list(edge.changepoints),
        "changepoint_counts": None if sure is None else [list(run) for run in sure.changepoint_counts],
        "action_channel": None if sure is None or sure.channel is None else _channel(sure.channel),
    }


def _segment(segment: Segment) -> dict[str, Any]:
    sure, misfit = segment.certainty, segment.misfit
    start = None if sure is None else sure.start
    data: dict[str, Any] = {
        "model": segment.joint.kind,
        "start": segment.start,
        "end": segment.end,
        "run": segment.run,
        "start_interval": None if start is None else list(start.interval()),
    }
    fitted = {
        "parameters": joint_parameters(segment.joint),
        **_spread(segment.joint),
        "configuration": [segment.configuration_start, segment.configuration_end],
        "probability": segment.probability,
        "probabilities": None if sure is None else dict(sure.kinds),
    }
    if misfit is None:
        return data | fitted
    best = {"model": segment.joint.kind, **fitted}
    return data | {"model": "none", "parameters": {}, "best": best, "misfit": _misfit(misfit)}


def _spread(joint: Joint) -> dict[str, Any]:
    """Covariance of a joint's parameters and their standard deviations, by name [rad, m, m/rad]."""
    if joint.covariance is None:
        return {"stds": None, "covariance": None}
    names, matrix = joint.covariance.names, joint.covariance.matrix
    stds = dict(zip(names, _stds(matrix), strict=True))
    return {"stds": stds, "covariance": {"names": list(names), "matrix": [list(row) for row in matrix]}}


def _misfit(misfit: Misfit) -> dict[str, float | None]:
    return {
        "position_m": misfit.position,
        "rotation_rad": misfit.rotation,
        "position_noise_m": misfit.position_noise,
        "rotation_noise_rad": misfit.rotation_noise,
        "log_odds": misfit.log_odds,
    }


def _channel(channel: ActionChannel) -> dict[str, Any]:
    *turned, gain, delay = _stds(channel.covariance)
    return {
        "frame_rotation": list(channel.frame_rotation),
        "gain": channel.gain,
        "delay": channel.delay,
        "stds": {"frame_rotation": turned, "gain": gain, "delay": delay},
        "covariance": {"names": list(CHANNEL_NAMES), "matrix": [list(row) for row in channel.covariance]},
        "explained": channel.explained,
    }


def _stds(matrix: Sequence[Sequence[float]]) -> list[float]:
    return [math.sqrt(max(row[i], 0.0)) for i, row in enumerate(matrix)]


def print_learned(learned: Learned, files: tuple[Path | None, ...]) -> None:
    """A table of the segments of every edge, how its actions move it, and what was written."""
    for edge in learned.graph.edges:
        shown = table(*_COLUMNS, padding=(0, 1, 0, 0), title_justify="left")
        shown.title = f"{edge.child} relative to {edge.parent}"
        for name in _NARROW:
            shown.columns[_COLUMNS.index(name)].no_wrap = True
        for segment in edge.segments:
            shown.add_row(*segment_row(segment))
        out.print(shown)
        if edge.certainty is not None and edge.certainty.channel is not None:
            out.print(channel_line(edge.certainty.channel), markup=False)
    if learned.automaton is None:
        out.print(f"no model: {learned.reason}", markup=False, style="yellow")
    else:
        modes = count(len(learned.automaton.modes), "mode")
        out.print(f"learned {modes} in {duration(learned.seconds)}")
    print_files(files)


def segment_row(segment: Segment) -> tuple[str, ...]:
    """One line of the table, short enough for 80 columns: kind of joint, rows, way, axis, radius, how sure, start."""
    joint, rows, misfit = segment.joint, f"{segment.start}-{segment.end}", segment.misfit
    if misfit is not None:
        return ("none", rows, f"misses by {quantity(misfit.position, 'm')}", "", "", "", _start(segment))
    axis = "" if joint.kind == "rigid" else " ".join(f"{round(value, 2) + 0.0:.2f}" for value in joint.axis)
    arm = quantity(radius(joint), "m") if joint.kind in ("revolute", "screw") else ""
    passed = plain(segment.configuration_end) if joint.kind == "rigid" else _passed(segment)
    sure = segment.certainty
    probability = segment.probability if sure is None else dict(sure.kinds).get(joint.kind, 0.0)
    shown = percent(min(probability, _SUREST), 0)
    return (joint.kind, rows, passed, axis, arm, shown, _start(segment))


def _passed(segment: Segment) -> str:
    """Where a moving segment begins and ends, and where it turns around if it comes back from further on."""
    ends = [segment.configuration_start, segment.configuration_end]
    low, high = segment.configuration_range
    furthest = max((low, high), key=lambda value: min(abs(value - end) for end in ends))
    turned = min(abs(furthest - end) for end in ends) > 0.2 * (high - low)
    stops = [ends[0], furthest, ends[1]] if turned else ends
    return way(stops, "m" if segment.joint.kind == "prismatic" else "rad")


def _start(segment: Segment) -> str:
    """The rows at one of which a segment starts, with 95 % probability; empty if not estimated."""
    if segment.certainty is None or segment.certainty.start is None:
        return ""
    first, last = segment.certainty.start.interval()
    return f"{first}" if first == last else f"{first}-{last}"


def channel_line(channel: ActionChannel) -> str:
    """The line on the action channel, with one standard deviation each."""
    *_, gain, delay = _stds(channel.covariance)
    made, late = with_spread(channel.gain, gain, ""), with_spread(channel.delay, delay, "s")
    turned = in_degrees(*channel_turn(channel))
    return f"actions explain {percent(channel.explained, 0)}: gain {made}, turned {turned}, delay {late}"
