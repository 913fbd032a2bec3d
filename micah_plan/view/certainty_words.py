"""What learning found and how sure it is, in words: headline, changepoints, joints, misfit, action channel."""

from __future__ import annotations

import math

import numpy as np

from micah_plan.automaton.certainty import CHANNEL_NAMES, ActionChannel
from micah_plan.automaton.graph import Segment
from micah_plan.automaton.joint import Joint, radius
from micah_plan.view.learned import LearnedRun
from micah_plan.view.segments import is_misfit
from micah_plan.view.text import length

NO_FIT = "no single-joint model fits"


def headline(learned: LearnedRun) -> str:
    """The finding in one line: ``"revolute → rigid"``, or that no single-joint model fits."""
    names = [NO_FIT if is_misfit(s.segment) else s.segment.joint.kind for s in learned.stretches]
    return " → ".join(names) if names else "no segments"


def changepoint_words(learned: LearnedRun) -> str:
    """Where segments start: ``"changepoint at row 40 (95 %: 38 to 42)"``."""
    starts = []
    for stretch in learned.stretches[1:]:
        low, high = stretch.interval or (0, 0)
        starts.append(f"row {stretch.segment.start}" + (f" (95 %: {low} to {high})" if stretch.interval else ""))
    if not starts:
        return "no changepoint"
    return f"changepoint{'s' if len(starts) > 1 else ''} at {', '.join(starts)}"


def joint_words(segment: Segment) -> str:
    """A joint's parameters with one standard deviation: ``"turns 69°, radius 30.0 cm, axis ± 0.8°, centre ± 2 mm"``."""
    joint = segment.joint
    if joint.kind == "rigid":
        return "at rest"
    travel = segment.configuration_range[1] - segment.configuration_range[0]
    words = [f"travels {length(travel)}" if joint.kind == "prismatic" else f"turns {math.degrees(travel):.0f}°"]
    words += [] if joint.kind == "prismatic" else [f"radius {length(radius(joint))}"]
    words += [f"pitch {1000 * joint.pitch:.3g} mm/rad"] if joint.kind == "screw" else []
    axis, center = _spread(joint, "axis"), _spread(joint, "center")
    words += [f"axis ± {math.degrees(axis):.2g}°"] if axis is not None else []
    words += [f"centre ± {length(float(f'{center:.2g}'))}"] if center is not None else []
    return ", ".join(words)


def misfit_words(segment: Segment) -> str:
    """Why no single joint explains a segment, with the numbers; empty if one does."""
    misfit = None if segment.certainty is None else segment.certainty.misfit
    if misfit is None:
        return ""
    missed = f"{length(misfit.position)} (noise {length(misfit.position_noise)})"
    if misfit.rotation is not None and misfit.rotation_noise is not None:
        turned = f"{math.degrees(misfit.rotation):.2g}° (noise {math.degrees(misfit.rotation_noise):.2g}°)"
        missed += f" and {turned}"
    return (
        f"{NO_FIT} rows {segment.start} to {segment.end}: the best, {segment.joint.kind}, misses by {missed}; "
        f"log odds for free motion {misfit.log_odds:+.0f}"
    )


def channel_words(learned: LearnedRun, *, recorded: bool) -> str:
    """How the recorded actions move the part, with one standard deviation; empty if nobody asked."""
    if not learned.assessed:
        return ""
    if not recorded:
        return "actions: none recorded"
    channel = learned.channel
    if channel is None:
        return "actions: they say nothing about the motion"
    std = dict(zip(CHANNEL_NAMES, np.sqrt(np.diag(np.array(channel.covariance))), strict=True))
    delay = f"{abs(channel.delay):.2f} ± {std['delay']:.2f} s {'after' if channel.delay >= 0 else 'before'} it"
    if abs(channel.delay) < std["delay"]:
        delay = f"at the same time (± {std['delay']:.2f} s)"
    return (
        f"actions: {100 * channel.explained:.0f} % of the steps explained; the part makes "
        f"{channel.gain:.2f} ± {std['gain']:.2f} of a recorded action, {delay}; {_turned(channel)}"
    )


def _turned(channel: ActionChannel) -> str:
    """The frame of the actions; along the rotation's own direction its spread is the one that matters."""
    vector = np.array(channel.frame_rotation)
    spread = np.array(channel.covariance)[:3, :3]
    angle = float(np.linalg.norm(vector))
    if angle > 1e-9:
        std = math.sqrt(max(float(vector @ spread @ vector), 0.0)) / angle
    else:
        std = math.sqrt(float(np.linalg.eigvalsh(spread).max()))
    words = f"{math.degrees(angle):.0f}° ± {math.degrees(std):.0f}°"
    return f"given in a frame turned by {words}" if angle > 2 * std else f"given in the base frame (turned by {words})"


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
