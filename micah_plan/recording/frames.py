"""Frame trees over time: composition of a log's transforms to poses of parts in one frame."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from micah_plan.arrays import EQUAL, Booleans, Floats, Ints
from micah_plan.errors import InputError, shown
from micah_plan.recording import messages


@dataclass
class FrameEdge:
    """A frame or part in its parent, as one topic gives it.

    Attributes:
        topic: its name, as it was logged.
        child, parent: frames without slashes at their ends.
        static: it is given once and for all.
        samples: stamp [ns] and pose x, y, z, qx, qy, qz, qw of each message.
    """

    topic: str
    child: str
    parent: str
    static: bool = False
    samples: list[tuple[int, tuple[float, ...]]] = field(default_factory=list)

    def without_lost(self) -> str:
        """Remove samples with missing numbers or zero quaternions; returns the note.

        If all quaternions are zero, orientations were not measured, as for a point. The result may be empty.
        """
        poses = np.array([pose for _, pose in self.samples])
        placed, turns = np.isfinite(poses[:, :3]).all(axis=1), poses[:, 3:]
        if not np.nan_to_num(turns).any():
            self.samples = [(stamp, (*pose[:3], *(np.nan,) * 4)) for stamp, pose in self.samples]
            good = placed
        else:
            good = placed & np.isfinite(turns).all(axis=1) & turns.any(axis=1)
        lost = len(good) - int(good.sum())
        self.samples = [sample for sample, keep in zip(self.samples, good.tolist(), strict=True) if keep]
        return messages.poses_left_out(lost, self.child) if lost else ""

    def once(self) -> tuple[Ints, Floats]:
        """((k,) unique sorted stamps, (k, 7) poses).

        Raises:
            InputError: if two different poses have one stamp.
        """
        samples = sorted(self.samples)
        stamps = np.array([stamp for stamp, _ in samples], dtype=np.int64)
        poses = np.array([pose for _, pose in samples])
        again = np.flatnonzero(np.diff(stamps) == 0)
        apart = np.nan_to_num(np.abs(poses[again + 1] - poses[again])).max(axis=1, initial=0.0) > EQUAL
        if not self.static and apart.any():
            time = stamps[again[apart][0]] / 1e9
            problem = f"{shown(self.topic)} has two poses of {shown(self.child)} at {time:.3f} s"
            raise InputError(problem, remedy="does another node publish it too? Choose another topic: --topic NAME")
        keep = np.diff(stamps, append=stamps[-1] + 1) != 0
        return stamps[keep], poses[keep]

    def at(self, stamps: Ints) -> tuple[Floats, Rotation, Booleans]:
        """(positions (n, 3), rotations, validity (n,)) interpolated at stamps [ns]."""
        edges, poses = self.once()
        if not np.isfinite(poses).all():
            problem = f"{shown(self.topic)} gives no orientation of {shown(self.child)}, which others are placed by"
            raise InputError(problem, remedy="choose another frame: --frame NAME")
        if self.static or len(edges) == 1:
            chosen = np.repeat(poses[-1:], len(stamps), axis=0)
            return chosen[:, :3], Rotation.from_quat(chosen[:, 3:]), np.full(len(stamps), True)
        # Relative to the first, so that nanoseconds of an epoch fit into a float.
        begin = edges[0]
        own_times, times = (edges - begin).astype(float), (stamps - begin).astype(float)
        inside = np.clip(times, own_times[0], own_times[-1])
        position = np.stack([np.interp(inside, own_times, poses[:, i]) for i in range(3)], axis=1)
        turns = Slerp(own_times, Rotation.from_quat(poses[:, 3:]))(inside)
        return position, turns, inside == times


@dataclass(frozen=True)
class Frames:
    """All transforms of a log by child frame."""

    edges: Mapping[str, FrameEdge]

    @classmethod
    def of(cls, edges: Iterable[FrameEdge]) -> Frames:
        """The frame tree of a log's edges; of several parents of a frame the first."""
        by_child: dict[str, FrameEdge] = {}
        for edge in edges:
            by_child.setdefault(edge.child, edge)
        return cls(by_child)

    def upwards(self, frame: str) -> list[FrameEdge]:
        """The edges from a frame to its root.

        Raises:
            InputError: if they go in a circle.
        """
        edges: list[FrameEdge] = []
        while frame in self.edges:
            edge = self.edges[frame]
            if edge in edges:
                raise InputError(f"the transforms of {shown(frame)} go in a circle", remedy="record a tree of frames")
            edges.append(edge)
            frame = edge.parent
        return edges

    def root(self, frame: str) -> str:
        """The root frame above a frame."""
        edges = self.upwards(frame)
        return edges[-1].parent if edges else frame

    def placed(self, frame: str, target: str, stamps: Ints) -> tuple[Floats, Rotation, Booleans]:
        """(positions (n, 3), rotations, validity (n,)) of a frame in another at stamps [ns].

        Raises:
            InputError: if no transforms lead from one to the other.
        """
        if self.root(frame) != self.root(target):
            problem = f"no transforms lead from {shown(frame)} to {shown(target)}"
            remedy = f"{shown(frame)} is in {shown(self.root(frame))}: --frame {self.root(frame)}"
            raise InputError(problem, remedy=remedy)
        ours, theirs = self.upwards(frame), self.upwards(target)
        while ours and theirs and ours[-1] is theirs[-1]:  # a common ancestor cancels out
            ours, theirs = ours[:-1], theirs[:-1]
        position, turn, is_known = _along(ours, stamps)
        origin, turned, also = _along(theirs, stamps)
        back = turned.inv()
        return back.apply(position - origin), back * turn, is_known & also


