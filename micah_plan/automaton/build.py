"""The hybrid automaton of an articulated object from its extended kinematic graph.

Source: MICAH, section IV-B, "Hybrid Automaton Construction". Followed as there: Q is the Cartesian product of the
edges' local models, X and U have one coordinate per edge, transitions change one edge's model at a time to a
neighbouring one, guards come from the configurational changepoints, the ends of the range are clamped self
transitions, resets are the identity. Where it differs, and why:

- **Absolute coordinates.** The paper subtracts x^q, the configurations passed so far, from x in each mode, so that
  every local model starts at 0. Here all models of an edge share one coordinate (`graph.Segment`), x⁺ = x + B u, and a
  value means the same in every mode: beliefs, goals and guards need no translation, the identity reset is really one.
- **Rigid models.** In the paper x + u moves x in a rigid mode too. Here nothing moves it (a zero row in B), its
  coordinate is pinned to the configuration at which the part was fixed (being there is information), and it is left
  by pulling: {u < -release} towards smaller and {u > release} towards larger configurations, since a guard on a
  pinned x would never be reached again. A rigid model at an end of the range needs no clamp, having a pin.
- **Invariants are closed.** The paper's domains [0, c) leave the boundary to the next model, but events are located
  exactly (`transition`), so a state can be on the boundary in either model. A rigid model's invariant is what a
  measurement does not distinguish from it: ``local_models.RESOLUTION`` std around its configuration.
- **Thresholds have a std** (`Edge.threshold_std`) where learning gave a posterior of the changepoint's row. A rigid
  model that is entered at such a threshold is pinned no better than that.
- **Numbers have six digits** (`rounding`), far more than learning knows, so that people can read the file.
- **Clamps have strict guards** {x < lower}, {x > upper}: resting at the end is no event, moving on is one.

An edge to the base that never moved keeps its coordinate, as in the paper; the only model pins it. A part that is fixed
to another part, such as a handle on a door, adds no local model to the product: its link follows the coordinate of its
parent, through a rigid joint. Neighbours are connected both ways, so every mode of the product can be reached from
every other. `Init` is left to the task, as there.

**Digits.** Numbers of an automaton with as many digits as they are worth, rounded once, when it is made of what was
learned.

Six significant digits are a thousandth of the standard deviation that the best tracker leaves of a joint. Rounding
keeps the order of numbers and what is equal, so guards still end where ranges and pins do. Unit vectors have ten
decimals, as a length other than 1 would scale all motion. What files say is then what the model is: `load_model`
returns the very same values.

**Local models.** From an edge's segments in time to its local models along the configuration: M^k and Dom(M^k).

Source: MICAH, section IV-B. The paper takes the segments of one sweep as they come; a recording may also stop on the
way, return, or pass through a region several times, and all these segments show the same models. Rules:

1. Moving segments that cover the same configurations (more than half of the shorter range) are one model, with the
   joint of the longest of them; rigid segments at the same configuration (within ``RESOLUTION`` std) are one model.
2. A rigid segment inside the range of a moving model is dropped: the part was seen to move through that configuration,
   so it merely rested there.
3. What remains is ordered by configuration. Two neighbouring rigid models are one (the longer): a coordinate that was
   never seen to move between them cannot tell them apart.
4. Neighbours meet at the configurational changepoint: at the configuration of a rigid model, else where the
   recording changed from one to the other, else half way between their ranges.
5. How well that configuration is known follows from the posterior of the changepoint's row, where there is one: rows
   are turned into configurations with the segments' mean speeds, and a measurement's std is added.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from micah_plan.automaton.check import check_automaton
from micah_plan.automaton.graph import (
    BASE,
    KinematicEdge,
    KinematicGraph,
    LearnedEdge,
    LearnedSegment,
    NoSingleJoint,
    RowPosterior,
    Segment,
    SegmentCertainty,
)
from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Link, Mode, Noise, Part, Pin, Reset
from micah_plan.automaton.joint import KINDS, Joint
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
        provenance: where the model came from.

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
    """One per edge; a fixed part's follows the coordinate of its parent."""
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
    """A link's joint; a fixed one stands for the configuration at which its carrier is fixed, if it is."""
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
                guard = _leaving(chain[k], forward, i, len(chains), names[i], release)
                spread = chain[k].upper_std if forward else chain[k].lower_std
                spread = 0.0 if chain[k].is_rigid else spread  # it is left by an input, whose threshold is chosen
                changes.append(Edge(source, target, Region((guard,)), threshold_std=spread))
            elif not chain[k].is_rigid:
                clamps.append(_clamp(source, chain[k], forward, i, len(chains), names[i]))
    return changes + clamps


def _leaving(model: LocalModel, forward: bool, i: int, n: int, name: str, release: float) -> HalfSpace:
    """The paper's guards {c >= upper} and {c < lower}; out of a rigid model the input decides."""
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
    """Std of one measurement: a tracker's error wanders, so averaging over the rows would be overconfident."""
    return max(model.observation_std, model.lower_std, model.upper_std, SMALLEST_STD)


