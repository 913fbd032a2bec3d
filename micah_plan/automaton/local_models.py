"""Local models M^k and their domains Dom(M^k) along the configuration, from segments in time.

Source: MICAH, section IV-B. The paper uses the segments of one sweep directly; a recording may also stop on the way,
return, or pass through a region several times, and all these segments show the same models. Rules:

1. Moving segments that cover the same configurations (more than half of the shorter range) are one model, with the
   joint of the longest of them; rigid segments at the same configuration (within ``RESOLUTION`` std) are one model.
2. A rigid segment inside the range of a moving model is dropped: the part was seen to move through that configuration,
   so it merely rested there.
3. The remaining models are ordered by configuration. Two neighbouring rigid models are one (the longer): a coordinate
   that was never seen to move between them cannot separate them.
4. Neighbours meet at the configurational changepoint: at the configuration of a rigid model, else where the recording
   changed from one to the other, else half way between their ranges.
5. The std of that configuration follows from the posterior of the changepoint's row, where there is one: rows are
   converted to configurations by the segments' mean speeds, and a measurement's std is added.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from micah_plan.automaton.certainty import RowPosterior
from micah_plan.automaton.graph import KinematicEdge, Segment
from micah_plan.automaton.joint import Joint
from micah_plan.errors import InputError

RESOLUTION = 3.0


@dataclass(frozen=True)
class LocalModel:
    """A joint that governs an edge between two configurations.

    Attributes:
        name: kind of the joint, numbered if the edge has several of the kind (``"prismatic_2"``).
        joint: its joint.
        lower, upper: the configurations between which it governs [rad or m]; equal for rigid.
        observation_std: of one pose measurement expressed as configuration [rad or m].
        lower_std, upper_std: of these where another model begins [rad or m]; 0 if unknown.
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
    """Segments (by number in time) with one model; `leading` is the longest."""

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
        """The middle of its range, or where it is fixed [rad or m]."""
        return self.leading.joint.fixed_at if self.is_rigid else (self.lower + self.upper) / 2

    @property
    def blur(self) -> float:
        """Distance within which a measurement does not separate configurations [rad or m]."""
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
    """Merge groups of one model pairwise until none are left."""
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
    """The configuration of the changepoint between two neighbours."""
    for group in (above, below):
        if group.is_rigid:
            return group.center
    switches = [(a.configuration_end + b.configuration_start) / 2 for a, b in _switches(edge, below, above)]
    return float(np.mean(switches)) if switches else (below.upper + above.lower) / 2


def _changepoint_std(edge: KinematicEdge, below: _Group, above: _Group) -> float:
    """Std of the changepoint between two neighbours; 0 if no switch has a posterior of its row."""
    variances = [
        _row_std(before, after, after.certainty.start) ** 2
        for before, after in _switches(edge, below, above)
        if after.certainty is not None and after.certainty.start is not None
    ]
    if not variances:
        return 0.0
    # Rows are selected at every switch, but the tracker's error wanders: more switches do not average it out.
    measured = max(below.leading.observation_std, above.leading.observation_std)
    return float(np.hypot(np.sqrt(np.sum(variances)) / len(variances), measured))


def _switches(edge: KinematicEdge, below: _Group, above: _Group) -> list[tuple[Segment, Segment]]:
    """Consecutive segments between which the recording changed from one model to the other."""
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
    """Distance covered per row, via the far end of the range."""
    if not segment.joint.moves:
        return 0.0
    start, end = segment.configuration_start, segment.configuration_end
    way = max(abs(far - start) + abs(end - far) for far in segment.configuration_range)
    return way / max(1, segment.end - segment.start)


def _names(kinds: list[str]) -> list[str]:
    return [kind if kinds.count(kind) == 1 else f"{kind}_{kinds[: i + 1].count(kind)}" for i, kind in enumerate(kinds)]
