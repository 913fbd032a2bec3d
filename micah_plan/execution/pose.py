"""Conversion between configurations and poses: forward kinematics, measured configurations, commands.

A link's pose is relative to its parent; measurements and commands are in the base frame. Links are parents first.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.arrays import Booleans, Floats
from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import HybridAutomaton, Mode
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.kinematics import inverse, placements
from micah_plan.automaton.memo import memoised
from micah_plan.automaton.tracks import in_base_frame, measuring_links, read_by_sensors
from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.execution.plant import Command, Measurement


def moving_mode(automaton: HybridAutomaton, mode: str, coordinate: int) -> Mode:
    """The mode whose joint and inputs move a coordinate, as seen from `mode`.

    That is the mode itself; if it does not move the coordinate, the next mode along its edges, else the first of the
    automaton that moves it, else (if none does) the mode itself.
    """
    here = automaton.mode(mode)
    neighbours = [automaton.mode(edge.target) for edge in automaton.edges_from(mode)]
    candidates = [here, *neighbours, *automaton.modes]
    return next((candidate for candidate in candidates if candidate.B[coordinate].any()), here)


@memoised
def moving_joints(automaton: HybridAutomaton, mode: str) -> tuple[Joint, ...]:
    """Per link, the joint that relates poses to its coordinate even while `mode` does not move it."""
    links = enumerate(automaton.links)
    return tuple(moving_mode(automaton, mode, link.coordinate).joints[number] for number, link in links)


def chain(automaton: HybridAutomaton, joints: Sequence[Joint], x: Floats) -> Floats:
    """(l, 4, 4) pose of each link's child in the base frame, for one joint per link and x (n,)."""
    relative = [placements(joint, x[link.coordinate])[0] for link, joint in zip(automaton.links, joints, strict=True)]
    return carried(automaton, np.array(relative).reshape(-1, 4, 4))


def carried(automaton: HybridAutomaton, relative: Floats) -> Floats:
    """(l, 4, 4) pose of each link's child in the base frame, from its pose (l, 4, 4) relative to its parent."""
    poses: dict[str, Floats] = {}
    for link, pose in zip(automaton.links, relative, strict=True):
        poses[link.child] = poses[link.parent] @ pose if link.parent in poses else pose
    return np.array([poses[link.child] for link in automaton.links]).reshape(-1, 4, 4)


def relative(automaton: HybridAutomaton, position: Floats, quaternion: Floats) -> list[Floats]:
    """Pose (4, 4) of each link's child relative to its parent, from their poses in the base frame."""
    named = dict(zip((link.child for link in automaton.links), matrices(position, quaternion), strict=True))
    return [
        np.linalg.solve(named[link.parent], named[link.child]) if link.parent in named else named[link.child]
        for link in automaton.links
    ]


def matrices(position: Floats, quaternion: Floats) -> Floats:
    """(l, 4, 4) poses from positions (l, 3) and quaternions (l, 4), scalar last."""
    poses = np.tile(np.eye(4), (len(position), 1, 1))
    poses[:, :3, 3] = position
    if len(position):
        poses[:, :3, :3] = Rotation.from_quat(quaternion).as_matrix()
    return poses


def components(poses: Floats) -> tuple[Floats, Floats]:
    """Positions (l, 3) [m] and quaternions (l, 4), scalar last and not negative, of poses (l, 4, 4)."""
    turns = Rotation.from_matrix(poses[:, :3, :3]).as_quat(canonical=True) if len(poses) else np.zeros((0, 4))
    return poses[:, :3, 3].copy(), turns


def configuration(
    automaton: HybridAutomaton,
    mode: str,
    position: Floats,
    quaternion: Floats,
    near: Floats,
    unseen: Booleans | None = None,
) -> Floats:
    """The configuration of measured poses, by each link's inverse kinematics.

    Args:
        mode: whose joints are used; a rigid joint does not show the configuration, so a moving one replaces it.
        position, quaternion: (l, 3) [m] and (l, 4), base frame.
        near: (n,) estimate, to choose whole turns.
        unseen: (l,) links whose pose is none; None: none of them.

    Returns:
        (n,) [rad or m]; NaN for coordinates without a link, and of links that are not seen, or whose parent is not.
    """
    x, joints = np.full(automaton.n, np.nan), moving_joints(automaton, mode)
    poses = relative(automaton, position, quaternion)
    hidden = (
        set()
        if unseen is None
        else {link.child for link, hidden_link in zip(automaton.links, unseen, strict=True) if hidden_link}
    )
    for number, link in measuring_links(automaton):
        if {link.child, link.parent} & hidden:
            continue
        place, turn = poses[number][:3, 3], Rotation.from_matrix(poses[number][:3, :3])
        x[link.coordinate] = inverse(joints[number], place, turn, near=near[link.coordinate])[0]
    return x


def reading(automaton: HybridAutomaton, belief: HybridBelief, measurement: Measurement) -> Floats:
    """The configuration in a measurement [rad or m]; NaN where it shows none.

    Args:
        automaton: the model without memories of inputs, of n coordinates.
        belief: before it, to choose whole turns and the joints of the most likely mode.

    Returns:
        (k,) of the coordinates of the belief, of which there may be more than n.
    """
    mode, measured = belief.most_likely, measurement
    estimate = belief.means[mode]
    x = configuration(
        automaton,
        automaton.mode_names[mode],
        measured.position,
        measured.quaternion,
        estimate[: automaton.n],
        measured.unseen,
    )
    x = read_by_sensors(automaton, x[None], np.array([measured.time]))[0]
    return np.concatenate([x, np.full(len(estimate) - automaton.n, np.nan)])


def input_effect(automaton: HybridAutomaton, mode: str) -> Floats:
    """(n, m) change of configuration per input, also where `mode` fixes a coordinate and the input only pulls at it."""
    rows = [moving_mode(automaton, mode, coordinate).B[coordinate] for coordinate in range(automaton.n)]
    return np.array(rows).reshape(automaton.n, automaton.m)


def command(automaton: HybridAutomaton, mode: str, x: Floats, u: Floats) -> Command:
    """The command that moves the model's parts from x (n,) by the input u (m,): a = f(x + B u) - f(x).

    Where the model knows that commands are taken in a turned frame, they are given in that one.
    """
    joints = moving_joints(automaton, mode)
    before = chain(automaton, joints, x)
    after = chain(automaton, joints, x + input_effect(automaton, mode) @ u)
    handles = [automaton.part(link.child).handle or (0.0, 0.0, 0.0) for link in automaton.links]
    points = np.concatenate([np.array(handles).reshape(-1, 3), np.ones((len(handles), 1))], axis=1)[:, :, None]
    changes = [(after - before)[:, :3, 3], ((after - before) @ points)[:, :3, 0]]
    for number, link in enumerate(automaton.links if automaton.effects else ()):
        if link.parent == BASE:
            turned = in_base_frame(automaton, link.coordinate, np.eye(3))  # rows: the image of each unit vector
            for moved in changes:
                moved[number] = np.linalg.solve(turned.T, moved[number])
    return Command(np.asarray(u, dtype=float), *changes)