def _unit(chain: Sequence[LocalModel]) -> str:
    """rad if the first model that moves rotates, m otherwise; the other models of the edge count in their own unit."""
    kinds = [model.joint.kind for model in chain if not model.is_rigid]
    return KINDS[kinds[0]].unit if kinds else "m"


def _noise_of(moving: Sequence[KinematicEdge]) -> Noise:
    """Noise by coordinate, from the moving segments of its edge if there are any: root mean square by rows."""
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
    """The refusal for the first rows that no single joint explains, to be raised; None if there are none.

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
    if all(miss <= alone for miss, alone, _ in distances):  # no more than noise would, but row after row the same way
        return f"{best}, row after row the same way: motion along a smooth curve explains them better"
    noise = " and ".join(quantity(alone, unit, digits=2, degrees=False) for _, alone, unit in distances)
    return f"{best} where the measurement alone would leave {noise}"


def _learned_edges(graph: KinematicGraph) -> Iterator[LearnedEdge]:
    """The edges of a graph that say how sure they are, with probabilities rounded to 6 decimals."""
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
    """Rounded, and without what arithmetic left outside of 0 to 1."""
    return min(1.0, max(0.0, round(float(value), DIGITS)))


DIGITS = 6
UNIT_DECIMALS = 10


def rounded(automaton: HybridAutomaton) -> HybridAutomaton:
    """The automaton with rounded joints, boundaries, resets, pins and noise; covariances keep all digits."""
    rounded_fields = {key: _rounded_numbers(getattr(automaton, key)) for key in ("modes", "edges", "noise")}
    return replace(automaton, **rounded_fields)


def _rounded_numbers(value: Any) -> Any:
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    if isinstance(value, tuple):
        return tuple(_rounded_numbers(item) for item in value)
    if isinstance(value, Joint):
        # A path's pose at c = 0 is interpolated between its knots, so that rounding them would move it.
        kept = ("kind", "covariance") if value.kind != "path" else tuple(field.name for field in fields(Joint))
    elif is_dataclass(value) and not isinstance(value, type):
        kept = ()
    else:
        return value
    rounded_fields = {
        field.name: _rounded_numbers(getattr(value, field.name)) for field in fields(value) if field.name not in kept
    }
    if isinstance(value, Joint):
        units = {key: tuple(round(v, UNIT_DECIMALS) for v in getattr(value, key)) for key in ("axis", "quaternion")}
        rounded_fields |= {key: unit for key, unit in units.items() if key not in kept}
    return replace(value, **rounded_fields)


RESOLUTION = 3.0


@dataclass(frozen=True)
class LocalModel:
    """A joint that governs an edge between two configurations.

    Attributes:
        name: kind of the joint, numbered if the edge has several of the kind (``"prismatic_2"``).
        joint: its joint.
        lower, upper: the configurations between which it governs [rad or m]; equal for rigid.
        observation_std: of one pose measurement expressed as configuration [rad or m].
        lower_std, upper_std: how well these are known where another model begins [rad or m]; 0 if nothing tells.
    """

    name: str
    joint: Joint
    lower: float
    upper: float
    observation_std: float
    lower_std: float = 0.0
    upper_std: float = 0.0

    @property
    def is_rigid(self) -> bool:
        return not self.joint.moves


@dataclass(frozen=True)
class _Group:
    """Segments (numbered in time) that one model explains; `leading` is the longest of them."""

    members: tuple[int, ...]
    leading: Segment
    rows: int
    lower: float
    upper: float

    @property
    def is_rigid(self) -> bool:
        return not self.leading.joint.moves

    @property
    def center(self) -> float:
        return self.leading.joint.fixed_at if self.is_rigid else (self.lower + self.upper) / 2

    @property
    def blur(self) -> float:
        return RESOLUTION * self.leading.observation_std


def local_models(edge: KinematicEdge) -> tuple[LocalModel, ...]:
    """The local models of an edge, in order of configuration.

    Raises:
        InputError: the edge has no segments, or its segments cannot be ordered along one coordinate.
    """
    if not edge.segments:
        raise InputError(f"edge {edge.parent} -> {edge.child} must have at least one segment. Got none")
    groups = _merged(
        [_Group((i,), s, s.end - s.start + 1, *s.configuration_range) for i, s in enumerate(edge.segments)]
    )
    moving = [group for group in groups if not group.is_rigid]
    groups = [group for group in groups if not any(_rests_within(group, mover) for mover in moving)]
    groups = _without_rigid_neighbours(sorted(groups, key=lambda group: group.center))
    bounds = _bounds(edge, groups)
    stds = [0.0, *(_changepoint_std(edge, a, b) for a, b in pairwise(groups)), 0.0]
    names = _names([group.leading.joint.kind for group in groups])
    return tuple(
        LocalModel(name, group.leading.joint, lower, upper, group.leading.observation_std, lower_std, upper_std)
        for name, group, (lower, upper), (lower_std, upper_std) in zip(
            names, groups, pairwise(bounds), pairwise(stds), strict=True
        )
    )


def _merged(groups: list[_Group]) -> list[_Group]:
    """Join groups of one model, always the first two that are, until no two are left."""
    groups, i = list(groups), 0
    while i < len(groups):
        same = next((j for j in range(i + 1, len(groups)) if _is_same_model(groups[i], groups[j])), None)
        if same is None:
            i += 1
            continue
        groups[i] = _joined(groups[i], groups.pop(same))
        # The larger group may match one that it did not match before.
        before = next((j for j in range(i) if _is_same_model(groups[j], groups[i])), None)
        while before is not None:
            groups[before], i = _joined(groups[before], groups.pop(i)), before
            before = next((j for j in range(i) if _is_same_model(groups[j], groups[i])), None)
    return groups


def _is_same_model(first: _Group, second: _Group) -> bool:
    if first.is_rigid != second.is_rigid:
        return False
    if first.is_rigid:
        return abs(first.center - second.center) <= float(np.hypot(first.blur, second.blur))
    overlap = min(first.upper, second.upper) - max(first.lower, second.lower)
    return overlap > 0.5 * min(first.upper - first.lower, second.upper - second.lower)


def _joined(first: _Group, second: _Group) -> _Group:
    longer = first if first.rows >= second.rows else second
    return replace(
        longer,
        members=first.members + second.members,
        rows=first.rows + second.rows,
        lower=min(first.lower, second.lower),
        upper=max(first.upper, second.upper),
    )


def _rests_within(group: _Group, mover: _Group) -> bool:
    # Where a motion ends is known to a row.
    margin = max(group.blur, mover.blur) + _mean_speed(mover.leading)
    return group.is_rigid and mover.lower + margin < group.center < mover.upper - margin


def _without_rigid_neighbours(groups: list[_Group]) -> list[_Group]:
    kept: list[_Group] = []
    for group in groups:
        if kept and kept[-1].is_rigid and group.is_rigid:
            kept[-1] = _joined(kept[-1], group)
        else:
            kept.append(group)
    return kept


def _bounds(edge: KinematicEdge, groups: list[_Group]) -> list[float]:
    """The k+1 configurations between and around k groups."""
    first, last = groups[0], groups[-1]
    bounds = [first.center if first.is_rigid else first.lower]
    bounds += [_changepoint(edge, a, b) for a, b in pairwise(groups)]
    bounds.append(last.center if last.is_rigid else last.upper)
    for group, lower, upper in zip(groups, bounds[:-1], bounds[1:], strict=True):
        if not group.is_rigid and not lower < upper:
            raise InputError(
                f"edge {edge.parent} -> {edge.child}: its segments must follow one another along one configuration. "
                f"Got a {group.leading.joint.kind} segment from {lower:.4g} to {upper:.4g}",
                remedy="record a motion through the whole range, or fewer stops",
            )
    return bounds


def _changepoint(edge: KinematicEdge, below: _Group, above: _Group) -> float:
    """The configuration at which two neighbours meet."""
    for group in (above, below):
        if group.is_rigid:
            return group.center
    switches = [(a.configuration_end + b.configuration_start) / 2 for a, b in _switches(edge, below, above)]
    return float(np.mean(switches)) if switches else (below.upper + above.lower) / 2


def _changepoint_std(edge: KinematicEdge, below: _Group, above: _Group) -> float:
    """How well the configuration is known at which two neighbours meet; 0 if no switch has a posterior of its row."""
    variances = [
        _row_std(before, after, after.certainty.start) ** 2
        for before, after in _switches(edge, below, above)
        if after.certainty is not None and after.certainty.start is not None
    ]
    if not variances:
        return 0.0
    # Rows are chosen anew at every switch, but the tracker's error wanders: more switches do not average it away.
    measured = max(below.leading.observation_std, above.leading.observation_std)
    return float(np.hypot(np.sqrt(np.sum(variances)) / len(variances), measured))


def _switches(edge: KinematicEdge, below: _Group, above: _Group) -> list[tuple[Segment, Segment]]:
    """Segments that followed one another where the recording changed between two models, either way."""
    return [
        (edge.segments[i], edge.segments[i + 1])
        for i in range(len(edge.segments) - 1)
        if (i in below.members and i + 1 in above.members) or (i in above.members and i + 1 in below.members)
    ]


def _row_std(before: Segment, after: Segment, start: RowPosterior) -> float:
    """Std of the configuration at which `after` starts, over the posterior of its first row [rad or m]."""
    late = np.array(start.rows, dtype=float) - after.start
    moved = late * np.where(late < 0, _mean_speed(before), _mean_speed(after))
    weights = np.array(start.probabilities)
    mean = np.average(moved, weights=weights)
    return float(np.sqrt(np.average((moved - mean) ** 2, weights=weights)))


def _mean_speed(segment: Segment) -> float:
    """Configuration covered per row, by the way to the far end of the range and from there to the end."""
    if not segment.joint.moves:
        return 0.0
    start, end = segment.configuration_start, segment.configuration_end
    way = max(abs(far - start) + abs(end - far) for far in segment.configuration_range)
    return way / max(1, segment.end - segment.start)


def _names(kinds: list[str]) -> list[str]:
    return [kind if kinds.count(kind) == 1 else f"{kind}_{kinds[: i + 1].count(kind)}" for i, kind in enumerate(kinds)]
