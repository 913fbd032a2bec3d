"""Kinematic tree of several parts from edges learned pairwise.

Sources: Sturm, Stachniss and Burgard, "A probabilistic framework for learning kinematic models of articulated
objects", JAIR 2011 (spanning tree of greatest posterior); MICAH, section IV-A (edges of several models). Why evidences
of different parents can be compared is written in docs/concepts/joints.md, "The tree".

The parent is placed where its own edge predicts it (`refined_poses.branch_poses`), which leaves the child's noise, the
same for every parent. Its edge belongs to a tree, so this starts with all parts on the base and is repeated along the
tree found, until the tree no longer changes. An edge with as many rows of free motion as that of the base is left out:
free motion follows poses without noise closer than any joint may.

Parts that are rigid to each other at all times are one body, decided within the pair; the first of its parts by name
takes part in the search. Pairs that `carriers` excludes are not learned, nor those with a part that is rigid to the
base, nor any if orientation was not measured.

The edges returned are learned from measured poses, as a later observer measures them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.errors import InputError, shown
from micah_plan.learning.parts.arborescence import Arc, Weight, maximum_arborescence
from micah_plan.learning.parts.carriers import carriers, moves_far
from micah_plan.learning.parts.refined_poses import branch_poses
from micah_plan.learning.parts.relative import RelativeRows, in_whole_recording, relative_rows
from micah_plan.learning.segmenting.report import LOG_ODDS_OVERSTATED
from micah_plan.recording.value import Recording
from micah_plan.summaries import Progress

PairLearner = Callable[[Recording], KinematicEdge]

_MOST_ROUNDS = 5  # of poses along a tree and trees alternately
_LOG_BASE_ODDS = 3.0  # prior, 20 to 1: that a moving part stands on the base and not on a certain other one
_EVIDENCE_DIGITS = 6  # evidences that agree so far [nats] are ties


@dataclass(frozen=True, eq=False)
class PairEdge:
    """A learned edge of a child relative to a candidate parent.

    Attributes:
        relative: the rows that it was learned from.
        edge: as the learner returned it: its rows count within `relative.recording`.
    """

    relative: RelativeRows
    edge: KinematicEdge

    @property
    def is_rigid(self) -> bool:
        """Whether the two never move relative to each other."""
        return all(not segment.joint.moves and segment.no_single_joint is None for segment in self.edge.segments)

    @property
    def free_rows(self) -> int:
        """Number of rows that no joint explains."""
        return sum(segment.end - segment.start + 1 for segment in self.edge.segments if _is_free(segment))

    @property
    def log_evidence(self) -> float:
        """Log evidence of its rows [nats]: of all segmentations if available, else of the chosen one."""
        if self.edge.certainty is not None:
            return self.edge.certainty.log_evidence
        return sum(segment.log_evidence for segment in self.edge.segments)


def learn_tree(recording: Recording, learn_pair: PairLearner, progress: Progress | None = None) -> KinematicGraph:
    """The kinematic tree of a recording's parts, and how every part moves relative to its parent.

    Args:
        recording: of one or several parts.
        learn_pair: learns one edge from a recording of one part, whose poses and actions are relative to the parent;
            the segments' rows count within that recording. It is called once for every tested pair.
        progress: called with a message and the fraction done.

    Returns:
        Edges in the order of the recording's parts, but parents first; rows count within the whole recording.

    Raises:
        InputError: a part named like the base, or as raised by `learn_pair`.
    """
    if BASE in recording.parts:
        problem = f"a part is named {shown(BASE)}, as the body that the tree stands on"
        raise InputError(problem, where="column 'part'", remedy="give the part another name or leave its rows out")
    pairs = _Pairs(recording, learn_pair, progress)
    found = dict.fromkeys(recording.parts, BASE)
    probability = None
    if recording.has_orientation and len(recording.parts) > 1:
        still = {part for part in recording.parts if pairs.measured(BASE, part).is_rigid}
        able = {
            child: tuple(parent for parent in parents if not {parent, child} & still)
            for child, parents in carriers(recording).items()
        }
        bodies = _bodies(able, pairs)
        found |= bodies
        free = {
            child: tuple(parent for parent in parents if parent not in bodies)
            for child, parents in able.items()
            if child not in bodies
        }
        parents, probability = _searched(free, pairs)
        found |= parents
    edges = tuple(pairs.final(found[part], part) for part in _parents_first(found))
    if progress is not None:
        progress("learned", 1.0)
    return KinematicGraph(edges, probability)


def _is_free(segment: Segment) -> bool:
    """Whether no joint explains a segment, or it deviates from its joint more than real ones do."""
    sure = segment.certainty
    is_off = sure is not None and sure.deviation is not None and sure.deviation.probability > 0.5
    return segment.no_single_joint is not None or is_off


class _Pairs:
    """Learned pairs, cached."""

    def __init__(self, recording: Recording, learn_pair: PairLearner, progress: Progress | None) -> None:
        self.recording = recording
        self._learn_pair = learn_pair
        self._progress = progress
        self._learned: dict[tuple[str, ...], PairEdge | None] = {}
        self._poses: dict[tuple[str, ...], RigidTransform] = {}
        self._base_evidence: dict[tuple[str, str], float] = {}

    def measured(self, parent: str, child: str) -> PairEdge:
        """The pair learned from measured poses.

        Raises:
            InputError: if the two have too few rows in common.
        """
        pair = self._pair((parent,), child, None)
        if pair is None:
            raise InputError(
                f"parts {shown(parent)} and {shown(child)} have no run in which both were measured at the same time",
                remedy="record the parts of one object together",
            )
        return pair

    def are_rigid(self, parent: str, child: str) -> bool:
        """Whether two parts never move relative to each other; False without common rows."""
        if (parent, child) not in self._learned:
            relative = relative_rows(self.recording, parent, child)
            if relative is None or moves_far(relative.recording):
                return False
        return self.measured(parent, child).is_rigid

    def on_branch(self, branch: tuple[str, ...], child: str) -> PairEdge | None:
        """The pair learned from refined poses of the branch (base first); None with too few common rows."""
        return (
            self.measured(BASE, child)
            if branch == (BASE,)
            else self._pair(branch, child, self._refined_poses_on(branch))
        )

    def log_evidence_of_base(self, pair: PairEdge, child: str) -> float:
        """Log evidence of a pair's rows [nats] with the child on the base, for comparison on equal rows."""
        relative, whole = pair.relative, self.measured(BASE, child)
        if len(relative) == len(whole.relative):
            return whole.log_evidence
        key = (relative.parent, child)
        if key not in self._base_evidence:
            rows = relative.rows
            common = RelativeRows(BASE, self.recording.rows(rows), rows, RigidTransform.identity(len(rows)))
            self._base_evidence[key] = PairEdge(common, self._learn_pair(common.recording)).log_evidence
        return self._base_evidence[key]

    def is_attachment(self, pair: PairEdge, child: str) -> bool:
        """Whether a pair is evidence that its child is mounted on a parent other than the base."""
        return not pair.free_rows or pair.free_rows < self.measured(BASE, child).free_rows

    def final(self, parent: str, child: str) -> KinematicEdge:
        """The edge from measured poses, in rows of the whole recording."""
        pair = self.measured(parent, child)
        return in_whole_recording(pair.edge, pair.relative, child)

    def _pair(self, branch: tuple[str, ...], child: str, poses: RigidTransform | None) -> PairEdge | None:
        """The learned edge of a child on the last part of a branch; None if it cannot be learned."""
        key = (*branch, child)
        if key not in self._learned:
            if self._progress is not None:
                parts = len(self.recording.parts)
                message = f"learning part '{child}' relative to {branch[-1]}"
                # How many pairs will be needed is not known before; the base's are the first of all.
                self._progress(message, min(0.95, len(self._learned) / (parts * (parts + 1))))
            relative = relative_rows(self.recording, branch[-1], child, poses)
            self._learned[key] = (
                None if relative is None else PairEdge(relative, self._learn_pair(_learnable_rows(relative)))
            )
        return self._learned[key]

    def _refined_poses_on(self, branch: tuple[str, ...]) -> RigidTransform:
        """(n,) poses with the parts of the branch replaced by their refined ones."""
        if branch == (BASE,):
            return self.recording.poses()
        if branch not in self._poses:
            poses = self._refined_poses_on(branch[:-1])
            pair = self.on_branch(branch[:-1], branch[-1])
            self._poses[branch] = poses if pair is None else branch_poses(pair.edge, pair.relative, poses)
        return self._poses[branch]


