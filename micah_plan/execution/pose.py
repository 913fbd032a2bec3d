"""Between configurations and poses: where the parts are, what a measurement says of x, what a hand has to be told.

A link's pose is relative to its parent; measurements and commands are in the base frame. Links are parents first.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import HybridAutomaton, Mode
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.kinematics import forward, inverse
from micah_plan.automaton.tracks import in_base_frame, measuring_links
from micah_plan.execution.plant import Command

Floats = NDArray[np.float64]


def moving_mode(automaton: HybridAutomaton, mode: str, coordinate: int) -> Mode:
    """The mode whose joint and inputs move a coordinate, as seen from `mode`.

    That is the mode itself; if it holds the coordinate still, the next mode that its edges lead to, else the first of
    the automaton that moves it, else (nothing ever does) the mode itself.
    """
    here = automaton.mode(mode)
    neighbours = [automaton.mode(edge.target) for edge in automaton.edges_from(mode)]
    candidates = [here, *neighbours, *automaton.modes]
    return next((candidate for candidate in candidates if candidate.B[coordinate].any()), here)


def moving_joints(automaton: HybridAutomaton, mode: str) -> tuple[Joint, ...]:
    """Per link, the joint that relates poses to its coordinate even while `mode` holds it still."""
    links = enumerate(automaton.links)
    return tuple(moving_mode(automaton, mode, link.coordinate).joints[number] for number, link in links)


def chain(automaton: HybridAutomaton, joints: Sequence[Joint], x: Floats) -> tuple[RigidTransform, ...]:
    """Pose of each link's child in the base frame, for one joint per link and x (n,)."""
    relative = [forward(joint, x[link.coordinate])[0] for link, joint in zip(automaton.links, joints, strict=True)]
    return carried(automaton, relative)


def carried(automaton: HybridAutomaton, relative: Sequence[RigidTransform]) -> tuple[RigidTransform, ...]:
    """Pose of each link's child in the base frame, from its pose relative to its parent."""
    poses: dict[str, RigidTransform] = {}
    for link, pose in zip(automaton.links, relative, strict=True):
        poses[link.child] = poses[link.parent] * pose if link.parent in poses else pose
    return tuple(poses[link.child] for link in automaton.links)


def components(poses: Sequence[RigidTransform]) -> tuple[Floats, Floats]:
    """Positions (l, 3) [m] and quaternions (l, 4), scalar last and not negative."""
    position = np.array([pose.translation for pose in poses]).reshape(-1, 3)
    quaternion = np.array([pose.rotation.as_quat(canonical=True) for pose in poses]).reshape(-1, 4)
    return position, quaternion


def configuration(automaton: HybridAutomaton, mode: str, position: Floats, quaternion: Floats, near: Floats) -> Floats:
    """The configuration that measured poses show, by each link's inverse kinematics.

    Args:
        mode: whose joints are used; a rigid joint says nothing of the configuration, so a moving one stands in.
        position, quaternion: (l, 3) [m] and (l, 4), base frame.
        near: (n,) estimate, to tell whole turns apart.

    Returns:
        (n,) [rad or m]; NaN for coordinates of no link.
    """
    x = np.full(automaton.n, np.nan)
    rotations = Rotation.from_quat(quaternion)
    measured = {
        link.child: RigidTransform.from_components(position[number], rotations[number])
        for number, link in enumerate(automaton.links)
    }
    joints = moving_joints(automaton, mode)
    for number, link in measuring_links(automaton):
        pose = measured[link.child]
        if link.parent != BASE and link.parent in measured:
            pose = measured[link.parent].inv() * pose
        x[link.coordinate] = inverse(joints[number], pose.translation, pose.rotation, near=near[link.coordinate])[0]
    return x


def input_effect(automaton: HybridAutomaton, mode: str) -> Floats:
    """(n, m) change of configuration per input, also where `mode` holds a coordinate and only feels the pull."""
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
    origin = [b.translation - a.translation for a, b in zip(before, after, strict=True)]
    handle = [b.apply(h) - a.apply(h) for a, b, h in zip(before, after, handles, strict=True)]
    given = [np.array(moved).reshape(len(automaton.links), 3) for moved in (origin, handle)]
    for number, link in enumerate(automaton.links if automaton.effects else ()):
        if link.parent == BASE:
            turned = in_base_frame(automaton, link.coordinate, np.eye(3))  # rows: what becomes of each unit vector
            for moved in given:
                moved[number] = np.linalg.solve(turned.T, moved[number])
    return Command(np.asarray(u, dtype=float), *given)
