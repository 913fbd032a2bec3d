"""The hybrid automaton of an articulated object from its extended kinematic graph.

Source: MICAH, section IV-B, "Hybrid Automaton Construction". Followed as there: Q is the Cartesian product of the
edges' local models, X and U have one coordinate per edge, transitions change one edge's model at a time to a
neighbouring one, guards come from the configurational changepoints, the ends of the range are clamped self
transitions, resets are the identity. Differences from the paper, with reasons, are listed in "From the graph to the
automaton" of docs/concepts/automaton.md: absolute coordinates, pins of rigid models, closed invariants, thresholds with
a std, strict guards of clamps, six digits (`digits`).

An edge to the base that never moved keeps its coordinate; the only model pins it. A part that is fixed to another part
adds no local model: its link follows the coordinate of its parent. `Init` is left to the task.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from micah_plan.automaton.certainty import LearnedEdge, LearnedSegment, NoSingleJoint, RowPosterior, SegmentCertainty
from micah_plan.automaton.check import check_automaton
from micah_plan.automaton.digits import DIGITS, rounded
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Link, Mode, Noise, Part, Pin, Reset
from micah_plan.automaton.joint import KINDS, Joint
from micah_plan.automaton.local_models import RESOLUTION, LocalModel, local_models
from micah_plan.automaton.region import HalfSpace, Region, above, below, box, input_above, input_below, input_box
from micah_plan.errors import InputError
from micah_plan.quantities import quantity

SMALLEST_STD = 1e-6
_MISFIT_REMEDY = (
    "check that the part is stiff, moves in one way at a time and is tracked relative to what it is mounted on, or "
    "leave these rows out"
)


def build_automaton(
    graph: KinematicGraph,
    *,
    parts: Sequence[Part] = (),
    noise: Noise | None = None,
    release: float = 0.0,
    input_limits: Sequence[float] | None = None,
    provenance: Mapping[str, str] | None = None,
) -> HybridAutomaton:
    """H = (Q, X, U, Init, f, I, E, G, R, φ) of a kinematic graph, as the module's docstring defines it.

    Args:
        parts: bodies with their shapes and handles; parts of the graph that are not among them get no shapes.
        noise: process and observation noise; None: root mean square over the segments of each edge, by rows.
        release: displacement per step that an input must exceed to pull a part out of a rigid model [rad or m].
        input_limits: largest displacement per step [rad or m], one per edge that is not fixed to another part; None:
            any input is admissible.
        provenance: origin of the model.

    Modes are named after their local models, joined by ``/`` in the order of the graph's edges (``"rigid/prismatic"``),
    without those of fixed parts.

    Raises:
        InputError: no edges, edges not in the order parents first, rows that no single joint explains, segments that do
            not follow one another along one coordinate, or bad arguments.
    """
    if not graph.edges:
        raise InputError("kinematic graph must have at least one edge. Got none")
    refusal = no_single_joint_error(graph)
    if refusal is not None:
        raise refusal
    if not release >= 0:
        raise InputError(f"release must be >= 0. Got {release}")
    moving = [edge for edge in graph.edges if not _is_fixed(edge)]
    links = _links(graph, moving)
    chains = [local_models(edge) for edge in moving]
    fixed = [local_models(edge)[0].joint if _is_fixed(edge) else None for edge in graph.edges]
    joined = list(zip(links, fixed, strict=True))
    n = len(chains)
    if input_limits is not None and (len(input_limits) != n or not all(limit > 0 for limit in input_limits)):
        raise InputError(f"input_limits must be {n} positive numbers. Got {list(input_limits)}")
    names = [edge.child for edge in moving]
    coordinates = tuple(Coordinate(name, _unit(chain)) for name, chain in zip(names, chains, strict=True))
    admissible = Region() if input_limits is None else input_box([-v for v in input_limits], input_limits, n, names)
    product = list(itertools.product(*(range(len(chain)) for chain in chains)))
    automaton = HybridAutomaton(
        coordinates=coordinates,
        inputs=coordinates,
        links=links,
        parts=_parts(graph, parts),
        modes=tuple(_mode(chains, choice, names, admissible, joined) for choice in product),
        edges=tuple(edge for choice in product for edge in _edges(chains, choice, names, release)),
        noise=noise or _noise_of(moving),
        provenance=dict(provenance or {}),
        learned=tuple(_learned_edges(graph)),
    )
    automaton = rounded(automaton)
    check_automaton(automaton)
    return automaton


def _is_fixed(edge: KinematicEdge) -> bool:
    """Whether a part never moves relative to another part that may."""
    return edge.parent != BASE and not any(segment.joint.moves for segment in edge.segments)


def _links(graph: KinematicGraph, moving: Sequence[KinematicEdge]) -> tuple[Link, ...]:
    """Links, one per edge; a fixed part's link shares its parent's coordinate."""
    numbers = {edge.child: i for i, edge in enumerate(moving)}
    links: list[Link] = []
    for edge in graph.edges:
        if edge.parent not in (BASE, *(link.child for link in links)):
            problem = f"edge {edge.parent} -> {edge.child}: parent must be {BASE} or the child of an earlier edge"
            raise InputError(problem, remedy="list parents first")
        numbers.setdefault(edge.child, numbers.get(edge.parent, 0))
        links.append(Link(edge.parent, edge.child, numbers[edge.child]))
    return tuple(links)


def _mode(
    chains: Sequence[tuple[LocalModel, ...]],
    choice: tuple[int, ...],
    names: Sequence[str],
    admissible: Region,
    links: Sequence[tuple[Link, Joint | None]],
) -> Mode:
    models = [chain[k] for chain, k in zip(chains, choice, strict=True)]
    n = len(models)
    slack = [RESOLUTION * _pin_std(model) if model.is_rigid else 0.0 for model in models]
    pins = tuple(Pin(i, m.joint.fixed_at, _pin_std(m)) for i, m in enumerate(models) if m.is_rigid)
    flow = np.diag([0.0 if model.is_rigid else 1.0 for model in models])
    lower = [model.lower - wide for model, wide in zip(models, slack, strict=True)]
    upper = [model.upper + wide for model, wide in zip(models, slack, strict=True)]
    return Mode(
        name=_mode_name(chains, choice),
        joints=tuple(_joint(models[link.coordinate], fixed) for link, fixed in links),
        input_matrix=tuple(tuple(float(v) for v in row) for row in flow),
        invariant=box(lower, upper, n, names),
        inputs=admissible,
        pins=pins,
    )


def _joint(model: LocalModel, fixed: Joint | None) -> Joint:
    """A link's joint; for a fixed part, rigid at its carrier's configuration."""
    return model.joint if fixed is None else replace(fixed, fixed_at=model.joint.fixed_at if model.is_rigid else 0.0)


def _edges(
    chains: Sequence[tuple[LocalModel, ...]], choice: tuple[int, ...], names: Sequence[str], release: float
) -> list[Edge]:
    """Transitions out of one mode: to the next and the previous local model of each edge, then the clamps."""
    source = _mode_name(chains, choice)
    changes: list[Edge] = []
    clamps: list[Edge] = []
    for i, (chain, k) in enumerate(zip(chains, choice, strict=True)):
        for forward in (True, False):
            neighbour = k + 1 if forward else k - 1
            if 0 <= neighbour < len(chain):
                target = _mode_name(chains, (*choice[:i], neighbour, *choice[i + 1 :]))
                guard = _exit_guard(chain[k], forward, i, len(chains), names[i], release)
                spread = chain[k].upper_std if forward else chain[k].lower_std
                spread = 0.0 if chain[k].is_rigid else spread  # it is left by an input, whose threshold is chosen
                changes.append(Edge(source, target, Region((guard,)), threshold_std=spread))
            elif not chain[k].is_rigid:
                clamps.append(_clamp(source, chain[k], forward, i, len(chains), names[i]))
    return changes + clamps


def _exit_guard(model: LocalModel, forward: bool, i: int, n: int, name: str, release: float) -> HalfSpace:
    """Guards {c >= upper} and {c < lower} of the paper; guards on the input out of rigid models."""
    if model.is_rigid:
        side, at = (input_above, release) if forward else (input_below, 0.0 - release)
        return side(i, at, n, n, strict=True, name=f"input {name}")
    side, at = (above, model.upper) if forward else (below, model.lower)
    return side(i, at, n, n, strict=not forward, name=name)


def _clamp(source: str, model: LocalModel, forward: bool, i: int, n: int, name: str) -> Edge:
    side, end = (above, model.upper) if forward else (below, model.lower)
    return Edge(source, source, Region((side(i, end, n, n, strict=True, name=name),)), Reset.to({i: end}, n))


def _mode_name(chains: Sequence[tuple[LocalModel, ...]], choice: tuple[int, ...]) -> str:
    return "/".join(chain[k].name for chain, k in zip(chains, choice, strict=True))


def _pin_std(model: LocalModel) -> float:
    """Std of one measurement, not of the mean over rows: a tracker's error drifts."""
    return max(model.observation_std, model.lower_std, model.upper_std, SMALLEST_STD)