def _learnable_rows(relative: RelativeRows) -> Recording:
    """The recording to learn from: without actions where the relative motion may be nothing but measurement noise."""
    still = relative.parent != BASE and not moves_far(relative.recording)
    return replace(relative.recording, action=None) if still else relative.recording


def _bodies(able: Mapping[str, tuple[str, ...]], pairs: _Pairs) -> dict[str, str]:
    """(parts that are rigidly attached to others, representative part of each body)."""
    first = {part: part for part in able}
    for child in sorted(able):
        for parent in sorted(able[child]):
            mutual = parent < child and child in able[parent]
            if mutual and first[parent] != first[child] and pairs.are_rigid(parent, child):
                low, high = sorted((first[parent], first[child]))
                first = {part: low if body == high else body for part, body in first.items()}
    return {part: body for part, body in first.items() if part != body}


def _searched(able: Mapping[str, tuple[str, ...]], pairs: _Pairs) -> tuple[dict[str, str], float]:
    """Parent of every body: the tree of greatest evidence, with poses refined along candidate branches.

    And its probability among all trees, with the poses found along it.
    """
    parents = dict.fromkeys(able, BASE)
    best, best_weight, probability = parents, -np.inf, 1.0
    visited: list[dict[str, str]] = []
    while parents not in visited and len(visited) < _MOST_ROUNDS:
        visited.append(parents)
        weights = _weights(able, parents, pairs)
        # The tree that the poses were found along, valued with these poses; with them an edge of it may be none.
        arcs = [(parent, child) for child, parent in parents.items()]
        weight = sum(weights[arc][0] for arc in arcs) if weights.keys() >= set(arcs) else -np.inf
        if weight > best_weight:
            best, best_weight = parents, weight
            probability = _tree_probability({arc: pair[0] for arc, pair in weights.items()}, parents)
        parents = maximum_arborescence(weights, BASE)
    return best, probability


