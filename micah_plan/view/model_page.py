"""The page of a model: the object with its joints and changepoints, moved through its range in each mode."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import RigidTransform

from micah_plan.arrays import Floats
from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Mode
from micah_plan.automaton.kinematics import part_poses
from micah_plan.quantities import interval, plain, quantity
from micah_plan.view.camera import camera
from micah_plan.view.diagram import diagram_of, guard_words
from micah_plan.view.drawing import (
    JointLook,
    draw_copy,
    draw_frame,
    draw_ground,
    draw_joint,
    draw_shapes,
    fixed_shapes,
    link_shapes,
    object_size,
    shape_corners,
    shown_links,
)
from micah_plan.view.motion import Keyframes, Moved, handle_path, poses_over_time
from micah_plan.view.page import Band, LegendEntry, ScenePage, Timeline, render_scene
from micah_plan.view.palette import FRAME_AXES, GRID, GUARD, INK, mode_colors
from micah_plan.view.placement import (
    Threshold,
    chain_coordinates,
    coordinate_range,
    handle_in_part,
    representative_state,
    thresholds,
)
from micah_plan.view.scene import DrawnScene, slug
from micah_plan.view.solids import tube

_SWEEP_S, _REST_S, _GAP_S = 4.0, 1.5, 0.05
_SWEEP_FRAMES = 33


def model_page(automaton: HybridAutomaton, *, title: str = "Model") -> str:
    """The page as HTML text."""
    scene = DrawnScene()
    size = object_size(automaton)
    keys, bands = motion_through_modes(automaton)
    moved = poses_over_time(automaton, keys)
    draw_object(scene, automaton, keys, moved)
    draw_mode_joints(scene, automaton, keys, moved, size)
    marks = thresholds(automaton)
    _draw_thresholds(scene, automaton, marks, size)
    spacing = draw_ground_and_frame(scene, size)
    colors = mode_colors(automaton)
    legend = [LegendEntry(colors[mode.name], f"mode {mode.name}", shape="line") for mode in automaton.modes]
    legend.append(LegendEntry(INK, "joint axes and paths of the handle", "joints", "line"))
    if marks:
        legend.append(LegendEntry(GUARD, "guards: where the mode changes", "guards"))
    page = ScenePage(
        title=title,
        kind="model (hybrid automaton)",
        camera=camera(scene, np.concatenate([handle_path(automaton, keys, link.child) for link in automaton.links])),
        facts=_facts(automaton),
        legend=[*legend, *ground_legend(spacing)],
        is_tinted=True,
        diagram=diagram_of(automaton.mode_names, automaton.edges, colors),
        details=[
            ("Modes", [_described(automaton, mode) for mode in automaton.modes]),
            ("Transitions", [_edge_text(edge) for edge in automaton.edges]),
            ("Provenance", [f"{name}: {value}" for name, value in automaton.provenance.items()] or ["not stated"]),
        ],
        timeline=Timeline(keys.duration, bands, readouts(automaton, keys)),
    )
    return render_scene(page, scene)


def motion_through_modes(automaton: HybridAutomaton) -> tuple[Keyframes, tuple[Band, ...]]:
    """Each mode in turn: every coordinate it moves covers its range and returns, others rest."""
    times: list[Floats] = []
    modes: list[str] = []
    states: list[Floats] = []
    bands: list[Band] = []
    colors = mode_colors(automaton)
    clock = 0.0
    for mode in automaton.modes:
        begin, rest = clock, representative_state(automaton, mode)
        moves = []
        for coordinate in np.flatnonzero(mode.driven & mode.free).tolist():
            lower, upper, _ = coordinate_range(automaton, mode, coordinate)
            x = np.tile(rest, (_SWEEP_FRAMES, 1))
            x[:, coordinate] = lower + (upper - lower) * (1 - np.cos(np.linspace(0.0, 2 * np.pi, _SWEEP_FRAMES))) / 2
            moves.append((_SWEEP_S, x))
        for seconds, x in moves or [(_REST_S, np.stack([rest, rest]))]:
            times.append(clock + np.linspace(0.0, 1.0, len(x)) * seconds)
            modes += [mode.name] * len(x)
            states.append(x)
            clock += seconds + _GAP_S
        bands.append(Band(begin, clock, colors[mode.name], mode.name))
    return Keyframes(np.concatenate(times), tuple(modes), np.concatenate(states)), tuple(bands)


def draw_object(scene: DrawnScene, automaton: HybridAutomaton, keys: Keyframes, moved: Moved) -> None:
    """The moving parts, animated, and the fixed parts."""
    for number, link in shown_links(automaton):
        path, poses, shapes = f"object/{slug(link.child, number)}", moved[link.child], link_shapes(automaton, number)
        draw_shapes(scene, path, shapes)
        scene.animate(path, keys.times, poses)
        for i in range(0, len(poses), max(1, len(poses) // 12)):
            scene.reserve(shape_corners(shapes, poses[i]))
    fixed = fixed_shapes(automaton)
    draw_shapes(scene, "object/fixed", fixed, opacity=0.5)
    scene.reserve(shape_corners(fixed, RigidTransform.identity()))


def draw_mode_joints(scene: DrawnScene, automaton: HybridAutomaton, keys: Keyframes, moved: Moved, size: float) -> None:
    """The joints of all modes, each link's in the frame of its parent, in the colours of the modes."""
    colors = mode_colors(automaton)
    shown = {BASE, *(part.name for part in automaton.parts), *(link.child for _, link in shown_links(automaton))}
    drawn = [(number, link) for number, link in shown_links(automaton) if link.parent in shown]
    for number, link in drawn:
        point = handle_in_part(automaton, link.child)
        for order, mode in enumerate(automaton.modes):
            path = f"joints/{slug(link.child, number)}/{slug(mode.name, order)}"
            limits = coordinate_range(automaton, mode, link.coordinate)[:2]
            draw_joint(scene, path, mode.joints[number], limits, JointLook(colors[mode.name], size, point=point))
    for number, link in drawn:
        if link.parent in moved:
            scene.animate(f"joints/{slug(link.child, number)}", keys.times, moved[link.parent])


