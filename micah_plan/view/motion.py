"""An automaton's parts set in motion: everything in the scene that follows the keyframes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.kinematics import part_poses, poses_of_states
from micah_plan.view.drawing import draw_shapes, link_shapes, shape_corners, shown_links
from micah_plan.view.keyframes import Keyframes
from micah_plan.view.placement import ellipsoid, handle_in_part, handle_jacobian
from micah_plan.view.scene import Scene, slug, transforms

Floats = NDArray[np.float64]
Moved = Mapping[str, RigidTransform]


def poses_over_time(
    automaton: HybridAutomaton, keys: Keyframes, offset: Floats | None = None
) -> dict[str, RigidTransform]:
    """(k,) poses by part; `offset` (k, n) is added to the states."""
    states = keys.states if offset is None else keys.states + offset
    matrices = {link.child: np.empty((len(states), 4, 4)) for link in automaton.links}
    for name in dict.fromkeys(keys.modes):  # all states of a mode at once
        rows = np.flatnonzero([own == name for own in keys.modes])
        for child, poses in poses_of_states(automaton, automaton.mode(name), states[rows]).items():
            matrices[child][rows] = poses.as_matrix()
    return {child: RigidTransform.from_matrix(found) for child, found in matrices.items()}


def handle_path(automaton: HybridAutomaton, keys: Keyframes, part: str) -> Floats:
    """(k, 3) positions of a part's handle [m, base frame]."""
    return np.asarray(poses_over_time(automaton, keys)[part].apply(handle_in_part(automaton, part)))


def animate_bodies(scene: Scene, automaton: HybridAutomaton, keys: Keyframes, moved: Moved | None = None) -> None:
    """The moving parts with their shapes; `moved` has their poses where those are not the states' own."""
    moved = poses_over_time(automaton, keys) if moved is None else moved
    for number, link in shown_links(automaton):
        path, poses = f"object/{slug(link.child, number)}", moved[link.child]
        shapes = link_shapes(automaton, number)
        draw_shapes(scene, path, shapes)
        scene.animate(path, keys.times, poses)
        for i in range(0, len(poses), max(1, len(poses) // 12)):
            scene.reserve(shape_corners(shapes, poses[i]))


def animate_attached(
    scene: Scene, automaton: HybridAutomaton, keys: Keyframes, paths: Mapping[int, str], moved: Moved | None = None
) -> None:
    """What is drawn in the frame of a link's parent (`paths`, by number of the link) moves with that parent."""
    poses = poses_over_time(automaton, keys) if moved is None else moved
    for number, path in paths.items():
        link = automaton.links[number]
        if link.parent in poses:
            scene.animate(path, keys.times, poses[link.parent])


def animate_ghosts(
    scene: Scene, automaton: HybridAutomaton, keys: Keyframes, sigmas: float, layer: str, color: str
) -> None:
    """Pale copies of the parts where each coordinate is `sigmas` standard deviations ahead of and behind the mean."""
    if keys.factors is None:
        return
    spread = sigmas * np.sqrt((keys.factors**2).sum(axis=2))
    for side, sign in (("ahead", 1.0), ("behind", -1.0)):
        moved = poses_over_time(automaton, keys, sign * spread)
        for number, link in shown_links(automaton):
            path = f"{layer}/{side}/{slug(link.child, number)}"
            draw_shapes(scene, path, link_shapes(automaton, number), color=color, opacity=0.16)
            scene.animate(path, keys.times, moved[link.child])


def belief_ellipsoids(
    automaton: HybridAutomaton, keys: Keyframes, part: str, factor: float, floor: float
) -> tuple[RigidTransform, Floats]:
    """(k,) poses and (k, 3) radii [m] of the ellipsoid {p: p' (J P J')⁻¹ p <= factor²} of a part's handle.

    J is the handle's Jacobian and P the belief's covariance; radii smaller than `floor` are drawn as `floor`.
    """
    poses, radii = [], []
    before: Floats | None = None
    for name, x, L in zip(keys.modes, keys.states, _factors(keys), strict=True):
        mode = automaton.mode(name)
        spread = handle_jacobian(automaton, mode, x, part) @ L
        axes, size = ellipsoid(spread @ spread.T, factor, floor)
        if before is not None:
            axes, size = _matched(axes, size, before)
        before = axes
        center = part_poses(automaton, mode, x)[part].apply(handle_in_part(automaton, part))
        poses.append(RigidTransform.from_components(center, Rotation.from_matrix(axes)))
        radii.append(size)
    return transforms(poses), np.stack(radii)


def _factors(keys: Keyframes) -> Floats:
    n = keys.states.shape[1]
    return np.zeros((len(keys.states), n, n)) if keys.factors is None else keys.factors


def _matched(axes: Floats, radii: Floats, before: Floats) -> tuple[Floats, Floats]:
    """The same ellipsoid with its axes in the order and sense closest to those before, so that it does not tumble."""
    overlap = before.T @ axes
    order = np.zeros(3, dtype=int)
    free = np.abs(overlap).copy()
    for _ in range(3):
        i, j = np.unravel_index(np.argmax(free), free.shape)
        order[i] = j
        free[i, :] = free[:, j] = -1.0
    turned = axes[:, order] * np.where(np.diag(overlap[:, order]) < 0, -1.0, 1.0)
    if np.linalg.det(turned) < 0:
        turned = turned * np.array([1.0, 1.0, -1.0])
    return turned, radii[order]