def _tree_probability(evidence: Mapping[Arc, float], tree: Mapping[str, str]) -> float:
    """Posterior probability of a tree among all spanning trees (Tutte's matrix-tree theorem).

    Log odds of parents are overestimated like those of kinds: noise and joints are fitted to the rows that judge them.
    """
    index = {child: i for i, child in enumerate(tree)}
    laplacian, log_weight = np.zeros((len(tree), len(tree))), 0.0
    for child, j in index.items():
        odds = {
            parent: value / LOG_ODDS_OVERSTATED
            for (parent, child_of_pair), value in evidence.items()
            if child_of_pair == child
        }
        top = max(odds.values())
        log_weight += odds[tree[child]] - top
        for parent, value in odds.items():
            laplacian[j, j] += np.exp(value - top)
            if parent != BASE:
                laplacian[index[parent], j] -= np.exp(value - top)
    return float(np.clip(np.exp(log_weight - np.linalg.slogdet(laplacian)[1]), 0.0, 1.0))


def _weights(able: Mapping[str, tuple[str, ...]], tree: Mapping[str, str], pairs: _Pairs) -> dict[Arc, Weight]:
    """Weights of all possible edges: evidence relative to the base; ties broken by rigidity, base, name."""
    order = {name: -float(number) for number, name in enumerate(sorted(able))}
    weights: dict[Arc, Weight] = {}
    for child, parents in able.items():
        for parent in (BASE, *parents):
            branch = _branch(tree, parent)
            # A parent below the child has no branch without it: its own edge to the base stands in.
            pair = pairs.on_branch((BASE, parent) if child in branch else branch, child)
            if pair is not None and (parent == BASE or pairs.is_attachment(pair, child)):
                prior = _LOG_BASE_ODDS if parent == BASE else 0.0
                evidence = round(pair.log_evidence - pairs.log_evidence_of_base(pair, child) + prior, _EVIDENCE_DIGITS)
                weights[parent, child] = (evidence, float(pair.is_rigid), float(parent == BASE), order.get(parent, 0.0))
    return weights


def _branch(tree: Mapping[str, str], part: str) -> tuple[str, ...]:
    """The parts on the branch from the base to a part."""
    branch = [part]
    while branch[0] != BASE:
        branch.insert(0, tree[branch[0]])
    return tuple(branch)


def _parents_first(tree: Mapping[str, str]) -> list[str]:
    placed: list[str] = []
    while len(placed) < len(tree):
        placed += [p for p, parent in tree.items() if p not in placed and (parent == BASE or parent in placed)][:1]
    return placed