def _unit(chain: Sequence[LocalModel]) -> str:
    """rad if the first moving model rotates, else m; other models of the edge keep their own unit."""
    kinds = [model.joint.kind for model in chain if not model.is_rigid]
    return KINDS[kinds[0]].unit if kinds else "m"


def _noise_of(moving: Sequence[KinematicEdge]) -> Noise:
    """Noise by coordinate: root mean square over rows of its moving segments."""
    stds = []
    for edge in moving:
        segments = [segment for segment in edge.segments if segment.joint.moves] or edge.segments
        rows = [segment.end - segment.start + 1 for segment in segments]
        squares = np.square([[s.process_std for s in segments], [s.observation_std for s in segments]])
        stds.append(np.maximum(np.sqrt(np.average(squares, axis=1, weights=rows)), SMALLEST_STD).tolist())
    process, observation = zip(*stds, strict=True)
    return Noise(process, observation)


def _parts(graph: KinematicGraph, listed: Sequence[Part]) -> tuple[Part, ...]:
    names = dict.fromkeys(name for edge in graph.edges for name in (edge.parent, edge.child))
    by_name = {part.name: part for part in listed}
    parts = tuple(by_name.get(name, Part(name)) for name in names if name != BASE or name in by_name)
    return parts + tuple(part for part in listed if part.name not in names)


