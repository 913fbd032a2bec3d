"""Learning from a window of rows: the first of a stream as a whole run, later ones with the joints known so far."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from micah_plan.arrays import Booleans
from micah_plan.automaton.certainty import RowPosterior, SegmentCertainty
from micah_plan.automaton.graph import Segment
from micah_plan.automaton.joint import Joint, JointKind
from micah_plan.learn.doubt import doubt_of, misfit_of
from micah_plan.learn.joints.joint_arrays import arrays_of
from micah_plan.learn.row_window import WindowRows
from micah_plan.learn.run import LearnedRun, fitted_pieces
from micah_plan.learn.segmenting.noise import MeasurementNoise
from micah_plan.learn.segmenting.onward import KnownJoints, Usual, segment_onward, usual_of
from micah_plan.learn.segmenting.segmented import Segmented
from micah_plan.learn.segmenting.stating import kind_probabilities
from micah_plan.learn.segmenting.steps import steps_of
from micah_plan.learn.segments import FittedPiece, chained, to_segment
from micah_plan.learn.settings import LearnSettings
from micah_plan.learn.track import find_inliers

Kinds = tuple[tuple[JointKind, float], ...]


@dataclass(frozen=True, eq=False)
class KnownJoint:
    """A joint of committed segments, on the coordinate of its edge.

    Attributes:
        joint: as it was fitted when it was first committed.
        kinds: how sure its kind was.
    """

    joint: Joint
    kinds: Kinds


@dataclass(frozen=True, eq=False)
class OpenState:
    """Where a window begins.

    Attributes:
        known: joints of committed segments, at least one.
        before: what holds before the window's first row; None if that is no known joint.
        first: what was found to hold from that row on, with the rows before it in view; None if that is no known joint.
        last_moving: the latest known joint that is not rigid.
        reached: configuration there.
        start: posterior of the row at which a segment starts that begins where the window does.
        usual: how well known joints explain steps.
    """

    known: tuple[KnownJoint, ...]
    before: KnownJoint | None
    first: KnownJoint | None
    last_moving: KnownJoint | None
    reached: float
    start: RowPosterior | None
    usual: Usual

    def pieces(self) -> list[FittedPiece]:
        """The joints before the window, for the joints of the window to be chained to."""
        found = [one for one in (self.last_moving, self.before) if one is not None]
        joints = [one.joint for one in dict.fromkeys(found)]
        return [FittedPiece(-1, -1, joint, np.zeros(3), None, 0.0, settled=True) for joint in joints]


@dataclass(frozen=True, eq=False)
class LearnedWindow:
    """The segments of a window.

    Attributes:
        rows, inlier: its rows, and which are no outliers.
        before, pieces: joints before it, and its own, on one coordinate.
        certainties: how sure the pieces are.
        known: the known joint of each piece, None for a new one.
        sharing: equal for pieces that share a joint.
        noise: of single rows.
        usual: how well its joints explain its steps; None where nothing was searched.
        steps: number of steps that it was segmented in.
    """

    rows: WindowRows
    inlier: Booleans
    before: tuple[FittedPiece, ...]
    pieces: tuple[FittedPiece, ...]
    certainties: tuple[SegmentCertainty, ...]
    known: tuple[KnownJoint | None, ...]
    sharing: tuple[int, ...]
    noise: MeasurementNoise
    usual: Usual | None
    steps: int

    def segments(self, run: int, end: int | None = None) -> list[Segment]:
        """Segments of its rows, or of those before `end`."""
        found: list[Segment] = []
        chain = [*self.before, *self.pieces]
        for i, (piece, sure) in enumerate(zip(self.pieces, self.certainties, strict=True)):
            if end is not None and piece.start >= end:
                break
            if end is not None and piece.end >= end:
                share = (end - piece.start) / (piece.end - piece.start + 1)
                piece = replace(piece, end=end - 1, log_evidence=piece.log_evidence * share)
                chain[len(self.before) + i] = piece
            one = to_segment(piece, chain, sure, run, self.rows.track, self.inlier, self.noise)
            found.append(replace(one, end=int(self.rows.last[piece.end])))
        return found


def first_window(rows: WindowRows, learned: LearnedRun) -> LearnedWindow:
    """The first window of a stream, learned as a run of its own."""
    return LearnedWindow(
        rows=rows,
        inlier=learned.inlier,
        before=(),
        pieces=learned.pieces,
        certainties=learned.certainties,
        known=(None,) * len(learned.pieces),
        sharing=learned.hypotheses,
        noise=learned.noise,
        usual=usual_of(learned.segmented),
        steps=len(learned.segmented.track),
    )


def learn_onward(
    rows: WindowRows, state: OpenState, settings: LearnSettings, rng: np.random.Generator
) -> LearnedWindow:
    """Segment a window that goes on from earlier ones."""
    track = rows.track
    inlier = find_inliers(track)
    steps = steps_of(track, inlier, settings)
    first = -1 if state.first is None else state.known.index(state.first)
    known = KnownJoints(arrays_of([one.joint for one in state.known]), first, state.usual)
    found, fresh = segment_onward(steps.track, known, steps.assumed(settings), rng)
    noise = found.noise.of_rows(steps.size)
    settled: Sequence[KnownJoint] = state.known
    free, misfit = -np.inf, None

    def fitted_to(answer: Segmented) -> tuple[list[FittedPiece], list[RowPosterior | None]]:
        joints = [one.joint for one in settled]
        pieces = answer.segmentation.pieces
        return fitted_pieces(pieces, answer, steps, track, inlier, settings, rng, joints)

    fitted, places = fitted_to(found)
    if fresh is not None:
        # A window is no place to look for a curve that is passed again.
        doubt = doubt_of(fresh, fitted, track, inlier, noise, replace(settings, paths=False))
        free = -np.inf if doubt is None else doubt.log_odds
        if doubt is not None and doubt.single is not None:
            found, settled = doubt.single, ()
            fitted, places = fitted_to(found)
            if doubt.moves_freely:
                misfit = misfit_of(fitted, track, inlier, noise, settings, free)
    pieces = found.segmentation.pieces
    before = state.pieces()
    certainties, of_piece = [], []
    for piece, one, place in zip(pieces, fitted, [state.start, *places[1:]], strict=True):
        same = settled[piece.hypothesis] if piece.hypothesis < len(settled) else None
        if same is None:
            kinds = kind_probabilities(found, piece.hypothesis, settings.kinds, free, one.screw_log_odds)
        else:
            kinds = same.kinds
        certainties.append(SegmentCertainty(place, kinds, misfit))
        of_piece.append(same)
    return LearnedWindow(
        rows=rows,
        inlier=inlier,
        before=tuple(before),
        pieces=tuple(chained(fitted, track, inlier, noise, before, state.reached)),
        certainties=tuple(certainties),
        known=tuple(of_piece),
        sharing=tuple(piece.hypothesis for piece in pieces),
        noise=noise,
        usual=None if fresh is None or misfit is not None else usual_of(found),
        steps=len(steps.track),
    )
