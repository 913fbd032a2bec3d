"""A recording seen through an automaton: one row per time, one column per link, configurations instead of poses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from micah_plan.automaton.hybrid import HybridAutomaton, Link
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.kinematics import inverse, inverse_jacobian
from micah_plan.errors import InputError, shown
from micah_plan.recording.value import DEFAULT_PART, Recording

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Track:
    """One run of a recording in the automaton's coordinates (T times, l links, n states, m inputs).

    Attributes:
        run: its number in the recording.
        time: (T,) [s].
        position: (T, l, 3) [m] and quaternion: (T, l, 4) of each link's child relative to its parent; the quaternion is
            None where orientation was not measured.
        x: (T, n) measured configuration, from the inverse kinematics of each link's moving joint.
        u: (T-1, m) commanded displacement of the configuration, from the actions by the inverse Jacobian; None if
            the recording has no actions.
    """

    run: int
    time: Floats
    position: Floats
    quaternion: Floats | None
    x: Floats
    u: Floats | None


def moving_joint(automaton: HybridAutomaton, link: int) -> Joint:
    """The joint that measures a link's configuration: the first that is not rigid, over the modes in order."""
    joints = [mode.joints[link] for mode in automaton.modes]
    return next((joint for joint in joints if joint.kind != "rigid"), joints[0])


def tracks(automaton: HybridAutomaton, recording: Recording) -> tuple[Track, ...]:
    """Every run of a recording in the automaton's coordinates.

    Parts are matched to links by name; a recording without a part column matches an automaton with a single link.

    Raises:
        InputError: if parts and links do not match, or the parts of a run were not measured at the same times.
    """
    names = _part_of_link(automaton, recording)
    return tuple(_track(automaton, recording.select(run=run), run, names) for run in recording.runs)


def _part_of_link(automaton: HybridAutomaton, recording: Recording) -> tuple[str, ...]:
    children = tuple(link.child for link in automaton.links)
    if len(children) == 1 and recording.parts == (DEFAULT_PART,):
        return recording.parts
    missing = [name for name in children if name not in recording.parts]
    if missing:
        raise InputError(
            f"expected the parts {', '.join(children)} of the model, found {', '.join(recording.parts)}",
            where="column 'part'",
            remedy=f"rename the part or take the model of this object (missing: {', '.join(missing)})",
        )
    return children


def _track(automaton: HybridAutomaton, rows: Recording, run: int, names: tuple[str, ...]) -> Track:
    by_link = [rows.select(part=name) for name in names]
    time = by_link[0].time
    for name, part in zip(names, by_link, strict=True):
        if not np.array_equal(part.time, time):
            raise InputError(
                f"run {run}: part {shown(name)} was not measured at the same times as part {shown(names[0])}",
                where="column 't'",
                remedy="write one row per part and time",
            )
    named = dict(zip(names, by_link, strict=True))
    relative = [_relative(named, link) for link in automaton.links]
    position = np.stack([r.position for r in relative], axis=1)
    quaternions = [r.quaternion for r in relative if r.quaternion is not None]
    quaternion = np.stack(quaternions, axis=1) if len(quaternions) == len(relative) else None
    x = configurations(automaton, position, quaternion)
    actions = [r.action[:-1] for r in relative if r.action is not None]
    u = displacements(automaton, x, np.stack(actions, axis=1)) if len(actions) == len(relative) else None
    return Track(run, time, position, quaternion, x, u)


def _relative(parts: dict[str, Recording], link: Link) -> Recording:
    """The rows of a link's child with poses and actions in its parent's frame instead of the base frame."""
    own = parts[link.child] if link.child in parts else next(iter(parts.values()))
    parent = parts.get(link.parent)
    if parent is None:
        return own
    if parent.quaternion is None:
        raise InputError(
            f"part {shown(link.child)} moves with {shown(link.parent)}, whose orientation was not measured",
            where="columns qx, qy, qz, qw",
            remedy="record the orientation of every part that others hang on",
        )
    frame = parent.poses().inv()
    pose = frame * own.poses()
    return replace(
        own,
        position=pose.translation,
        quaternion=None if own.quaternion is None else pose.rotation.as_quat(),
        action=None if own.action is None else frame.rotation.apply(own.action.copy()),  # SciPy refuses read-only rows
    )


def configurations(automaton: HybridAutomaton, position: Floats, quaternion: Floats | None) -> Floats:
    """(T, n) configurations of measured poses: position (T, l, 3) [m] and quaternion (T, l, 4) per link."""
    x = np.zeros((len(position), automaton.n))
    for number, link in enumerate(automaton.links):
        rotation = None if quaternion is None else Rotation.from_quat(quaternion[:, number])
        x[:, link.coordinate] = inverse(moving_joint(automaton, number), position[:, number], rotation)
    return x


def displacements(automaton: HybridAutomaton, x: Floats, action: Floats) -> Floats:
    """(T-1, m) inputs of commanded displacements (T-1, l, 3) [m] of the parts' origins at x (>= T-1, n).

    Source: MICAH, equation for Δ̂_t: the inverse Jacobian maps an action to a change of configuration.
    """
    if automaton.m != automaton.n:
        raise InputError("actions can only be read by an automaton with one input per coordinate")
    u = np.zeros((len(action), automaton.m))
    for number, link in enumerate(automaton.links):
        joint = moving_joint(automaton, number)
        u[:, link.coordinate] = inverse_jacobian(joint, x[: len(action), link.coordinate], action[:, number])
    return u
