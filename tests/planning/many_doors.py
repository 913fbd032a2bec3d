"""Cabinets of latched doors and drawers: as many dimensions and modes as a test wants."""

from __future__ import annotations

import itertools

from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Link, Mode, Noise, Part, Pin
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.region import Region, below, box, input_above
from micah_plan.task.goal import Goal
from micah_plan.task.problem import Problem
from micah_plan.task.settings import PlannerSettings
from micah_plan.task.start import Start

OPEN, TOLERANCE = 0.5, 0.05


def cabinet(doors: int, drawers: int) -> HybridAutomaton:
    """Doors that latch at 0 and drawers; a mode per subset of latched doors."""
    n = doors + drawers
    names = [f"door {i + 1}" for i in range(doors)] + [f"drawer {i + 1}" for i in range(drawers)]
    still = Joint("rigid", (0.0, 0.0, 0.0))
    modes, edges = [], []
    for latched in itertools.product((True, False), repeat=doors):
        free = [not shut for shut in latched] + [True] * drawers
        rows = tuple(tuple(float(i == j and free[i]) for j in range(n)) for i in range(n))
        pins = tuple(Pin(i, 0.0, 0.002) for i, shut in enumerate(latched) if shut)
        modes.append(Mode(_name(latched), (still,), rows, box([0.0] * n, [1.0] * n, n, names), Region(), pins))
        for i, shut in enumerate(latched):
            other = _name(tuple(not q if k == i else q for k, q in enumerate(latched)))
            pulled = input_above(i, 0.0, n, n, strict=True, name=f"input {names[i]}")
            guard = Region((pulled if shut else below(i, 0.0, n, n, name=names[i]),))
            edges.append(Edge(_name(latched), other, guard))
    coordinates = tuple(Coordinate(name, "m") for name in names)
    noise = Noise((0.002,) * n, (0.01,) * n)
    links = (Link("base", "body", 0),)
    return HybridAutomaton(coordinates, coordinates, links, (Part("body"),), tuple(modes), tuple(edges), noise)


def _name(latched: tuple[bool, ...]) -> str:
    return "".join("L" if shut else "o" for shut in latched) or "free"


def cabinet_problem(doors: int, drawers: int, opened: int, steps: int) -> Problem:
    """Open the first `opened` doors and drawers, in about so many steps."""
    automaton = cabinet(doors, drawers)
    n = automaton.n
    settings = PlannerSettings(max_step=(OPEN / steps / 0.6,) * n, max_knots=4 * steps + 40)
    start = Start((0.0 if doors else 0.05,) * n, (0.01,) * n, automaton.modes[0].name)
    return Problem(automaton, start, Goal(tuple((i, OPEN, TOLERANCE) for i in range(opened))), settings)
