"""Hand-made objects, plans and recordings for the tests of pages and figures."""

from __future__ import annotations

import numpy as np

from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.hybrid import (
    Coordinate,
    Edge,
    HybridAutomaton,
    Link,
    Mode,
    Noise,
    Part,
    Pin,
    Primitive,
    Reset,
)
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.kinematics import forward
from micah_plan.automaton.region import Region, above, below
from micah_plan.recording.value import Recording
from micah_plan.task.goal import Goal
from micah_plan.task.plan import Candidate, Plan, Trajectory
from micah_plan.task.problem import Problem
from micah_plan.task.settings import PlannerSettings
from micah_plan.task.start import Start
from micah_plan.view.chart import Chart, Words
from micah_plan.view.page import Block

HINGE = Joint("revolute", position=(0.3, 0.0, 0.1), axis=(0.0, 0.0, -1.0), center=(0.0, 0.0, 0.1))
OPEN_AT = 1.2


def door(name="door", *, shapes=True, handle=(0.0, -0.03, 0.0)) -> HybridAutomaton:
    """A door of 0.3 m about z: revolute up to 1.2 rad, then rigid."""
    held = Joint(
        "rigid",
        position=tuple(forward(HINGE, OPEN_AT).translation[0]),
        quaternion=tuple(forward(HINGE, OPEN_AT).rotation.as_quat()[0]),
        fixed_at=OPEN_AT,
    )
    swing = Mode("swinging", (HINGE,), ((1.0,),), Region((above(0, 0.0, 1, 1), below(0, OPEN_AT, 1, 1))))
    stop = Mode("stopped", (held,), ((0.0,),), Region((above(0, OPEN_AT, 1, 1),)), pins=(Pin(0, OPEN_AT, 0.005),))
    edges = (
        Edge("swinging", "stopped", Region((above(0, OPEN_AT, 1, 1, name=name),))),
        Edge("stopped", "swinging", Region((below(0, OPEN_AT, 1, 1, strict=True, name=name),))),
        Edge("swinging", "swinging", Region((below(0, 0.0, 1, 1, name=name),)), Reset(A=((0.0,),))),
    )
    panel = Primitive("box", (0.3, 0.015, 0.25), (-0.15, 0.0, 0.0), color="#d9c7a3")
    knob = Primitive("sphere", (0.015,), (0.0, -0.03, 0.0), color="#7b8794")
    body = Primitive("box", (0.34, 0.25, 0.29), (0.15, 0.14, 0.1), color="#b8c4ce")
    parts = (Part(BASE, (body,) if shapes else ()), Part(name, (panel, knob) if shapes else (), handle))
    return HybridAutomaton(
        (Coordinate(name, "rad"),),
        (Coordinate(name, "rad"),),
        (Link(BASE, name, 0),),
        parts,
        (swing, stop),
        edges,
        Noise((0.005,), (0.03,)),
        provenance={"method": "by hand"},
    )


def problem(automaton=None, **settings) -> Problem:
    return Problem(
        automaton or door(),
        Start((0.1,), (0.08,)),
        Goal(((0, OPEN_AT, 0.02),), ("stopped",)),
        PlannerSettings(**settings),
    )


def trajectory(steps=20) -> Trajectory:
    means = np.concatenate([np.linspace(0.1, OPEN_AT + 0.03, steps), [OPEN_AT, OPEN_AT]])
    stds = np.concatenate([np.linspace(0.08, 0.025, steps), [0.005, 0.005]])
    jump = np.zeros(steps + 1, dtype=bool)
    jump[steps - 1] = True
    return Trajectory(
        ("swinging",) * steps + ("stopped",) * 2,
        means[:, None],
        stds[:, None, None],
        np.diff(means)[:, None] * ~jump[:, None],
        np.full((steps + 1, 1, 1), -0.5),
        jump,
    )


def solved(**changes) -> Plan:
    values = {
        "outcome": "solved",
        "reason": "all constraints hold with 95 % confidence",
        "trajectory": trajectory(),
        "candidates": (
            Candidate(("swinging", "stopped"), 1.1, 2.25, "optimal"),
            Candidate(("swinging",), 1.0, None, "goal mode not reached"),
        ),
        "cost": 2.25,
        "goal_error": 0.0,
        "goal_std": 0.005,
        "success_probability": 0.985,
        "verification_trials": 200,
        "seed": 7,
    }
    return Plan(**(values | changes))


def measured(rows=60, seed=0, noise=0.002) -> tuple[Recording, KinematicGraph]:
    """A noisy door that swings to 1.2 rad and rests there, and its segments."""
    rng = np.random.default_rng(seed)
    moving = rows * 2 // 3
    c = np.concatenate([np.linspace(0.0, OPEN_AT, moving), np.full(rows - moving, OPEN_AT)])
    poses = forward(HINGE, c)
    recording = Recording(
        np.arange(rows) / 18, poses.translation + rng.normal(0, noise, (rows, 3)), poses.rotation.as_quat()
    )
    held = door().modes[1].joints[0]
    swing = Segment(HINGE, 0, 0, moving - 1, 0.0, OPEN_AT, (0.0, OPEN_AT), 0.004, 0.01, 100.0, 0.99)
    rest = Segment(held, 0, moving, rows - 1, OPEN_AT, OPEN_AT, (OPEN_AT, OPEN_AT), 0.0, 0.01, 50.0, 0.98)
    return recording, KinematicGraph((KinematicEdge(BASE, "part", (swing, rest)),))


def marks(chart: Chart, kind: type, panel: int | None = None) -> list:
    """The marks of a kind in a panel of a chart, or in all of them."""
    panels = chart.panels if panel is None else chart.panels[panel : panel + 1]
    return [mark for panel in panels for mark in panel.marks if isinstance(mark, kind)]


def words_of(block: Block) -> str:
    """All texts of a block: around its chart, in it, and beside its bars."""
    bars = [f"{bars.title} {bar.label} {bar.words}" for bars in block.bars for bar in bars.rows]
    chart = block.chart
    inside = [] if chart is None else [chart.described, chart.x_label, *(panel.label for panel in chart.panels)]
    inside += [] if chart is None else [words.text for words in marks(chart, Words)]
    return " ".join([block.title, *block.words, *inside, *bars, *block.notes])


def cabinet() -> HybridAutomaton:
    """A drawer inside a door: a chain of a hinge and a slide whose range only its clamps state."""
    slide = Joint("prismatic", position=(0.05, -0.1, 0.0), axis=(0.0, -1.0, 0.0))
    mode = Mode("free", (HINGE, slide), ((1.0, 0.0), (0.0, 1.0)), Region((above(0, 0.0, 2, 2), below(0, 1.5, 2, 2))))
    keep = Reset(A=((1.0, 0.0), (0.0, 0.0)), c=(0.0, 0.25))
    edges = (
        Edge("free", "free", Region((above(1, 0.25, 2, 2),)), keep),
        Edge("free", "free", Region((below(1, 0.0, 2, 2),)), Reset(A=((1.0, 0.0), (0.0, 0.0)))),
    )
    names = (Coordinate("door", "rad"), Coordinate("drawer", "m"))
    links = (Link(BASE, "door", 0), Link("door", "drawer", 1))
    return HybridAutomaton(names, names, links, (), (mode,), edges, Noise((0.01, 0.002), (0.03, 0.005)))
