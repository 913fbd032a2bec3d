"""Random small hybrid problems, and their reachability on a grid by code of its own.

The unit box is cut into boxes, one per mode; neighbours are joined by guards at their common face, some modes have a
region that throws the state elsewhere, ends of the range clamp, latch (a pinned mode that an input leaves) or are open.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Link, Mode, Noise, Part, Pin, Reset
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.region import HalfSpace, Region, above, below, box, input_above, input_below
from micah_plan.task.goal import Goal
from micah_plan.task.problem import Problem
from micah_plan.task.settings import PlannerSettings
from micah_plan.task.start import Start

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]

NAMES = ("x", "y")
RIGID = Joint("rigid", (0.0, 0.0, 0.0))
# Distance from guards that are not wanted, from walls and from the goal's edge that makes a way a clear one.
MARGIN = 0.06
CELLS = 50
H = 1.0 / CELLS


@dataclass(frozen=True)
class Box:
    lower: tuple[float, ...]
    upper: tuple[float, ...]

    def cut(self, axis: int, at: float) -> tuple[Box, Box]:
        low, high = list(self.upper), list(self.lower)
        low[axis], high[axis] = at, at
        return Box(self.lower, tuple(low)), Box(tuple(high), self.upper)


def random_problem(seed: int, *, small_noise: bool | None = None) -> Problem:
    """The problem of a seed; noise is small for half of the seeds unless told."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 3))
    boxes = _boxes(rng, n, int(rng.integers(1, 5)))
    modes = [_mode(rng, n, number, one) for number, one in enumerate(boxes)]
    edges = [edge for pair in _pairs(boxes) if rng.random() < 0.85 for edge in _faces(rng, n, boxes, *pair)]
    if len(modes) < 4 and rng.random() < 0.3:
        latch, around = _latch(rng, n, boxes)
        modes.append(latch)
        edges += around
    if len(boxes) > 1 and rng.random() < 0.4:
        edges.append(_jump(rng, n, boxes))
    edges += _clamps(rng, n, boxes, edges)
    quiet = bool(rng.random() < 0.5) if small_noise is None else small_noise
    process, seen = (0.001, 0.003) if quiet else (float(rng.uniform(0, 0.02)), float(rng.uniform(0.001, 0.1)))
    automaton = HybridAutomaton(
        tuple(Coordinate(c, "m") for c in NAMES[:n]),
        tuple(Coordinate(c, "m") for c in NAMES[:n]),
        (Link("base", "point", 0),),
        (Part("point"),),
        tuple(modes),
        tuple(edges),
        Noise((process,) * n, (seen,) * n),
    )
    first = int(rng.integers(len(boxes)))
    start = _inside(rng, boxes[first], 0.02)
    last = int(rng.integers(len(boxes)))
    target = _inside(rng, boxes[last], 0.0)
    if rng.random() < 0.1:
        target = target + rng.uniform(-1, 1, n)
    chosen = [i for i in range(n) if rng.random() < 0.8] or [0]
    tolerance = float(rng.uniform(0.08, 0.12) if quiet else rng.uniform(0.02, 0.2))
    wanted = (modes[last].name,) if rng.random() < 0.4 else ()
    goal = Goal(tuple((i, float(target[i]), tolerance) for i in chosen), wanted)
    std = 0.004 if quiet else float(rng.uniform(0.0, 0.1))
    settings = PlannerSettings(
        samples_per_mode=60, max_step=(0.08,) * n, max_knots=150, verification_trials=200, time_limit_s=5.0
    )
    return Problem(automaton, Start(tuple(map(float, start)), (std,) * n, modes[first].name), goal, settings)


def with_less_noise(problem: Problem) -> Problem:
    """The same problem with noise that a clear way allows."""
    n = problem.automaton.n
    quiet = replace(problem.automaton, noise=Noise((0.001,) * n, (0.003,) * n))
    return replace(problem, automaton=quiet, start=replace(problem.start, std=(0.004,) * n))


def _boxes(rng: np.random.Generator, n: int, count: int) -> list[Box]:
    boxes = [Box((0.0,) * n, (1.0,) * n)]
    while len(boxes) < count:
        number = int(rng.integers(len(boxes)))
        axis = int(rng.integers(n))
        low, high = boxes[number].lower[axis], boxes[number].upper[axis]
        boxes[number : number + 1] = boxes[number].cut(axis, low + float(rng.uniform(0.35, 0.65)) * (high - low))
    return boxes