def _along(edges: Sequence[FrameEdge], stamps: Ints) -> tuple[Floats, Rotation, Booleans]:
    """The composed transforms along a chain of edges."""
    position, is_known = np.zeros((len(stamps), 3)), np.full(len(stamps), True)
    turn = Rotation.from_quat(np.tile([0.0, 0.0, 0.0, 1.0], (len(stamps), 1)))
    for edge in edges:
        origin, turned, there = edge.at(stamps)
        position, turn, is_known = origin + turned.apply(position), turned * turn, is_known & there
    return position, turn, is_known


def moves(edges: Sequence[FrameEdge]) -> bool:
    """Whether a frame moves in the one at the top of its edges."""
    return any(not edge.static and np.ptp(edge.once()[1], axis=0).max(initial=0.0) > EQUAL for edge in edges)


def displacements_between(stamps: Ints, vectors: Floats, at: Ints) -> Floats:
    """(n, 3) displacement commanded between consecutive times, NaN at the last.

    Each command acts evenly from its stamp to the next one, at most for the usual interval, so that commands between
    two times are counted exactly once.

    Args:
        stamps: (k,) of the commands, in order [ns].
        vectors: (k, 3) commanded displacements.
        at: (n,) times in order [ns].
    """
    begin = min(stamps[0], at[0])
    lengths = np.diff(stamps)
    usual = np.median(lengths) if len(lengths) else (at[-1] - at[0]) / max(1, len(at) - 1)
    lasting = np.minimum(np.append(lengths, usual), usual)
    edges = np.stack([stamps - begin, stamps - begin + lasting], axis=1).ravel()
    total = np.cumsum(np.stack([np.zeros_like(vectors), vectors], axis=1).reshape(-1, 3), axis=0)
    reached = np.stack([np.interp(at - begin, edges, total[:, i], left=0.0) for i in range(3)], axis=1)
    return np.concatenate([np.diff(reached, axis=0), np.full((1, 3), np.nan)])


def interpolated(stamps: Ints, vectors: Floats, at: Ints) -> Floats:
    """(n, 3) values interpolated linearly at times [ns]; NaN in gaps and outside."""
    begin = min(stamps[0], at[0])
    found = np.stack([np.interp(at - begin, stamps - begin, vectors[:, i]) for i in range(3)], axis=1)
    usual = np.median(np.diff(stamps)) if len(stamps) > 1 else 0.0
    right = np.clip(np.searchsorted(stamps, at), 1, len(stamps) - 1) if len(stamps) > 1 else np.zeros(len(at), int)
    far = stamps[right] - stamps[np.maximum(right - 1, 0)] > 1.5 * usual
    outside = (at < stamps[0]) | (at > stamps[-1])
    found[(far | outside) & ~np.isin(at, stamps)] = np.nan
    return found
