"""The page of an exploration: the hand's path and pulls, the probable mechanism, and the forces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.arrays import Floats
from micah_plan.exploration.run import Exploration
from micah_plan.quantities import count, percent, quantity
from micah_plan.view.camera import camera
from micah_plan.view.chart import Area, Chart, Curve, Level, Mark, Panel, Words
from micah_plan.view.drawing import JointLook, draw_ground, draw_joint
from micah_plan.view.page import Band, Block, LegendEntry, ScenePage, Status, Timeline, render_scene
from micah_plan.view.palette import BLUE, GREEN, GRID, INK, MUTED, ORANGE, PINK, VERMILLION
from micah_plan.view.placement import coordinate_range
from micah_plan.view.scene import DrawnScene
from micah_plan.view.solids import arrow, beads, tube

_BADGES: dict[str, tuple[str, Status]] = {
    "opened": ("opened", "good"),
    "held": ("held", "fair"),
    "gave_up": ("gave up", "bad"),
}
KINDS = {"fast": MUTED, "unknown": GREEN, "prismatic": ORANGE, "revolute": BLUE}
WORDS = {"fast": "nothing moves it", "unknown": "not yet known", "prismatic": "a slide", "revolute": "a hinge"}
_HEIGHT = 150.0
_STEP_S, _SHORTEST_S, _LONGEST_S = 0.25, 4.0, 20.0
_MOST_FANS, _SMALLEST = 12, 0.05
_FORCE_LENGTH = 0.5  # of the size of the scene, of the arrow of the largest force that was measured


def exploration_page(exploration: Exploration, title: str) -> str:
    """The page as self-contained HTML text; equal values give equal bytes."""
    scene, times = DrawnScene(), _times(exploration)
    places = np.array([moment.place for moment in exploration.moments]).reshape(-1, 3)
    scene.reserve(places)
    size = max(float(np.linalg.norm(np.ptp(places, axis=0))) if len(places) else 0.0, _SMALLEST)
    if len(places):
        _draw_way(scene, exploration, places, size)
        _animate(scene, exploration, places, size, times)
    _draw_model(scene, exploration, size)
    spacing = draw_ground(scene)
    page = ScenePage(
        title=title,
        kind="exploration",
        camera=camera(scene, places if len(places) else np.zeros((1, 3))),
        badge=_BADGES[exploration.outcome],
        message=f"{exploration.reason[:1].upper()}{exploration.reason[1:]}.",
        facts=_facts(exploration),
        details=[("What went wrong on the way", exploration.notes)] if exploration.notes else [],
        legend=_legend(exploration, spacing),
        timeline=_timeline(exploration, times),
        charts=_blocks(exploration) if len(places) else [],
    )
    return render_scene(page, scene)


def _times(exploration: Exploration) -> Floats:
    """(k,) times of steps on the player [s]."""
    steps = exploration.steps
    return np.linspace(0.0, min(max(_STEP_S * steps, _SHORTEST_S), _LONGEST_S), steps) if steps > 1 else np.zeros(steps)


def _draw_way(scene: DrawnScene, exploration: Exploration, places: Floats, size: float) -> None:
    """Draw the path of the handle, the pulls from each place, and the hypothetical directions."""
    scene.mesh("way/line", tube(places, 0.006 * size), BLUE)
    scene.mesh("way/places", beads(places, 0.014 * size), BLUE)
    scene.mesh("way/first", beads(places[:1], 0.035 * size), GREEN)
    leads = np.array([moment.lead for moment in exploration.moments])
    scene.lines("pulls/lines", np.stack([places, places + leads], axis=1).reshape(-1, 3), MUTED)
    unsure = [number for number, moment in enumerate(exploration.moments) if len(moment.fan)]
    for number in unsure[:: max(len(unsure) // _MOST_FANS, 1)]:
        tips = places[number] + 0.15 * size * exploration.moments[number].fan
        ends = np.stack([np.broadcast_to(places[number], tips.shape), tips], axis=1)
        scene.lines(f"fan/{number}", ends.reshape(-1, 3), VERMILLION)


def _animate(scene: DrawnScene, exploration: Exploration, places: Floats, size: float, times: Floats) -> None:
    """Animate the hand along its path, with the measured force as an arrow."""
    forces = np.array([moment.force for moment in exploration.moments])
    lengths = np.linalg.norm(forces, axis=1)
    scene.mesh("hand/place/tip", beads(np.zeros((1, 3)), 0.03 * size), ORANGE)
    scene.mesh("hand/force/arrow", arrow(np.zeros(3), np.array([_FORCE_LENGTH * size, 0.0, 0.0]), 0.012 * size), PINK)
    turns = [_turned_to(force) for force in forces]
    scales = np.repeat(np.maximum(lengths / max(float(lengths.max()), 1e-9), 1e-3)[:, None], 3, axis=1)
    at_places = RigidTransform.from_translation(places)
    pointed = RigidTransform.from_components(places, Rotation.concatenate(turns))
    if len(times) > 1:
        scene.animate("hand/place", times, at_places)
        scene.animate("hand/force", times, pointed, scales=scales)
    else:
        scene.place("hand/place", at_places[0])
        scene.place("hand/force", pointed[0])


def _turned_to(direction: Floats) -> Rotation:
    """The rotation of the x axis into a direction (3,); identity for zero."""
    return Rotation.align_vectors(direction[None], np.eye(3)[:1])[0] if direction.any() else Rotation.identity()


def _draw_model(scene: DrawnScene, exploration: Exploration, size: float) -> None:
    """Draw the learned joints over the ranges that the hand covered."""
    model = exploration.model
    if model is None:
        return
    for index, mode in enumerate(model.modes):
        for number, (link, joint) in enumerate(zip(model.links, mode.joints, strict=True)):
            if joint.moves:
                limits = coordinate_range(model, mode, link.coordinate)[:2]
                draw_joint(scene, f"joints/{index}_{number}", joint, limits, JointLook(INK, size, thickness=0.5))


def _facts(exploration: Exploration) -> list[tuple[str, str]]:
    stiffness = 1.0 / exploration.hand.compliance
    limit = quantity(exploration.scene.largest_force, "N")
    return [
        (
            "Joints",
            f"{', then '.join(exploration.kinds) or 'none moved'} (probability {percent(exploration.probability, 0)})",
        ),
        ("Way of the handle", quantity(exploration.travel, "m")),
        ("Steps", str(exploration.steps)),
        ("Largest force", f"{quantity(exploration.largest_force, 'N')} of {limit}"),
        ("Stiffness of the hand", f"{stiffness:.0f} N/m ± {100 * exploration.hand.spread:.0f} %"),
    ]


def _legend(exploration: Exploration, spacing: float) -> list[LegendEntry]:
    entries = [
        LegendEntry(ORANGE, "the hand", "hand/place", "dot"),
        LegendEntry(PINK, "the force that it measures", "hand/force", "line"),
        LegendEntry(BLUE, "places of the handle, the first one green", "way", "line"),
        LegendEntry(MUTED, "from each place to where the hand pulled", "pulls", "line"),
        LegendEntry(VERMILLION, "directions in which the handle was believed to go", "fan", "line"),
    ]
    joints = [LegendEntry(INK, "joints that were found", "joints", "line")] if exploration.model is not None else []
    kinds = [LegendEntry(color, WORDS[name]) for name, color in KINDS.items()]
    grid = LegendEntry(GRID, f"grid of {quantity(spacing, 'm')}, frame of the hand's base", "ground", "line")
    return [*(entries if exploration.moments else []), *joints, *(kinds if exploration.moments else []), grid]


def _timeline(exploration: Exploration, times: Floats) -> Timeline:
    """The most probable mechanism at each step, with force and distance."""
    if len(times) < 2:
        return Timeline()
    likeliest = [max(KINDS, key=lambda name: moment.kinds.get(name, 0.0)) for moment in exploration.moments]
    changes = [0, *(k for k in range(1, len(likeliest)) if likeliest[k] != likeliest[k - 1])]
    ends = [*changes[1:], len(likeliest) - 1]
    bands = tuple(
        Band(float(times[first]), float(times[end]), KINDS[likeliest[first]], WORDS[likeliest[first]])
        for first, end in zip(changes, ends, strict=True)
    )
    readouts = tuple(
        (
            float(time),
            (
                f"step {number} of {exploration.steps}",
                f"{quantity(float(np.linalg.norm(moment.force)), 'N')}, way {quantity(moment.way, 'm')}",
                f"{WORDS[name]}: {percent(moment.kinds.get(name, 0.0), 0)}",
            ),
        )
        for number, (time, moment, name) in enumerate(zip(times, exploration.moments, likeliest, strict=True), start=1)
    )
    return Timeline(float(times[-1]), bands, readouts)


def exploration_charts(exploration: Exploration) -> tuple[Chart, ...]:
    """Charts: forces with their limit, probabilities of mechanisms, and the fan of hypotheses."""
    return _forces(exploration), _kinds(exploration), _fan(exploration)


def _blocks(exploration: Exploration) -> list[Block]:
    """The charts with captions; their cursors follow the player."""
    frames = tuple((float(time), float(number)) for number, time in enumerate(_times(exploration), start=1))
    fan = (
        "Each dot is one of the 40 most probable hypotheses of a direction in which the handle can go: its angle to "
        "the direction in which the handle went from there."
    )
    kinds = (
        f"What is believed to hold the handle, over {count(exploration.steps, 'step')}, in the colours of the legend; "
        "of several joints, of the last."
    )
    panels = (("Forces", ()), ("What it is", (kinds,)), ("The fan of hypotheses", (fan,)))
    return [
        Block(title, words, chart, keyframes=frames)
        for (title, words), chart in zip(panels, exploration_charts(exploration), strict=True)
    ]


def _over_steps(exploration: Exploration, described: str, label: str, high: float, marks: Sequence[Mark]) -> Chart:
    last = max(exploration.steps, 1) + 0.5
    panel = Panel(label, 0.0, high, _HEIGHT, tuple(marks))
    return Chart(f"{described} over steps", "step", 0.0, last, (panel,), whole=True)


def _fan(exploration: Exploration) -> Chart:
    """Angles between probable directions and the later motion of the handle."""
    places = np.array([moment.place for moment in exploration.moments])
    steps, angles = [np.zeros(0)], [np.zeros(0)]
    for number, moment in enumerate(exploration.moments):
        if len(moment.fan):
            steps.append(np.full(len(moment.fan), number + 1.0))
            angles.append(np.degrees(np.arccos(np.clip(moment.fan @ _onward(places, number), -1.0, 1.0))))
    dots = Curve(np.concatenate(steps), np.concatenate(angles), "small", VERMILLION)
    return _over_steps(exploration, "angles of hypotheses", "angle [°]", 180.0, [dots])


def _onward(places: Floats, number: int) -> Floats:
    """(3,) direction of motion after a step: to the first point 2 cm away, or the farthest."""
    away = places[number:] - places[number]
    sizes = np.linalg.norm(away, axis=1)
    if sizes.max() < 1e-3:  # the end: as it came
        away, sizes = (
            places[number] - places[: number + 1],
            np.linalg.norm(places[number] - places[: number + 1], axis=1),
        )
    far = int(np.argmax(sizes > 0.02)) if (sizes > 0.02).any() else int(np.argmax(sizes))
    return np.asarray(away[far] / max(float(sizes[far]), 1e-9))


def _forces(exploration: Exploration) -> Chart:
    forces = np.array([np.linalg.norm(moment.force) for moment in exploration.moments])
    limit, steps = exploration.scene.largest_force, np.arange(1.0, len(forces) + 1)
    high = 1.25 * max(limit, float(forces.max()))
    marks: list[Mark] = [
        Area(steps, np.zeros(len(forces)), forces, color=PINK),
        Curve(steps, forces, color=PINK),
        Level(limit),
        Words("limit", exploration.steps + 0.4, limit + 0.05 * high, side="left", strong=False),
    ]
    return _over_steps(exploration, "measured force", "force [N]", high, marks)


def _kinds(exploration: Exploration) -> Chart:
    steps, bottom, shares = np.arange(1.0, exploration.steps + 1), np.zeros(exploration.steps), list[Mark]()
    for name, color in KINDS.items():
        share = np.array([moment.kinds.get(name, 0.0) for moment in exploration.moments])
        shares.append(Area(steps, bottom, bottom + share, "level", color, WORDS[name]))
        bottom = bottom + share
    return _over_steps(exploration, "probabilities of kinds", "probability", 1.0, shares)
