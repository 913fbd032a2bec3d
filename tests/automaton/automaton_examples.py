"""Small hybrid automata for the tests of the transition logic, and a naive simulation to compare with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Mode, Noise
from micah_plan.automaton.joint import Joint, prismatic, revolute, rigid
from micah_plan.automaton.region import HalfSpace, Region

SHUT = 1.2
SPLIT = 0.2
END = 0.4


def segment(joint: Joint, rows: tuple[int, int], start: float, end: float, **changes: float) -> Segment:
    """A segment of a straight sweep from one configuration to another."""
    values = {"process_std": 0.002, "observation_std": 0.01, "log_evidence": 0.0, "probability": 1.0} | changes
    return Segment(joint, 0, *rows, start, end, (min(start, end), max(start, end)), **values)


def chain(child: str, bounds: Sequence[float], kinds: Sequence[str]) -> KinematicEdge:
    """An edge whose segments of the given kinds meet at `bounds`; a rigid one has equal bounds before and after."""
    segments = []
    for k, (kind, start, end) in enumerate(zip(kinds, bounds[:-1], bounds[1:], strict=True)):
        joint = {
            "rigid": rigid([start, 0, 0], fixed_at=start),
            "prismatic": prismatic([1, 0, 0], [0, 0, 0]),
            "revolute": revolute([0, 0, 1], [0, 0, 0], [1, 0, 0]),
        }[kind]
        segments.append(segment(joint, (20 * k, 20 * k + 19), start, end))
    return KinematicEdge(BASE, child, tuple(segments))


def door(release: float = 0.0) -> HybridAutomaton:
    """A microwave's door: revolute from 0 to SHUT, then rigid."""
    return build_automaton(KinematicGraph((chain("door", [0, SHUT, SHUT], ["revolute", "rigid"]),)), release=release)


def two_rails() -> HybridAutomaton:
    """A drawer on two rails: prismatic_1 from 0 to SPLIT, prismatic_2 from SPLIT to END."""
    return build_automaton(KinematicGraph((chain("drawer", [0, SPLIT, END], ["prismatic", "prismatic"]),)))


def detent(release: float = 0.0) -> HybridAutomaton:
    """A drawer with a detent at SPLIT: prismatic_1, rigid, prismatic_2."""
    edge = chain("drawer", [0, SPLIT, SPLIT, END], ["prismatic", "rigid", "prismatic"])
    return build_automaton(KinematicGraph((edge,)), release=release)


def cabinet() -> HybridAutomaton:
    """A door and a drawer: the product of `door` and `two_rails`."""
    edges = (
        chain("door", [0, SHUT, SHUT], ["revolute", "rigid"]),
        chain("drawer", [0, SPLIT, END], ["prismatic", "prismatic"]),
    )
    return build_automaton(KinematicGraph(edges))


def plain(flows: dict[str, list[list[float]]], edges: Sequence[Edge]) -> HybridAutomaton:
    """An automaton with the given input matrices by mode and no links, for rules that no object's model needs."""
    n, m = np.shape(next(iter(flows.values())))
    return HybridAutomaton(
        coordinates=tuple(Coordinate(f"x{i}", "m") for i in range(n)),
        inputs=tuple(Coordinate(f"u{j}", "m") for j in range(m)),
        links=(),
        parts=(),
        modes=tuple(Mode(name, (), tuple(map(tuple, matrix))) for name, matrix in flows.items()),
        edges=tuple(edges),
        noise=Noise((0.01,) * n, (0.01,) * n),
    )


def guard(
    *rows: tuple[Sequence[float], Sequence[float], float] | tuple[Sequence[float], Sequence[float], float, bool],
) -> Region:
    """The intersection of half-spaces (a, b, c[, strict])."""
    return Region(tuple(HalfSpace(tuple(map(float, row[0])), tuple(map(float, row[1])), *row[2:]) for row in rows))


def naive(
    automaton: HybridAutomaton, mode: str, x: np.ndarray, u: np.ndarray, disturbance: np.ndarray, cuts: int
) -> tuple[str, np.ndarray]:
    """The step as the paper takes it, but on a fine grid: move a little, see whether a guard holds, take that edge."""
    x = np.array(x, dtype=float)
    for _ in range(cuts):
        now = automaton.mode(mode)
        free = np.array([all(pin.coordinate != i for pin in now.pins) for i in range(automaton.n)])
        x = x + free * (now.B @ u + disturbance) / cuts
        ready = [edge for edge in automaton.edges_from(mode) if edge.guard.contains(x, u)]
        for edge in [e for e in ready if not e.is_self_transition][:1] or ready:
            x, mode = edge.reset.apply(x, u), edge.target
        for pin in automaton.mode(mode).pins:
            x[pin.coordinate] = pin.value
    return mode, x