def draw_ground_and_frame(scene: DrawnScene, size: float) -> float:
    """Draw the base frame, if near, and the ground; returns the grid's spacing [m]."""
    lower, upper = scene.bounds()
    if np.all(np.abs((lower + upper) / 2) < upper - lower + size):
        scene.reserve(np.zeros((1, 3)))
    draw_frame(scene, "frames/base", 0.25 * size)
    return draw_ground(scene)


def ground_legend(spacing: float) -> list[LegendEntry]:
    return [
        LegendEntry(FRAME_AXES[0], "base frame (x red, y green, z blue)", "frames", "line"),
        LegendEntry(GRID, f"grid of {quantity(spacing, 'm')}", "ground", "line"),
    ]


def readouts(automaton: HybridAutomaton, keys: Keyframes) -> tuple[tuple[float, tuple[str, ...]], ...]:
    """Mode and coordinates at each keyframe, as text."""
    rows = []
    for time, name, x in zip(keys.times, keys.modes, keys.states, strict=True):
        values = map(_valued, automaton.coordinates, x.tolist())
        rows.append((float(time), (f"mode {name}", *values)))
    return tuple(rows)


def _draw_thresholds(scene: DrawnScene, automaton: HybridAutomaton, marks: tuple[Threshold, ...], size: float) -> None:
    """A pale copy of the part at each changepoint, and a bar through its handle."""
    for order, mark in enumerate(marks):
        mode = automaton.mode(mark.source)
        x = representative_state(automaton, mode)
        x[mark.coordinate] = mark.value
        poses = part_poses(automaton, mode, x)
        for number, link in enumerate(automaton.links):
            if mark.coordinate not in chain_coordinates(automaton, link.child):
                continue
            path = f"guards/{order}/{slug(link.child, number)}"
            draw_copy(scene, path, link_shapes(automaton, number), poses[link.child], GUARD, 0.22)
            handle = handle_in_part(automaton, link.child)
            joint = mode.joints[number]
            if joint.turns:
                across = poses[link.child].rotation.inv().apply(joint.axis) * 0.12 * size
                scene.mesh(f"{path}/mark", tube(np.stack([handle - across, handle + across]), 0.012 * size), GUARD)


def _facts(automaton: HybridAutomaton) -> list[tuple[str, str]]:
    facts = [("Coordinates", ", ".join(f"{c.name} [{c.unit}]" for c in automaton.coordinates))]
    facts += [("Modes", str(len(automaton.modes))), ("Transitions", str(len(automaton.edges)))]
    for mark in thresholds(automaton):
        facts.append((f"{mark.source} | {mark.target} at", _valued(automaton.coordinates[mark.coordinate], mark.value)))
    for named, process, observation in zip(
        automaton.coordinates, automaton.noise.process_std, automaton.noise.observation_std, strict=True
    ):
        facts.append((f"{named.name}: σ of motion per step", quantity(process, named.unit)))
        facts.append((f"{named.name}: σ of a measurement", _measured_to(observation, named.unit)))
    for mode in automaton.modes:
        for i, std in mode.observation_std:
            named = automaton.coordinates[i]
            facts.append((f"{named.name}: σ of a measurement in {mode.name}", _measured_to(std, named.unit)))
    light = automaton.noise.light
    if light is not None:
        places = [_valued(automaton.coordinates[i], value) for i, value in light.at]
        grows = [f"{c.name} {plain(g)}" for c, g in zip(automaton.coordinates, light.growth, strict=True) if g]
        label = f"σ of a measurement grows with the distance from {', '.join(places)}"
        facts.append((label, f"by {', '.join(grows)} per unit of distance"))
    return facts


def _valued(coordinate: Coordinate, value: float) -> str:
    return f"{coordinate.name} = {quantity(value, coordinate.unit)}"


def _measured_to(std: float, unit: str) -> str:
    return quantity(std, unit) if np.isfinite(std) else "not measured"


def _described(automaton: HybridAutomaton, mode: Mode) -> str:
    joints = ", ".join(f"{link.child} {joint.kind}" for link, joint in zip(automaton.links, mode.joints, strict=True))
    ranges = []
    for i, coordinate in enumerate(automaton.coordinates):
        if mode.driven[i]:
            lower, upper, stated = coordinate_range(automaton, mode, i)
            ends = f"{coordinate.name} from {interval(lower, upper, coordinate.unit)}"
            ranges.append(ends if stated else f"{ends} (the model states no range; this one is for the picture)")
    pinned = [(automaton.coordinates[pin.coordinate], pin.value) for pin in mode.pins]
    fixed = [f"{named.name} fixed at {quantity(value, named.unit)}" for named, value in pinned]
    return "; ".join([f"{mode.name}: {joints}", *ranges, *fixed])


def _edge_text(edge: Edge) -> str:
    kept = ", the coordinate stops there" if edge.is_self_transition else ", the state is reset"
    return f"{edge.name}: {guard_words(edge)}{'' if edge.reset.is_identity else kept}"
