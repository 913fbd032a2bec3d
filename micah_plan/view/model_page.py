"""The page of a model: the object with its joints and changepoints, moved through its range in each mode."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import Edge, HybridAutomaton, Mode
from micah_plan.automaton.part_poses import part_poses
from micah_plan.view.document import Band, Document, LegendEntry, Timeline, render
from micah_plan.view.drawing import (
    camera,
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
from micah_plan.view.motion import Keyframes, Moved, animate_attached, animate_bodies, handle_path
from micah_plan.view.palette import FRAME_AXES, GRID, GUARD, INK, category
from micah_plan.view.placement import (
    Threshold,
    chain_coordinates,
    coordinate_range,
    handle_in_part,
    representative_state,
    thresholds,
)
from micah_plan.view.scene import Scene, slug
from micah_plan.view.solids import tube
from micah_plan.view.text import length, quantity

Floats = NDArray[np.float64]

_SWEEP_S, _HOLD_S, _GAP_S = 4.0, 1.5, 0.05
_SWEEP_FRAMES = 33


def mode_colors(automaton: HybridAutomaton) -> dict[str, str]:
    """The colour of each mode, the same on every page and figure of a model."""
    return {name: category(i) for i, name in enumerate(automaton.mode_names)}


def model_page(automaton: HybridAutomaton, *, title: str = "Model") -> str:
    """The page as HTML text."""
    scene = Scene()
    size = object_size(automaton)
    keys, bands = sweep(automaton)
    draw_object(scene, automaton, keys)
    draw_mode_joints(scene, automaton, keys, size)
    marks = thresholds(automaton)
    _draw_thresholds(scene, automaton, marks, size)
    spacing = draw_surroundings(scene, size)
    colors = mode_colors(automaton)
    legend = [
        LegendEntry(colors[mode.name], f"mode {mode.name}: path of the handle", shape="line")
        for mode in automaton.modes
    ]
    legend.append(LegendEntry(INK, "joint axes and paths", "joints", "line"))
    if marks:
        legend.append(LegendEntry(GUARD, "configurational changepoints (guards)", "guards"))
    document = Document(
        title=title,
        kind="hybrid automaton",
        camera=camera(scene, np.concatenate([handle_path(automaton, keys, link.child) for link in automaton.links])),
        facts=_facts(automaton),
        legend=[*legend, *surroundings_legend(spacing)],
        details=[
            ("Modes", [_described(automaton, mode) for mode in automaton.modes]),
            ("Transitions", [_edge_text(edge) for edge in automaton.edges]),
            ("Provenance", [f"{name}: {value}" for name, value in automaton.provenance.items()] or ["not stated"]),
        ],
        timeline=Timeline(keys.duration, bands, readouts(automaton, keys)),
    )
    return render(document, scene)


def sweep(automaton: HybridAutomaton) -> tuple[Keyframes, tuple[Band, ...]]:
    """Every mode in turn: each coordinate it moves goes through its range and back, the others rest."""
    times: list[float] = []
    modes: list[str] = []
    states: list[Floats] = []
    bands: list[Band] = []
    colors = mode_colors(automaton)
    clock = 0.0
    for mode in automaton.modes:
        begin = clock
        rest = representative_state(automaton, mode)
        moved = np.flatnonzero(mode.driven & mode.free).tolist()
        for coordinate in moved:
            lower, upper, _ = coordinate_range(automaton, mode, coordinate)
            phase = np.linspace(0.0, 2 * np.pi, _SWEEP_FRAMES)
            for share, angle in zip(np.linspace(0.0, 1.0, _SWEEP_FRAMES), phase, strict=True):
                x = rest.copy()
                x[coordinate] = lower + (upper - lower) * (1 - np.cos(angle)) / 2
                times.append(clock + share * _SWEEP_S)
                modes.append(mode.name)
                states.append(x)
            clock += _SWEEP_S + _GAP_S
        if not moved:
            times += [clock, clock + _HOLD_S]
            modes += [mode.name] * 2
            states += [rest, rest]
            clock += _HOLD_S + _GAP_S
        bands.append(Band(begin, clock, colors[mode.name], mode.name))
    return Keyframes(np.array(times), tuple(modes), np.stack(states)), tuple(bands)


def draw_object(scene: Scene, automaton: HybridAutomaton, keys: Keyframes, moved: Moved | None = None) -> None:
    """The moving parts, animated (where `moved` says, if given), and the parts that nothing moves."""
    animate_bodies(scene, automaton, keys, moved)
    fixed = fixed_shapes(automaton)
    draw_shapes(scene, "object/fixed", fixed, opacity=0.5)
    scene.reserve(shape_corners(fixed, RigidTransform.identity()))


def draw_mode_joints(
    scene: Scene, automaton: HybridAutomaton, keys: Keyframes, size: float, moved: Moved | None = None
) -> None:
    """The joints of all modes, each link's in the frame of its parent, in the colours of the modes."""
    colors = mode_colors(automaton)
    paths = {}
    shown = {BASE, *(part.name for part in automaton.parts), *(link.child for _, link in shown_links(automaton))}
    for number, link in shown_links(automaton):
        if link.parent not in shown:
            continue
        path = paths[number] = f"joints/{slug(link.child, number)}"
        point = handle_in_part(automaton, link.child)
        for order, mode in enumerate(automaton.modes):
            limits = coordinate_range(automaton, mode, link.coordinate)[:2]
            joint = mode.joints[number]
            draw_joint(scene, f"{path}/{slug(mode.name, order)}", joint, limits, colors[mode.name], size, point)
    animate_attached(scene, automaton, keys, paths, moved)


