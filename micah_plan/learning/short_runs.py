"""Short runs of one part, learned jointly as demonstrations of one object.

A run in which the part moves for two rows shows no joint; all of them one after another may. The learner treats them as
one run in which the tracker slips wherever a run begins, which is no changepoint. The result is cut into runs again.

Whether a part moves enough to identify its joint: motions hardly larger than the assumed wander of a tracker.

A slow deviation of the size of the wander is forgiven, so that the error of a tracker is no motion. On an object of a
centimetre that forgives the motion: a stop, or the bend of a path, passes for wander unless the wander is set smaller.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from micah_plan.automaton.certainty import SegmentCertainty
from micah_plan.learning.segments import FittedPiece
from micah_plan.learning.track import PartTrack

Sliced = tuple[FittedPiece, SegmentCertainty, int]


def one_after_another(tracks: Sequence[PartTrack]) -> PartTrack:
    """The concatenated rows of runs, with gaps as long as their rows are apart.

    If only some of the runs have actions, the command in the others is zero.
    """
    acted = any(track.action is not None for track in tracks)
    joined: PartTrack | None = None
    for track in tracks:
        action = np.zeros_like(track.position) if acted and track.action is None else track.action
        track = replace(track, action=action)
        if joined is None:
            joined = track
            continue
        apart = float(np.median(np.diff(track.time)))
        quaternion = track.quaternion
        if quaternion is not None and joined.quaternion is not None and quaternion[0] @ joined.quaternion[-1] < 0:
            quaternion = -quaternion
        time = track.time - track.time[0] + joined.time[-1] + apart
        joined = joined.followed_by(replace(track, time=time, quaternion=quaternion))
    if joined is None:
        raise ValueError("one_after_another needs at least one track")
    return joined


def cut_into_runs(
    pieces: Sequence[FittedPiece], certainties: Sequence[SegmentCertainty], lengths: Sequence[int]
) -> list[Sliced]:
    """Pieces of concatenated runs cut at run boundaries, each with its certainty and run index.

    Args:
        lengths: rows of every run.
    """
    starts = np.concatenate([[0], np.cumsum(lengths)]).tolist()
    sliced: list[Sliced] = []
    for piece, sure in zip(pieces, certainties, strict=True):
        rows = piece.end - piece.start + 1
        for run, (first, after) in enumerate(pairwise(starts)):
            start, end = max(piece.start, first), min(piece.end, after - 1)
            if start > end:
                continue
            # No changepoint is where a run begins: the piece only goes on.
            place = sure if start == piece.start else replace(sure, start=None)
            share = piece.log_evidence * (end - start + 1) / rows
            sliced.append((replace(piece, start=start, end=end, log_evidence=share), place, run))
    return sorted(sliced, key=lambda piece: piece[0].start)