def _mode(rng: np.random.Generator, n: int, number: int, one: Box) -> Mode:
    gains = rng.choice([1.0, 1.0, 1.0, 1.0, 0.5, -1.0, 0.0], n)
    B = tuple(tuple(float(g) if i == j else 0.0 for j in range(n)) for i, g in enumerate(gains))
    return Mode(f"m{number}", (RIGID,), B, box(one.lower, one.upper, n, NAMES))


def _pairs(boxes: list[Box]) -> list[tuple[int, int, int]]:
    """(low, high, axis) of boxes that share a face of some size."""
    pairs = []
    for i, a in enumerate(boxes):
        for j, b in enumerate(boxes):
            for axis in range(len(a.lower)):
                others = [k for k in range(len(a.lower)) if k != axis]
                shared = all(min(a.upper[k], b.upper[k]) - max(a.lower[k], b.lower[k]) > 0.05 for k in others)
                if a.upper[axis] == b.lower[axis] and shared:
                    pairs.append((i, j, axis))
    return pairs


def _faces(rng: np.random.Generator, n: int, boxes: list[Box], low: int, high: int, axis: int) -> list[Edge]:
    """Guards both ways or one way through the part of the face that both have."""
    a, b, at = boxes[low], boxes[high], boxes[low].upper[axis]
    sides: list[HalfSpace] = []
    for k in (k for k in range(n) if k != axis):
        bottom, top = max(a.lower[k], b.lower[k]), min(a.upper[k], b.upper[k])
        sides += [above(k, bottom, n, n, name=NAMES[k]), below(k, top, n, n, name=NAMES[k])]
    up = Edge(f"m{low}", f"m{high}", Region((above(axis, at, n, n, name=NAMES[axis]), *sides)))
    down = Edge(f"m{high}", f"m{low}", Region((below(axis, at, n, n, strict=True, name=NAMES[axis]), *sides)))
    return [[up, down], [up, down], [up], [down]][int(rng.integers(4))]


def _latch(rng: np.random.Generator, n: int, boxes: list[Box]) -> tuple[Mode, list[Edge]]:
    """A mode that holds coordinate 0 at the upper end of a box until it is pulled back."""
    number = max(range(len(boxes)), key=lambda k: boxes[k].upper[0])
    at, gain = boxes[number].upper[0], 0.0
    B = tuple(tuple(gain if i == 0 or i != j else 1.0 for j in range(n)) for i in range(n))
    invariant = box((at - 1e-9, *boxes[number].lower[1:]), (at + 1e-9, *boxes[number].upper[1:]), n, NAMES)
    latch = Mode("latch", (RIGID,), B, invariant, Region(), (Pin(0, at, 0.002),))
    into = Edge(f"m{number}", "latch", Region((above(0, at, n, n, name="x"),)))
    sign = input_below(0, 0.0, n, n, strict=True) if rng.random() < 0.5 else input_above(0, 0.0, n, n, strict=True)
    return latch, [into, Edge("latch", f"m{number}", Region((sign,)))]


def _jump(rng: np.random.Generator, n: int, boxes: list[Box]) -> Edge:
    """A region inside of one mode from which the state is thrown to a point of a mode."""
    source, target = (int(rng.integers(len(boxes))) for _ in range(2))
    if source == target:
        target = (target + 1) % len(boxes)
    one = boxes[source]
    size = np.subtract(one.upper, one.lower)
    lower = np.array(one.lower) + rng.uniform(0.2, 0.5, n) * size
    guard = box(lower, lower + rng.uniform(0.15, 0.3, n) * size, n, NAMES)
    point = _inside(rng, boxes[target], 0.07)
    reset = Reset(A=((0.0,) * n,) * n, c=tuple(map(float, point)))
    return Edge(f"m{source}", f"m{target}", guard, reset)


