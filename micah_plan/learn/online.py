"""Learning while rows come in: committed segments that never change, and a window of rows that is looked at again.

While everything fits the window it is learned as a whole run, exactly. The window is full when the part has moved
`WINDOW_SWEEPS` times there and back, or after `settings.window` rows. Then what lies before its middle is committed: a
changepoint there has been looked at from as much of the future as of the past, and more rows would not move it. The
window goes on from the segment that is open there, with the joints of committed segments known and paid for, so a part
that returns to one has the same again. Steps have the size that the window's own motion asks for; where a joint not yet
known moves on through the whole window, the motion is slower than the window is long, and two rows become one.

A row is looked at in a few windows of bounded length, so time per row and memory are constant; only the committed
segments themselves grow, until they are taken.

Learning from a window of rows: the first of a stream as a whole run, later ones with the joints known so far.

The latest rows of a stream, in bounded memory: neighbouring rows become one where a motion is slow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from micah_plan.arrays import Booleans, Ints
from micah_plan.automaton.certainty import ActionChannel, EdgeCertainty, RowPosterior, SegmentCertainty
from micah_plan.automaton.graph import BASE, KinematicEdge, Segment
from micah_plan.automaton.joint import Joint, JointKind
from micah_plan.errors import InputError, shown
from micah_plan.learn.actions.channel import with_delayed_actions
from micah_plan.learn.doubt import doubt_of, misfit_of
from micah_plan.learn.joints.joint_arrays import arrays_of
from micah_plan.learn.run import LearnedRun, fitted_pieces, learn_acted_run
from micah_plan.learn.segmenting.noise import MeasurementNoise
from micah_plan.learn.segmenting.onward import KnownJoints, Usual, segment_onward, usual_of
from micah_plan.learn.segmenting.posterior import kind_probabilities
from micah_plan.learn.segmenting.segmentation import Segmented
from micah_plan.learn.segmenting.steps import steps_of, sweeps_of
from micah_plan.learn.segments import FittedPiece, chained, to_segment
from micah_plan.learn.settings import FEWEST_ROWS, LearnSettings
from micah_plan.learn.track import PartTrack, find_inliers, measured_track
from micah_plan.recording.value import DEFAULT_PART, Recording

Method = Literal["champ", "act-champ"]
METHODS: tuple[Method, ...] = ("champ", "act-champ")

_FIRST_LOOK = 64  # rows
WINDOW_SWEEPS = 4.0  # there and back in a full window
_LOOKS = 8  # a window is looked at again when it has grown by 1/8
_MOST_RESTS, _MOST_MOVING = 16, 8  # known joints; the ones used last are kept


class OnlineLearner:
    """Segments of one part's rows, as they come.

    Args:
        settings: None: the defaults.
        method: Act-CHAMP predicts motion from the actions, CHAMP does not look at them.
        seed: the same seed and rows give the same segments, however the rows are pushed.
        part, run: names of what is learned.
    """

    def __init__(
        self,
        settings: LearnSettings | None = None,
        method: Method = "act-champ",
        seed: int = 0,
        *,
        part: str = DEFAULT_PART,
        run: int = 0,
    ) -> None:
        if method not in METHODS:
            raise InputError(f"method must be among {METHODS}. Got {shown(method)}")
        self.settings, self.method, self.seed = settings or LearnSettings(), method, seed
        self.part, self.run = part, run
        self._window = RowWindow()
        self._rows, self._next_look, self._windows = 0, _FIRST_LOOK, 0
        self._orientation: np.ndarray[tuple[int, ...], np.dtype[np.float64]] | None = None
        self._columns: tuple[bool, bool] | None = None
        self._acts = False
        self._committed: list[Segment] = []
        self._open: Segment | None = None
        self._state: OpenState | None = None
        self._first: LearnedRun | None = None
        self._channel: ActionChannel | None = None
        self._delay = 0.0
        self._seen: tuple[int, LearnedWindow] | None = None
        self._log_evidence = 0.0

    def __len__(self) -> int:
        """How many rows came in."""
        return self._rows

    def push(
        self,
        time: ArrayLike,
        position: ArrayLike,
        quaternion: ArrayLike | None = None,
        action: ArrayLike | None = None,
    ) -> None:
        """Take in k rows, or a single one.

        Args:
            time: (k,) or () [s].
            position: (k, 3) or (3,) [m].
            quaternion: (k, 4) or (4,), scalar last; None if orientation is never measured.
            action: (k, 3) or (3,) [m] in the base frame, NaN where there is none; None if there never is one.

        Raises:
            InputError: shapes that do not fit, or poses that are not finite.
        """
        stamps = np.atleast_1d(np.asarray(time, dtype=float))
        at = np.atleast_2d(np.asarray(position, dtype=float))
        turned, acted = (None if c is None else np.atleast_2d(np.asarray(c, dtype=float)) for c in (quaternion, action))
        self.extend(Recording(stamps, at, turned, acted))

    def extend(self, recording: Recording) -> None:
        """Take in the rows of a recording of one run of one part."""
        if len(set(recording.part)) > 1 or len(recording.runs) > 1:
            raise InputError("an online learner learns one part in one run", remedy="use one learner for each")
        rows = np.arange(self._rows, self._rows + len(recording), dtype=np.int64)
        track = measured_track(recording, rows, np.arange(len(recording)), f"part {shown(self.part)}")
        if recording.action is not None and track.action is None:
            track = replace(track, action=np.zeros((len(track), 3)))
        else:
            self._acts = self._acts or track.action is not None
        self._take(track)

    def take(self, track: PartTrack) -> None:
        """Take in rows that are prepared for learning, with the actions in the part's frame."""
        self._acts = self._acts or track.action is not None
        self._take(track)

    def _take(self, track: PartTrack) -> None:
        if not len(track):
            return
        columns = track.quaternion is not None, track.action is not None
        if self._columns not in (None, columns):
            problem = "rows must have the same columns (orientation, actions) as those before"
            raise InputError(problem, where=f"part {shown(self.part)}", remedy="give NaN where an action is missing")
        self._columns = columns
        if track.quaternion is not None:
            if self._orientation is not None and float(track.quaternion[0] @ self._orientation) < 0:
                track = replace(track, quaternion=-track.quaternion)
            self._orientation = None if track.quaternion is None else track.quaternion[-1]
        at = 0
        while at < len(track):
            count = min(len(track) - at, self._next_look - self._rows)
            self._window.add(track.take(slice(at, at + count)))
            self._rows += count
            at += count
            if self._rows == self._next_look:
                self._look()

    def segments(self) -> tuple[Segment, ...]:
        """All segments as they are most probable now: those committed, and the open ones, which may still change."""
        return (*self._committed, *self._open_segments())

    @property
    def committed(self) -> tuple[Segment, ...]:
        """The segments that will not change any more."""
        return tuple(self._committed)

    def take_committed(self) -> tuple[Segment, ...]:
        """The committed segments, which are forgotten: for streams without an end."""
        found, self._committed = tuple(self._committed), []
        return found

    @property
    def noise(self) -> MeasurementNoise:
        """Of single rows, as the window shows it."""
        window = self._learned()
        if window is None:
            raise InputError(f"learning needs at least {FEWEST_ROWS} rows", remedy="push more rows")
        return window.noise

    def edge(self) -> KinematicEdge:
        """How the part moves, as it is most probable now; without committed segments it is what `learn_graph` finds."""
        segments = self.segments()
        if self._state is None and self._first is not None:
            posterior = self._first.posterior
            counts = (tuple(float(p) for p in posterior.counts),)
            certainty = EdgeCertainty(posterior.log_evidence, counts, self._channel, self._first.trace)
        else:
            evidence = self._log_evidence + sum(segment.log_evidence for segment in self._open_segments())
            certainty = EdgeCertainty(evidence, (), self._channel)
        return KinematicEdge(BASE, self.part, segments, certainty)

    def _open_segments(self) -> list[Segment]:
        """The open segment and what the window adds."""
        window = self._learned()
        if window is None:
            return [] if self._open is None else [self._open]
        return self._continued(window, window.segments(self.run))[0]

    def _continued(self, window: LearnedWindow, found: list[Segment]) -> tuple[list[Segment], bool]:
        """A window's segments after the open one, and whether the first is its continuation."""
        if self._open is None or self._state is None or not found:
            return found, False
        if self._state.before is not None and window.known[0] is self._state.before:
            return [joined(self._open, found[0]), *found[1:]], True
        return [self._open, *found], False

    def _learned(self) -> LearnedWindow | None:
        """The window as it is segmented now."""
        if self._seen is not None and self._seen[0] == self._rows:
            return self._seen[1]
        rows = self._window.rows()
        if rows is None or len(rows) < FEWEST_ROWS:
            if self._state is None:
                problem = f"learning needs at least {FEWEST_ROWS} rows, found {self._rows}"
                raise InputError(problem, where=f"part {shown(self.part)}", remedy="push more rows")
            return None
        key = [self.seed, self.run] if self._state is None else [self.seed, self.run, self._windows]
        rng = np.random.default_rng(key)
        if not self._acts or self.method == "champ":
            rows = WindowRows(replace(rows.track, action=None), rows.last)
        if self._state is None:
            learned = self._learned_first(rows, rng)
        else:
            if self._delay:
                rows = WindowRows(with_delayed_actions(rows.track, self._delay), rows.last)
            learned = learn_onward(rows, self._state, self.settings, rng)
        self._seen = self._rows, learned
        return learned

    def _learned_first(self, rows: WindowRows, rng: np.random.Generator) -> LearnedWindow:
        self._first, self._channel = learn_acted_run(rows.track, self.settings, rng)
        moved = self._first.track is not rows.track and self._channel is not None
        self._delay = self._channel.delay if moved and self._channel is not None else 0.0
        return first_window(WindowRows(self._first.track, rows.last), self._first)

    def _look(self) -> None:
        """Whether the window is full."""
        rows = self._window.settle()
        if rows is None:
            return
        crowded = len(rows) >= self.settings.window
        if crowded or sweeps_of(rows.track.take(np.flatnonzero(find_inliers(rows.track)))) >= WINDOW_SWEEPS:
            self._commit(crowded)
        rows = self._window.rows()
        held = 0 if rows is None else len(rows)
        more = max(held // _LOOKS, min(_FIRST_LOOK, self.settings.window // _LOOKS), 1)
        self._next_look = self._rows + min(more, max(self.settings.window - held, 1)) * self._window.stride

    def _commit(self, crowded: bool) -> None:
        """Commit what lies before the middle of the window, or make the window coarser."""
        window = self._learned()
        if window is None:
            return
        n = len(window.rows)
        middle = next(i for i, piece in enumerate(window.pieces) if piece.end >= n // 2)
        piece, sure = window.pieces[middle], window.certainties[middle]
        unknown = window.known[middle] is None and sure.misfit is None and piece.joint.moves
        fine = self.settings.resolution * WINDOW_SWEEPS
        if crowded and unknown and middle == len(window.pieces) - 1 and window.steps < fine:
            self._window.coarsen()
            return
        middle, cut = _cut(window, middle)
        found = window.segments(self.run, cut)
        joints = self._known_after(window, middle + 1)
        row = int(window.rows.track.rows[cut])
        start = window.certainties[middle].start if cut == window.pieces[middle].start else RowPosterior((row,), (1.0,))
        segments, _ = self._continued(window, found)
        self._committed += segments[:-1]
        self._log_evidence += sum(segment.log_evidence for segment in segments[:-1])
        self._open = segments[-1]
        self._state = self._state_after(window, joints, len(found), start)
        self._first, self._seen = None, None
        self._windows += 1
        self._window.drop(cut)

    def _known_after(self, window: LearnedWindow, count: int) -> list[KnownJoint | None]:
        """The known joints of the first pieces; new ones become known, but for those that do not fit."""
        new: dict[int, KnownJoint] = {}
        found: list[KnownJoint | None] = []
        for i in range(count):
            same, sure = window.known[i], window.certainties[i]
            if same is None and sure.misfit is None:
                same = new.setdefault(window.sharing[i], KnownJoint(window.pieces[i].joint, sure.kinds))
            found.append(same)
        return found

    def _state_after(
        self,
        window: LearnedWindow,
        joints: list[KnownJoint | None],
        count: int,
        start: RowPosterior | None,
    ) -> OpenState:
        state = self._state
        mover = None if state is None else state.last_moving
        for one in joints[:count]:
            if one is not None and one.joint.moves:
                mover = one
        known = [] if state is None else list(state.known)
        for one in joints:
            if one is not None:
                known = [other for other in known if other is not one] + [one]
        rests = [one for one in known if not one.joint.moves][-_MOST_RESTS:]
        moving = [one for one in known if one.joint.moves][-_MOST_MOVING:]
        usual = window.usual if state is None else _looser(state.usual, window.usual)
        reached = 0.0 if self._open is None else self._open.configuration_end
        return OpenState(
            known=tuple(one for one in known if one in rests or one in moving),
            before=joints[count - 1],
            first=joints[-1],
            last_moving=mover,
            reached=reached,
            start=start,
            usual=usual or Usual(np.ones(3 if window.rows.track.quaternion is None else 6), 0.0),
        )


def _cut(window: LearnedWindow, middle: int) -> tuple[int, int]:
    """The piece from which the next window goes on, and its first row there.

    At best a motion begins there: the rows of a part that rests do not tell whether its joint has moved before.
    """
    n = len(window.rows)
    begins = [i for i, piece in enumerate(window.pieces) if n // 4 <= piece.start <= n // 2]
    moving = [i for i in begins if window.pieces[i].joint.moves]
    chosen = max(moving or begins, default=None)
    return (middle, n // 2) if chosen is None else (chosen, window.pieces[chosen].start)


def joined(first: Segment, second: Segment) -> Segment:
    """Two neighbouring segments of one joint as one."""
    rows = np.array([one.end - one.start + 1.0 for one in (first, second)])
    turns = first.configuration_end - second.configuration_start
    turn = 2 * np.pi * round(turns / (2 * np.pi)) if first.joint.kind == "revolute" else 0.0

    def root_mean_square(name: str) -> float:
        values = np.array([getattr(first, name), getattr(second, name)])
        return float(np.sqrt((rows @ values**2) / rows.sum()))

    low, high = second.configuration_range
    return replace(
        first,
        end=second.end,
        configuration_end=second.configuration_end + turn,
        configuration_range=(
            min(first.configuration_range[0], low + turn),
            max(first.configuration_range[1], high + turn),
        ),
        process_std=root_mean_square("process_std"),
        observation_std=root_mean_square("observation_std"),
        log_evidence=first.log_evidence + second.log_evidence,
    )


def _looser(first: Usual, second: Usual | None) -> Usual:
    """The larger of two thresholds: rows that a search has explained without a new joint start no other search."""
    if second is None:
        return first
    return Usual(np.maximum(first.scale, second.scale), max(first.surprise, second.surprise))


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
            kinds = kind_probabilities(found, piece.hypothesis, settings.kinds, free, one.doubts)
        else:
            kinds = same.kinds
        certainties.append(SegmentCertainty(place, kinds, misfit, one.doubts.deviation))
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


@dataclass(frozen=True, eq=False)
class WindowRows:
    """Rows of a window, each the mean of a few measured ones, of which `last` (n,) has the last ones' numbers."""

    track: PartTrack
    last: Ints

    def __len__(self) -> int:
        return len(self.track)

    def take(self, index: slice) -> WindowRows:
        """Some of the rows."""
        return WindowRows(self.track.take(index), self.last[index])

    def coarsened(self, size: int) -> WindowRows:
        """Means of `size` rows each."""
        ends = np.minimum(np.arange(size, len(self) + size, size), len(self)) - 1
        return WindowRows(self.track.coarsened(size), self.last[ends])

    def followed_by(self, other: WindowRows) -> WindowRows:
        """These rows and later ones."""
        return WindowRows(self.track.followed_by(other.track), np.concatenate([self.last, other.last]))


class RowWindow:
    """Rows that came in and have not been dropped.

    Attributes:
        stride: measured rows that one row of the window stands for.
    """

    def __init__(self) -> None:
        self.stride = 1
        self._rows: WindowRows | None = None
        self._new: list[WindowRows] = []

    def add(self, track: PartTrack) -> None:
        """Take in measured rows."""
        self._new.append(WindowRows(track, track.rows))

    def rows(self) -> WindowRows | None:
        """What the window holds; None if nothing."""
        new = _joined(self._new)
        if new is None:
            return self._rows
        if self.stride > 1:
            new = new.coarsened(self.stride)
        return new if self._rows is None else self._rows.followed_by(new)

    def settle(self) -> WindowRows | None:
        """The same, and from now on measured rows begin a new row of the window."""
        self._rows, self._new = self.rows(), []
        return self._rows

    def coarsen(self) -> None:
        """Make one row of every two."""
        rows = self.settle()
        self._rows = None if rows is None else rows.coarsened(2)
        self.stride *= 2

    def drop(self, count: int) -> None:
        """Forget the first rows."""
        rows = self.settle()
        if rows is not None:
            kept = rows.take(slice(count, None))
            # Copies, so that what was dropped is not held by a view of it.
            self._rows = WindowRows(_copied(kept.track), kept.last.copy())


def _joined(parts: list[WindowRows]) -> WindowRows | None:
    """All parts at once: joining one by one would copy each row as often as there are parts."""
    if not parts:
        return None
    tracks = [part.track for part in parts]
    first = tracks[0]

    def column(name: str) -> NDArray[np.float64] | None:
        return None if getattr(first, name) is None else np.concatenate([getattr(one, name) for one in tracks])

    rows = np.concatenate([one.rows for one in tracks])
    time = np.concatenate([one.time for one in tracks])
    position = np.concatenate([one.position for one in tracks])
    track = PartTrack(rows, time, position, column("quaternion"), column("action"))
    return WindowRows(track, np.concatenate([part.last for part in parts]))


def _copied(track: PartTrack) -> PartTrack:
    columns = {name: getattr(track, name) for name in ("rows", "time", "position", "quaternion", "action")}
    return replace(track, **{name: value.copy() for name, value in columns.items() if value is not None})
