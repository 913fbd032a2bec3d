"""Small hand-made problems that the planning tests share."""

from __future__ import annotations

from dataclasses import replace

from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Link, Mode, Noise, Part, Pin, Reset
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.region import Region, above, below, box, input_above, input_below, input_box
from micah_plan.task.goal import Goal
from micah_plan.task.problem import Problem
from micah_plan.task.settings import PlannerSettings
from micah_plan.task.start import Start

RIGID = Joint("rigid", (0.0, 0.0, 0.0))
DOOR_SHUT = 1.2


def door_automaton(release: float = 0.0, pin_std: float = 0.005) -> HybridAutomaton:
    """A door: revolute on [0, 1.2] rad, then held shut at 1.2 until it is pulled back."""
    swing = Joint("revolute", (0.3, 0.0, 0.0), axis=(0.0, 0.0, 1.0))
    inputs = input_box([-0.06], [0.06], 1, ["door"])
    revolute = Mode("swings", (swing,), ((1.0,),), box([0.0], [DOOR_SHUT], 1, ["door"]), inputs)
    shut = Mode(
        "shut",
        (RIGID,),
        ((0.0,),),
        Region((above(0, DOOR_SHUT, 1, 1, name="door"),)),
        inputs,
        (Pin(0, DOOR_SHUT, pin_std),),
    )
    edges = (
        Edge("swings", "shut", Region((above(0, DOOR_SHUT, 1, 1, name="door"),))),
        Edge("shut", "swings", Region((input_below(0, -release, 1, 1, strict=True, name="input door"),))),
        clamp_below("swings", 0.0, "door"),
    )
    return HybridAutomaton(
        (Coordinate("door", "rad"),),
        (Coordinate("door", "rad"),),
        (Link("base", "door", 0),),
        (Part("door"),),
        (revolute, shut),
        edges,
        Noise((0.002,), (0.01,)),
    )


def clamp_below(mode: str, end: float, name: str) -> Edge:
    """The self transition that keeps coordinate 0 of a one-dimensional automaton at the low end of its range."""
    return Edge(mode, mode, Region((below(0, end, 1, 1, name=name),)), Reset(A=((0.0,),), c=(end,)))


def door_problem(
    start: float,
    goal: float,
    *,
    start_std: float = 0.02,
    mode: str | None = None,
    tolerance: float = 0.05,
    settings: PlannerSettings | None = None,
    automaton: HybridAutomaton | None = None,
    goal_modes: tuple[str, ...] = (),
) -> Problem:
    return Problem(
        automaton or door_automaton(),
        Start((start,), (start_std,), mode),
        Goal(((0, goal, tolerance),), goal_modes),
        settings or PlannerSettings(samples_per_mode=40),
    )


def drawer_problem(start: float, goal: float) -> Problem:
    """A drawer: prismatic on [0, 0.35] m with clamps at both ends."""
    slide = Joint("prismatic", (0.5, 0.0, 0.2), axis=(1.0, 0.0, 0.0))
    mode = Mode("slides", (slide,), ((1.0,),), box([0.0], [0.35], 1, ["drawer"]))
    top = Edge("slides", "slides", Region((above(0, 0.35, 1, 1, name="drawer"),)), Reset(A=((0.0,),), c=(0.35,)))
    automaton = HybridAutomaton(
        (Coordinate("drawer", "m"),),
        (Coordinate("drawer", "m"),),
        (Link("base", "drawer", 0),),
        (Part("drawer"),),
        (mode,),
        (clamp_below("slides", 0.0, "drawer"), top),
        Noise((0.0005,), (0.003,)),
    )
    return Problem(automaton, Start((start,), (0.005,)), Goal(((0, goal, 0.01),)), PlannerSettings(samples_per_mode=40))


def planar_problem(*, trap: bool = True, candidates: int = 3) -> Problem:
    """A point in the plane: room "left" (x <= 0) leads to "right" only through y >= 0.8.

    With `trap`, touching the block [-0.6, -0.4] x [-0.5, 0.5] between start and gate leads to mode "lost" for ever.
    """
    n, m = 2, 2
    names = ["x", "y"]
    eye = ((1.0, 0.0), (0.0, 1.0))
    left = Mode("left", (RIGID,), eye, box([-1.0, -1.0], [0.0, 1.0], m, names))
    right = Mode("right", (RIGID,), eye, box([0.0, -1.0], [1.0, 1.0], m, names))
    lost = Mode("lost", (RIGID,), ((0.0, 0.0), (0.0, 0.0)), Region())
    gate = Region((above(0, 0.0, n, m, name="x"), above(1, 0.8, n, m, name="y")))
    back = Region((below(0, 0.0, n, m, strict=True, name="x"), above(1, 0.8, n, m, name="y")))
    block = box([-0.6, -0.5], [-0.4, 0.5], m, names)
    edges = (Edge("left", "right", gate), Edge("right", "left", back))
    if trap:
        edges = (*edges, Edge("left", "lost", block))
    automaton = HybridAutomaton(
        tuple(Coordinate(c, "m") for c in names),
        tuple(Coordinate(c, "m") for c in names),
        (Link("base", "point", 0),),
        (Part("point"),),
        (left, right, lost),
        edges,
        Noise((0.002,) * 2, (0.01,) * 2),
    )
    settings = PlannerSettings(max_step=(0.12, 0.12), samples_per_mode=120, candidates=candidates)
    goal = Goal(((0, 0.8, 0.05), (1, -0.8, 0.05)))
    return Problem(automaton, Start((-0.9, 0.0), (0.02, 0.02)), goal, settings)


def with_settings(problem: Problem, **changes: object) -> Problem:
    """The same problem with some planner settings changed."""
    return replace(problem, settings=replace(problem.settings, **changes))  # type: ignore[arg-type]


def one_dimensional(low: float, threshold: float, high: float) -> HybridAutomaton:
    """Two moving modes that meet at a threshold, guards both ways."""
    first = Mode("first", (RIGID,), ((1.0,),), box([low], [threshold], 1, ["c"]))
    second = Mode("second", (RIGID,), ((1.0,),), box([threshold], [high], 1, ["c"]))
    edges = (
        Edge("first", "second", Region((above(0, threshold, 1, 1, name="c"),))),
        Edge("second", "first", Region((below(0, threshold, 1, 1, strict=True, name="c"),))),
        clamp_below("first", low, "c"),
        Edge("second", "second", Region((above(0, high, 1, 1, name="c"),)), Reset(A=((0.0,),), c=(high,))),
    )
    return HybridAutomaton(
        (Coordinate("c", "m"),),
        (Coordinate("c", "m"),),
        (Link("base", "c", 0),),
        (Part("c"),),
        (first, second),
        edges,
        Noise((0.001,), (0.01,)),
    )


__all__ = [
    "DOOR_SHUT",
    "door_automaton",
    "door_problem",
    "drawer_problem",
    "input_above",
    "one_dimensional",
    "planar_problem",
    "with_settings",
]