def no_single_joint_error(graph: KinematicGraph) -> InputError | None:
    """The error for the first rows without a single joint, to be raised; None if there are none.

    Such rows are not skipped: the joints before and after them share one coordinate only through them, and a part that
    moves off its joint once can do so again, in every mode of the automaton.
    """
    no_single_joints = [
        (segment, no_single_joint, edge.child)
        for edge in graph.edges
        for segment in edge.segments
        if (no_single_joint := segment.no_single_joint) is not None
    ]
    if not no_single_joints:
        return None
    more = (
        f" (and {len(no_single_joints) - 1} more such stretch{'es' if len(no_single_joints) > 2 else ''})"
        if len(no_single_joints) > 1
        else ""
    )
    part = no_single_joints[0][2]
    carried = part in {edge.parent for edge in graph.edges} and {child for *_, child in no_single_joints} == {part}
    remedy = f"learn what stands on it relative to it, as `--base {part}` does" if carried else _MISFIT_REMEDY
    return InputError(_no_single_joint_sentence(*no_single_joints[0]) + more, remedy=remedy)


def _no_single_joint_sentence(segment: Segment, no_single_joint: NoSingleJoint, part: str) -> str:
    distances = [(no_single_joint.position, no_single_joint.position_noise, "m")]
    if no_single_joint.rotation is not None and no_single_joint.rotation_noise is not None:
        distances.append((no_single_joint.rotation, no_single_joint.rotation_noise, "rad"))
    missed = " and ".join(quantity(miss, unit, degrees=False) for miss, _, unit in distances)
    best = (
        f"no single-joint model fits rows {segment.start} to {segment.end} of part '{part}' (run {segment.run}): the "
        f"best, {segment.joint.kind}, misses them by {missed}"
    )
    if all(miss <= alone for miss, alone, _ in distances):  # no more than noise, but in one direction
        return f"{best}, row after row the same way: motion along a smooth curve explains them better"
    noise = " and ".join(quantity(alone, unit, digits=2, degrees=False) for _, alone, unit in distances)
    return f"{best} where the measurement alone would leave {noise}"


def _learned_edges(graph: KinematicGraph) -> Iterator[LearnedEdge]:
    """The edges of a graph that have certainties, with probabilities rounded to 6 decimals."""
    for edge in graph.edges:
        certainty = edge.certainty
        if certainty is None and all(segment.certainty is None for segment in edge.segments):
            continue
        if certainty is not None:
            counts = tuple(tuple(map(_probability, run)) for run in certainty.changepoint_counts)
            certainty = replace(certainty, changepoint_counts=counts, trace=None)
        segments = (LearnedSegment(s.joint.kind, s.run, s.start, s.end, _rounded(s.certainty)) for s in edge.segments)
        yield LearnedEdge(edge.parent, edge.child, tuple(segments), certainty)


def _rounded(certainty: SegmentCertainty | None) -> SegmentCertainty | None:
    if certainty is None:
        return None
    start = certainty.start
    if start is not None:
        pairs = [(row, _probability(p)) for row, p in zip(start.rows, start.probabilities, strict=True)]
        pairs = [pair for pair in pairs if pair[1] > 0]
        start = RowPosterior(tuple(row for row, _ in pairs), tuple(p for _, p in pairs))
    kinds = tuple((kind, _probability(p)) for kind, p in certainty.kinds)
    return replace(certainty, start=start, kinds=kinds, deviation=None)


def _probability(value: float) -> float:
    """A probability rounded and clipped to [0, 1]."""
    return min(1.0, max(0.0, round(float(value), DIGITS)))
