"""The page of an exploration: where the hand went, how hypotheses thinned out, what force it took, how sure it was.

The figure of an exploration: what force it took, and how sure it became, step by step.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.explore.run import Exploration
from micah_plan.quantities import count, percent, quantity
from micah_plan.view.page import Chart, Status, Table, render
from micah_plan.view.palette import BLUE, GREEN, MUTED, ORANGE, PINK, VERMILLION
from micah_plan.view.svg import Panel, Svg, drawing, element, text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BADGES: dict[str, tuple[str, Status]] = {
    "opened": ("opened", "good"),
    "held": ("held", "fair"),
    "gave_up": ("gave up", "bad"),
}
KINDS = {"fast": MUTED, "unknown": GREEN, "prismatic": ORANGE, "revolute": BLUE}
WORDS = {"fast": "nothing moves it", "unknown": "not yet known", "prismatic": "a slide", "revolute": "a hinge"}
_WIDTH, _LEFT, _RIGHT, _TOP, _HEIGHT, _SIDE = 640.0, 66.0, 14.0, 24.0, 170.0, 280.0


def exploration_page(exploration: Exploration, title: str) -> str:
    """The page as HTML text: self-contained, fetches nothing, the same value gives the same bytes."""
    charts = (
        []
        if not exploration.moments
        else [_way(exploration), _fan(exploration), _forces(exploration), _kinds(exploration)]
    )
    page = {
        "title": title,
        "kind": "exploration: what holds the handle",
        "badge": _BADGES[exploration.outcome],
        "message": f"{exploration.reason[:1].upper()}{exploration.reason[1:]}.",
        "notes": exploration.notes,
        "numbers": _numbers(exploration),
        "charts": charts,
    }
    return render("exploration.html.j2", page=page)


def _numbers(exploration: Exploration) -> Table:
    joints = ", then ".join(exploration.kinds) or "none moved"
    stiffness = 1.0 / exploration.hand.compliance
    rows = (
        ("joints", f"{joints} ({percent(exploration.probability, 0)} sure)"),
        ("way of the handle", quantity(exploration.travel, "m")),
        ("steps", str(exploration.steps)),
        (
            "largest force",
            f"{quantity(exploration.largest_force, 'N')} of {quantity(exploration.scene.largest_force, 'N')}",
        ),
        ("stiffness of the hand", f"{stiffness:.0f} N/m ± {100 * exploration.hand.spread:.0f} %"),
    )
    return Table(("found", ""), rows)


def _panel(exploration: Exploration, low: float, high: float) -> Panel:
    return Panel(_LEFT, _TOP, _WIDTH - _LEFT - _RIGHT, _HEIGHT, 0.0, max(exploration.steps, 1) + 0.5, low, high)


def _way(exploration: Exploration) -> Chart:
    """The places in the plane in which they spread most, to one scale, with the pushes that moved nothing."""
    places = np.array([moment.place for moment in exploration.moments])
    tips = places + np.array([moment.lead for moment in exploration.moments])
    middle = places.mean(axis=0)
    plane = np.linalg.svd(np.concatenate([places, tips]) - middle)[2][:2]
    flat, ends = (places - middle) @ plane.T, (tips - middle) @ plane.T
    low, high = np.vstack([flat, ends]).min(axis=0), np.vstack([flat, ends]).max(axis=0)
    centre, wide = (low + high) / 2.0, _WIDTH - _LEFT - _RIGHT
    reach = 0.55 * max(float(np.max((high - low) / [wide / _SIDE, 1.0])), 0.02)
    across = reach * wide / _SIDE
    edges = (centre[0] - across, centre[0] + across, centre[1] - reach, centre[1] + reach)
    panel = Panel(_LEFT, _TOP, wide, _SIDE, *map(float, edges))
    pulls = [
        panel.curve(np.array([p[0], e[0]]), np.array([p[1], e[1]]), "line other")
        for p, e in zip(flat, ends, strict=True)
    ]
    parts = [
        panel.frame,
        *pulls,
        panel.curve(flat[:, 0], flat[:, 1], "line", BLUE),
        panel.curve(flat[:, 0], flat[:, 1], "dots", BLUE, dots=True),
        element("circle", kind="dots small", color=GREEN, cx=panel.x(flat[0, 0]), cy=panel.y(flat[0, 1]), r=8.0),
        panel.y_axis("[m]"),
        panel.x_axis("[m], in the plane of the motion", 6, whole=False),
    ]
    words = ("Blue: places of the handle, ringed the first one. Thin lines: from each place to where the hand pulled.",)
    return Chart("The path of the hand", words, drawing(_WIDTH, [panel], parts, "path of the hand"))


def _fan(exploration: Exploration) -> Chart:
    """Angles between the directions that are believed possible and the one in which the handle went."""
    places = np.array([moment.place for moment in exploration.moments])
    steps, angles = [], []
    for number, moment in enumerate(exploration.moments):
        onward = _onward(places, number)
        if len(moment.fan):
            steps.append(np.full(len(moment.fan), number + 1.0))
            angles.append(np.degrees(np.arccos(np.clip(moment.fan @ onward, -1.0, 1.0))))
    panel = _panel(exploration, 0.0, 180.0)
    parts = [panel.frame, panel.y_axis("angle [°]"), panel.x_axis("step")]
    if steps:
        parts.append(panel.curve(np.concatenate(steps), np.concatenate(angles), "dots small", VERMILLION, dots=True))
    words = (
        "Each dot is one of the 40 most probable hypotheses of a direction in which the handle can go: its angle to "
        "the direction in which the handle went from there.",
    )
    return Chart("The fan of hypotheses", words, drawing(_WIDTH, [panel], parts, "angles of hypotheses over steps"))


def _onward(places: Floats, number: int) -> Floats:
    """(3,) direction in which the handle went from a step on: to where it first was 2 cm away, or farthest."""
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
    panel = _panel(exploration, 0.0, 1.25 * max(limit, float(forces.max())))
    parts = [
        panel.frame,
        panel.area(steps, np.zeros(len(forces)), forces, "spread", PINK),
        panel.curve(steps, forces, "line", PINK),
        panel.level(limit, "guard"),
        text(panel.right - 4, panel.y(limit) - 5, "limit", "number end"),
        panel.y_axis("force [N]"),
        panel.x_axis("step"),
    ]
    return Chart("Forces", (), drawing(_WIDTH, [panel], parts, "measured force over steps, and its limit"))


def _kinds(exploration: Exploration) -> Chart:
    steps, bottom = np.arange(1.0, exploration.steps + 1), np.zeros(exploration.steps)
    panel = _panel(exploration, 0.0, 1.0)
    parts, names = [panel.frame], [Svg()]
    for number, (name, color) in enumerate(KINDS.items()):
        share = np.array([moment.kinds.get(name, 0.0) for moment in exploration.moments])
        parts.append(panel.area(steps, bottom, bottom + share, "level", color))
        bottom = bottom + share
        left = _LEFT + 140.0 * number
        names.append(element("rect", kind="level", color=color, x=left, y=4.0, width=12.0, height=12.0))
        names.append(text(left + 17, 14.0, WORDS[name], "number"))
    parts += [*names, panel.y_axis("probability"), panel.x_axis("step")]
    caption = (
        f"What is believed to hold the handle, over {count(exploration.steps, 'step')}; of several joints, of the last."
    )
    return Chart("What it is", (caption,), drawing(_WIDTH, [panel], parts, "probabilities of kinds over steps"))


def exploration_figure(exploration: Exploration) -> Figure:
    """Measured forces against their limit, and the probabilities of what holds the handle."""
    from micah_plan.view.figures import empty_figure  # pages need no Matplotlib

    figure = empty_figure((7.0, 4.6), layout="constrained")
    force, kinds = figure.subplots(2, 1, sharex=True)
    steps = np.arange(1, exploration.steps + 1)
    force.fill_between(steps, [np.linalg.norm(moment.force) for moment in exploration.moments], color=PINK, alpha=0.5)
    force.axhline(exploration.scene.largest_force, color=MUTED, ls="--", lw=1, label="limit")
    force.set_ylabel("force [N]")
    shares = [[moment.kinds.get(name, 0.0) for moment in exploration.moments] for name in KINDS]
    kinds.stackplot(steps, shares, colors=list(KINDS.values()), labels=[WORDS[name] for name in KINDS])
    kinds.set(ylabel="probability", xlabel="step", ylim=(0.0, 1.0))
    for axes in (force, kinds):
        axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside upper center", ncols=5, frameon=False, fontsize=9)
    return figure