def draw_surroundings(scene: Scene, size: float) -> float:
    """The base frame, if it lies near, and the ground; returns the grid's spacing [m]."""
    lower, upper = scene.bounds()
    if np.all(np.abs((lower + upper) / 2) < upper - lower + size):
        scene.reserve(np.zeros((1, 3)))
    draw_frame(scene, "frames/base", 0.25 * size)
    return draw_ground(scene)


def surroundings_legend(spacing: float) -> list[LegendEntry]:
    return [
        LegendEntry(FRAME_AXES[0], "base frame (x red, y green, z blue)", "frames", "line"),
        LegendEntry(GRID, f"grid of {length(spacing)}", "ground", "line"),
    ]


def readouts(automaton: HybridAutomaton, keys: Keyframes) -> tuple[tuple[float, tuple[str, ...]], ...]:
    """Mode and coordinates at each keyframe, as text."""
    found = []
    for time, name, x in zip(keys.times, keys.modes, keys.states, strict=True):
        values = [f"{c.name} = {quantity(float(v), c.unit)}" for c, v in zip(automaton.coordinates, x, strict=True)]
        found.append((float(time), (f"mode {name}", *values)))
    return tuple(found)


def _draw_thresholds(scene: Scene, automaton: HybridAutomaton, marks: tuple[Threshold, ...], size: float) -> None:
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
            shapes = link_shapes(automaton, number)
            draw_shapes(scene, path, shapes, color=GUARD, opacity=0.22)
            scene.place(path, poses[link.child])
            scene.reserve(shape_corners(shapes, poses[link.child]))
            handle = handle_in_part(automaton, link.child)
            axis = np.array(mode.joints[number].axis)
            if np.any(axis) and mode.joints[number].kind != "prismatic":
                across = poses[link.child].rotation.inv().apply(axis) * 0.12 * size
                scene.mesh(f"{path}/mark", tube(np.stack([handle - across, handle + across]), 0.012 * size), GUARD)


def _facts(automaton: HybridAutomaton) -> list[tuple[str, str]]:
    facts = [("Coordinates", ", ".join(f"{c.name} [{c.unit}]" for c in automaton.coordinates))]
    facts += [("Modes", str(len(automaton.modes))), ("Transitions", str(len(automaton.edges)))]
    for mark in thresholds(automaton):
        coordinate = automaton.coordinates[mark.coordinate]
        facts.append((f"{mark.source} | {mark.target}", f"{coordinate.name} = {quantity(mark.value, coordinate.unit)}"))
    for coordinate, process, observation in zip(
        automaton.coordinates, automaton.noise.process_std, automaton.noise.observation_std, strict=True
    ):
        facts.append((f"{coordinate.name}: σ per step", quantity(process, coordinate.unit)))
        facts.append((f"{coordinate.name}: σ measured", quantity(observation, coordinate.unit)))
    for mode in automaton.modes:
        for i, std in mode.observation_std:
            name, unit = automaton.coordinates[i].name, automaton.coordinates[i].unit
            facts.append((f"{name}: σ measured in {mode.name}", quantity(std, unit)))
    light = automaton.noise.light
    if light is not None:
        places = [f"{automaton.coordinates[i].name} = {value:g}" for i, value in light.at]
        grows = [f"{c.name} {g:g}" for c, g in zip(automaton.coordinates, light.growth, strict=True) if g]
        facts.append((f"σ measured grows away from {', '.join(places)} by", f"{', '.join(grows)} per unit"))
    return facts


def _described(automaton: HybridAutomaton, mode: Mode) -> str:
    joints = ", ".join(f"{link.child} {joint.kind}" for link, joint in zip(automaton.links, mode.joints, strict=True))
    ranges = []
    for i, coordinate in enumerate(automaton.coordinates):
        if mode.driven[i]:
            lower, upper, stated = coordinate_range(automaton, mode, i)
            ends = f"{coordinate.name} from {quantity(lower, coordinate.unit)} to {quantity(upper, coordinate.unit)}"
            ranges.append(ends if stated else f"{ends} (range not stated, chosen for display)")
    pins = [f"{automaton.coordinates[p.coordinate].name} held at {p.value:.3f}" for p in mode.pins]
    return "; ".join([f"{mode.name}: {joints}", *ranges, *pins])


def _edge_text(edge: Edge) -> str:
    guard = " and ".join(h.name or f"a'x + b'u >= {h.c:g}" for h in edge.guard.half_spaces) or "always"
    reset = "" if edge.reset.is_identity else (", clamped" if edge.is_self_transition else ", with a reset")
    return f"{edge.name}: {guard}{reset}"
