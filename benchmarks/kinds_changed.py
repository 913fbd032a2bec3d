"""Recordings changed in ways that should not change what is learned, and what should be learned then."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from kinds_scoring import kinds_of
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from micah_plan.automaton.graph import KinematicGraph
from micah_plan.recording.value import Recording

Rows = NDArray[np.int64]
Kinds = tuple[str, ...]
Answer = tuple[tuple[str, str, int, Kinds], ...]  # child, parent, run, kinds in the order of time

_CROP = 0.1
_CERTAIN_ROWS = 8  # of a segment; of fewer, it may be told or not
_NOISE = 0.001  # m


def answer_of(graph: KinematicGraph) -> Answer:
    """Tree and kinds, run by run; of several parts without rests."""
    rests = len(graph.edges) == 1
    return tuple(
        (edge.child, edge.parent, run, kinds_of([one for one in edge.segments if one.run == run], rests))
        for edge in sorted(graph.edges, key=lambda edge: edge.child)
        for run in sorted({one.run for one in edge.segments})
    )


def turned(recording: Recording, rotation: Rotation) -> Recording:
    """The same seen from another base."""
    quaternion, turn = recording.quaternion, rotation.as_matrix().T
    return replace(
        recording,
        position=recording.position @ turn,
        quaternion=None if quaternion is None else (rotation * Rotation.from_quat(quaternion)).as_quat(),
        action=None if recording.action is None else recording.action @ turn,
        force=None if recording.force is None else recording.force @ turn,
    )


def mirrored(recording: Recording) -> Recording:
    """Backwards in time: what was commanded from a row to the next is undone on the way back."""
    time, action = recording.time.copy(), None if recording.action is None else np.full_like(recording.action, np.nan)
    for run in recording.runs:
        rows = recording.run == run
        time[rows] = recording.time[rows].max() + recording.time[rows].min() - recording.time[rows]
    if action is not None and recording.action is not None:
        for own in _tracks(recording):
            action[own[1:]] = -recording.action[own[:-1]]
    backwards = np.concatenate([np.flatnonzero(recording.run == run)[::-1] for run in recording.runs])
    return replace(recording, time=time, action=action).rows(backwards)


def kept_rows(recording: Recording, begin: float, end: float) -> NDArray[np.bool_]:
    """(n,) rows between two shares of the duration of their run."""
    kept = np.zeros(len(recording), dtype=bool)
    for run in recording.runs:
        rows = recording.run == run
        time = recording.time[rows]
        share = (time - time.min()) / max(float(np.ptp(time)), 1e-12)
        kept[rows] = (share >= begin) & (share <= end)
    return kept


def every_second(recording: Recording) -> Recording:
    """Every second row of each part; an action is what was commanded in both."""
    action = None if recording.action is None else recording.action.copy()
    kept = np.zeros(len(recording), dtype=bool)
    for own in _tracks(recording):
        kept[own[::2]] = True
        if action is not None:
            pairs = own[: len(own) // 2 * 2]
            action[pairs[::2]] += np.nan_to_num(action[pairs[1::2]])
    return replace(recording, action=action).rows(kept)


def noisier(recording: Recording, seed: int = 0) -> Recording:
    """With 1 mm of white noise more."""
    noise = _NOISE * np.random.default_rng([13, seed]).standard_normal(recording.position.shape)
    return replace(recording, position=recording.position + noise)


def _tracks(recording: Recording) -> Iterator[Rows]:
    """Rows of every part of every run, in order of time."""
    part = np.array(recording.part)
    for run in recording.runs:
        for name in recording.parts:
            yield np.flatnonzero((recording.run == run) & (part == name))


def _as_it_was(recording: Recording, graph: KinematicGraph) -> set[Answer]:  # noqa: ARG001
    return {answer_of(graph)}


def _backwards(recording: Recording, graph: KinematicGraph) -> set[Answer]:  # noqa: ARG001
    return {tuple((*one[:3], one[3][::-1]) for one in answer_of(graph))}


def _without(begin: float, end: float) -> Callable[[Recording, KinematicGraph], set[Answer]]:
    """The answers that are right for the rows left: a segment of a few of them may be told or not."""

    def expected(recording: Recording, graph: KinematicGraph) -> set[Answer]:
        kept, part = kept_rows(recording, begin, end), np.array(recording.part)
        found = set()
        for fewest in (1, _CERTAIN_ROWS):
            left = []
            for edge in graph.edges:
                own = kept & (part == edge.child)
                segments = [one for one in edge.segments if own[one.start : one.end + 1].sum() >= fewest]
                left.append(replace(edge, segments=tuple(segments)))
            found.add(answer_of(KinematicGraph(tuple(left))))
        return found

    return expected


Changed = tuple[Callable[[Recording], Recording], Callable[[Recording, KinematicGraph], set[Answer]]]
CHANGES: dict[str, Changed] = {
    "mirrored": (mirrored, _backwards),
    "begin cut": (lambda one: one.rows(kept_rows(one, _CROP, 1.0)), _without(_CROP, 1.0)),
    "end cut": (lambda one: one.rows(kept_rows(one, 0.0, 1.0 - _CROP)), _without(0.0, 1.0 - _CROP)),
    "every 2nd row": (every_second, _as_it_was),
    "1 mm noise": (noisier, _as_it_was),
}