def _clamps(rng: np.random.Generator, n: int, boxes: list[Box], edges: list[Edge]) -> list[Edge]:
    clamps = []
    for number, one in enumerate(boxes):
        for axis in range(n):
            for end, at, half_space in ((0.0, one.lower[axis], below), (1.0, one.upper[axis], above)):
                latched = any(e.target == "latch" and e.source == f"m{number}" for e in edges) and axis == 0 and end
                if at == end and not latched and rng.random() < 0.5:
                    A = tuple(tuple(float(i == j and i != axis) for j in range(n)) for i in range(n))
                    c = tuple(at if i == axis else 0.0 for i in range(n))
                    guard = Region((half_space(axis, at, n, n, name=NAMES[axis]),))
                    clamps.append(Edge(f"m{number}", f"m{number}", guard, Reset(A=A, c=c)))
    return clamps


def _inside(rng: np.random.Generator, one: Box, room: float) -> Floats:
    lower, upper = np.array(one.lower) + room, np.array(one.upper) - room
    return np.asarray(lower + rng.random(len(lower)) * (upper - lower))


class Grid:
    """The modes' states on a grid: points of the modes that can be, those that guards take away, connected parts.

    Args:
        room: distance that boundaries and unwanted guards are kept at; negative: that they may be overrun by.
    """

    def __init__(self, problem: Problem, room: float) -> None:
        self.problem, self.room = problem, room
        automaton = problem.automaton
        axes = [np.linspace(0.0, 1.0, CELLS + 1)] * automaton.n
        self.points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        self.free: dict[str, Booleans] = {}
        self.parts: dict[str, NDArray[np.int64]] = {}
        for mode in automaton.modes:
            pins = {pin.coordinate: pin.value for pin in mode.pins}
            kept = self._margin(mode.invariant, set(pins)) >= self._wall_room(mode) - 1e-9
            for i, value in pins.items():
                kept &= np.abs(self.points[..., i] - value) <= 0.5 * H
            for edge in automaton.edges_from(mode.name):
                if not edge.is_self_transition and not self._by_input(edge):
                    kept &= self._margin(edge.guard, set()) < -self.room + 1e-9
            moved = np.abs(mode.B).sum(axis=1) > 0
            structure = np.zeros((3,) * automaton.n, dtype=bool)
            structure[(1,) * automaton.n] = True
            for i in np.flatnonzero(moved):
                for k in (0, 2):
                    structure[tuple(k if j == i else 1 for j in range(automaton.n))] = True
            self.free[mode.name] = kept
            self.parts[mode.name] = ndimage.label(kept, structure)[0]

    def _wall_room(self, mode: Mode) -> float:
        return min(self.room, 0.0) if mode.pins else self.room

    def _by_input(self, edge: Edge) -> bool:
        return any(any(h.b) for h in edge.guard.half_spaces)

    def _margin(self, region: Region, without: set[int]) -> Floats:
        rows = [h for h in region.half_spaces if not any(h.b) and not any(h.a[i] for i in without)]
        if not rows:
            return np.full(self.points.shape[:-1], np.inf)
        return np.min([self.points @ np.array(h.a) - h.c for h in rows], axis=0)

    def part_at(self, mode: str, x: Floats, reach: float | Floats) -> set[int]:
        """The connected parts of a mode with a point within a distance of x per coordinate."""
        near = np.all(np.abs(self.points - x) <= reach + 1e-9, axis=-1) & self.free[mode]
        return set(np.unique(self.parts[mode][near]).tolist())

    def goal_parts(self) -> set[tuple[str, int]]:
        goal = self.problem.goal
        found: set[tuple[str, int]] = set()
        for mode in self.problem.automaton.modes:
            if goal.modes and mode.name not in goal.modes:
                continue
            inside = self.free[mode.name].copy()
            for index, value, tolerance in goal.target:
                inside &= np.abs(self.points[..., index] - value) <= tolerance - max(self.room, 0.0) * 0.8 + H / 2
            found |= {(mode.name, int(part)) for part in np.unique(self.parts[mode.name][inside])}
        return found

    def transitions(self, mode: str, part: int) -> set[tuple[str, int]]:
        """(mode, part) that one transition leads to."""
        automaton, found = self.problem.automaton, set()
        own = self.parts[mode] == part
        source = automaton.mode(mode)
        for edge in automaton.edges_from(mode):
            if edge.is_self_transition:
                continue
            for inside in self._guard_entries(edge, own, source):
                after = edge.reset.apply(inside, np.zeros(automaton.m))
                for pin in automaton.mode(edge.target).pins:
                    after[..., pin.coordinate] = pin.value
                for x in np.unique(np.round(after, 9), axis=0):
                    found |= {(edge.target, k) for k in self._arrivals(edge, x)}
        return found

    def _guard_entries(self, edge: Edge, own: Booleans, source: Mode) -> list[Floats]:
        """Where points of a part next to the guard meet it, moving along one axis that the mode moves."""
        points = self.points[own]
        if self._by_input(edge):
            return [points]
        entries = []
        if self.room <= 0:  # whatever is next to the guard or inside of it
            touching = self._margin(edge.guard, set())[own] >= self.room - 1.5 * H
            entries.append(points[touching])
        rows = edge.guard.half_spaces
        reach = (self.room + 1.5 * H) if self.room > 0 else 1.5 * H - self.room
        for i in range(self.problem.automaton.n):
            if not np.any(source.B[i]):
                continue
            for sign in (-1.0, 1.0):
                facing = [h for h in rows if h.a[i] * sign > 0]
                # Where the moved state would enter: the last of the facing sides.
                enter = np.full(len(points), -np.inf)
                for h in facing:
                    enter = np.maximum(enter, sign * h.c / h.a[i])
                if not facing:
                    continue
                distance = enter - sign * points[:, i]
                met = points.copy()
                met[:, i] = enter * sign
                sides = [h for h in rows if not h.a[i]]
                ok = (distance <= reach) & (distance >= -reach)
                for h in sides:
                    ok &= met @ np.array(h.a) - h.c >= self.room - 1e-9
                if ok.any():
                    entries.append(met[ok])
        return entries

    def _arrivals(self, edge: Edge, x: Floats) -> set[int]:
        """The parts of the target in which a state that arrives at x is, or which it enters from the face."""
        if self.room <= 0:
            # Coordinates that neither mode moves stay: else they would drift from cell to cell, to and fro.
            modes = self.problem.automaton.mode(edge.source), self.problem.automaton.mode(edge.target)
            moved = np.any([mode.B.any(axis=1) for mode in modes], axis=0)
            return self.part_at(edge.target, x, np.where(moved, 1.5 * H - self.room, 0.5 * H))
        return self._straight_arrivals(edge, x)

    def _straight_arrivals(self, edge: Edge, x: Floats) -> set[int]:
        target = self.problem.automaton.mode(edge.target)
        found = set(self.part_at(edge.target, x, 0.5 * H))
        for i in range(len(x)):
            if not np.any(target.B[i]):
                continue
            away = np.abs(self.points - x)
            near = away[..., i] <= self.room + 1.5 * H
            for j in range(len(x)):
                if j != i:
                    near &= away[..., j] <= 0.5 * H + 1e-9
            near &= self.free[edge.target]
            found |= set(np.unique(self.parts[edge.target][near]).tolist())
        return found

    def reaches_goal(self, *, revisits: bool) -> bool:
        """Whether a chain of parts leads from the start to the goal, modes not repeated unless told."""
        goals = self.goal_parts()
        name = self.problem.start.mode or ""
        moved = self.problem.automaton.mode(name).B.any(axis=1)
        reach = np.where(moved & (self.room <= 0), 1.5 * H - self.room, 0.5 * H)
        stack = [((name,), part) for part in self.part_at(name, np.array(self.problem.start.mean), reach)]
        seen = set(stack)
        while stack:
            modes, part = stack.pop()
            if (modes[-1], part) in goals:
                return True
            for target, entered in self.transitions(modes[-1], part):
                path = (target,) if revisits else (*modes, target)
                if (revisits or target not in modes) and (path, entered) not in seen:
                    seen.add((path, entered))
                    stack.append((path, entered))
        return False


def is_clearly_reachable(problem: Problem) -> bool:
    """Whether a way keeps `MARGIN` from everything unwanted, no mode twice."""
    return Grid(problem, MARGIN).reaches_goal(revisits=False)


def is_clearly_unreachable(problem: Problem) -> bool:
    """Whether no way exists even with boundaries and guards overrun by a cell."""
    return not Grid(problem, -1.5 * H).reaches_goal(revisits=True)
