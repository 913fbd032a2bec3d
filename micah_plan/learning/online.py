"""Windowed learning: long recordings, and rows that arrive one by one.

A window is treated as a run: it is learned as `learning.run` learns a recording. It is full when the part has moved
`WINDOW_SWEEPS` times there and back, or after `settings.window` rows. All before its last quarter is then committed: a
changepoint there has been seen with a motion there and back after it. The next window begins where a motion does, or
within one where there is no such place. Where a known joint explains rows as well as the window's, it takes its place,
on its coordinate: a part that returns to a joint has the same one again.

Where a new joint moves on through all `settings.window` rows, two rows become one. A row is looked at in a few windows
of bounded length, so time per row and memory are constant; only the committed segments grow, until they are taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from micah_plan.arrays import Floats, Ints
from micah_plan.automaton.certainty import ActionChannel, EdgeCertainty, RowPosterior
from micah_plan.automaton.graph import BASE, KinematicEdge, Segment
from micah_plan.automaton.joint import Joint
from micah_plan.errors import InputError, shown
from micah_plan.learning.acted_run import learn_acted_run
from micah_plan.learning.actions.command_path import with_delayed_actions
from micah_plan.learning.run import LearnedRun, learn_run
from micah_plan.learning.segmenting.noise import MeasurementNoise
from micah_plan.learning.segmenting.steps import is_long
from micah_plan.learning.segments import FittedPiece, chained, left_by, to_segment
from micah_plan.learning.settings import FEWEST_ROWS, LearnSettings
from micah_plan.learning.track import PartTrack, find_inliers, measured_track
from micah_plan.recording.value import DEFAULT_PART, Recording

Method = Literal["champ", "act-champ"]
METHODS: tuple[Method, ...] = ("champ", "act-champ")

_FIRST_LOOK = 64  # rows
_COMMITTED = 0.75  # of a full window, at most
_LOOKS = 8  # a window is looked at again when it has grown by 1/8
_MOST_KNOWN = 24  # joints; the ones used last are kept


class OnlineLearner:
    """Learns the segments of one part from rows as they arrive.

    Args:
        settings: None: the defaults.
        method: Act-CHAMP predicts motion from the actions, CHAMP does not look at them.
        part, run: names.
    """

    def __init__(
        self,
        settings: LearnSettings | None = None,
        method: Method = "act-champ",
        *,
        part: str = DEFAULT_PART,
        run: int = 0,
    ) -> None:
        if method not in METHODS:
            raise InputError(f"method must be among {METHODS}. Got {shown(method)}")
        self.settings, self.method = settings or LearnSettings(), method
        self.part, self.run = part, run
        self._window = RowWindow()
        self._rows, self._next_look, self._windows = 0, _FIRST_LOOK, 0
        self._orientation: np.ndarray[tuple[int, ...], np.dtype[np.float64]] | None = None
        self._columns: tuple[bool, bool] | None = None
        self._acts = False
        self._committed: list[Segment] = []
        self._open: Segment | None = None
        self._entry: Entry | None = None
        self._channel: ActionChannel | None = None
        self._delay = 0.0
        self._latest: tuple[int, LearnedWindow] | None = None
        self._log_evidence = 0.0

    def __len__(self) -> int:
        """Number of rows received."""
        return self._rows

    def push(
        self,
        time: ArrayLike,
        position: ArrayLike,
        quaternion: ArrayLike | None = None,
        action: ArrayLike | None = None,
    ) -> None:
        """Process k rows, or a single one.

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
        """Process the rows of a recording of one run of one part."""
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
        """Process prepared rows, with actions in the part's frame."""
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
                self._check_window()

    def segments(self) -> tuple[Segment, ...]:
        """All segments as presently most probable: the committed ones, and the open ones, which may still change."""
        return (*self._committed, *self._open_segments())

    @property
    def committed(self) -> tuple[Segment, ...]:
        """The final segments."""
        return tuple(self._committed)

    def take_committed(self) -> tuple[Segment, ...]:
        """The final segments, which are removed: for unbounded streams."""
        committed, self._committed = tuple(self._committed), []
        return committed

    @property
    def noise(self) -> MeasurementNoise:
        """Noise of single rows, from the present window."""
        window = self._learned()
        if window is None:
            raise InputError(f"learning needs at least {FEWEST_ROWS} rows", remedy="push more rows")
        return window.run.noise

    def edge(self) -> KinematicEdge:
        """The edge as presently most probable; without committed segments it equals the result of `learn_graph`."""
        segments, window = self.segments(), self._learned()
        if self._entry is None and window is not None:
            posterior = window.run.posterior
            counts = (tuple(float(p) for p in posterior.counts),)
            certainty = EdgeCertainty(posterior.log_evidence, counts, self._channel, window.run.trace)
        else:
            evidence = 0.0 if window is None else window.run.posterior.log_evidence
            certainty = EdgeCertainty(self._log_evidence + evidence, (), self._channel)
        return KinematicEdge(BASE, self.part, segments, certainty)

    def _open_segments(self) -> list[Segment]:
        """The open segment continued by those of the window."""
        window = self._learned()
        if window is None:
            return [] if self._open is None else [self._open]
        return self._after_open(window, window.segments(self.run))

    def _after_open(self, window: LearnedWindow, segments: list[Segment]) -> list[Segment]:
        """A window's segments after the open one, which the first of them may continue."""
        if self._open is None or self._entry is None or not segments:
            return segments
        first, before = window.pieces[0].joint, self._entry.before[-1].joint
        goes_on = first.kind == before.kind and (first == before or self._entry.within)
        return [joined_segments(self._open, segments[0]), *segments[1:]] if goes_on else [self._open, *segments]

    def _learned(self) -> LearnedWindow | None:
        """The segmentation of the present window."""
        if self._latest is not None and self._latest[0] == self._rows:
            return self._latest[1]
        rows = self._window.rows()
        if rows is None or len(rows) < FEWEST_ROWS:
            if self._entry is None:
                problem = f"learning needs at least {FEWEST_ROWS} rows, found {self._rows}"
                raise InputError(problem, where=f"part {shown(self.part)}", remedy="push more rows")
            return None
        if not self._acts or self.method == "champ":
            rows = WindowRows(replace(rows.track, action=None), rows.last)
        if self._entry is None:
            run, self._channel = learn_acted_run(rows.track, self.settings)
            self._delay = 0.0 if run.track is rows.track or self._channel is None else self._channel.delay
            window = LearnedWindow(run, run.pieces, (), rows.last)
        else:
            track = with_delayed_actions(rows.track, self._delay) if self._delay else rows.track
            # No joint that is known becomes a curve.
            curved = self.settings.paths and any(joint.kind == "path" for joint in self._entry.known)
            settings = replace(self.settings, paths=curved)
            run = learn_run(track, settings)
            window = self._entry.continued_by(run, rows.last, self.settings)
        self._latest = self._rows, window
        return window

    def _check_window(self) -> None:
        """Check whether the window is full."""
        rows = self._window.close_open_row()
        if rows is None:
            return
        full = is_long(rows.track, find_inliers(rows.track))
        if full or len(rows) >= self.settings.window:
            self._commit(full)
        rows = self._window.rows()
        held = 0 if rows is None else len(rows)
        more = max(held // _LOOKS, min(_FIRST_LOOK, self.settings.window // _LOOKS), 1)
        self._next_look = self._rows + min(more, max(self.settings.window - held, 1)) * self._window.stride

    def _commit(self, full: bool) -> None:
        """Commit the segments before the last quarter of the window, or make the window coarser."""
        window = self._learned()
        if window is None:
            return
        middle, cut = window.cut()
        piece = window.pieces[middle]
        if not full and middle == len(window.pieces) - 1 and window.is_new(middle):
            self._window.coarsen()
            return
        start = window.run.certainties[middle].start if cut == piece.start else None
        segments = self._after_open(window, window.segments(self.run, cut))
        self._committed += segments[:-1]
        self._log_evidence += window.run.posterior.log_evidence * cut / len(window.last)
        self._open = segments[-1]
        joints = () if self._entry is None else self._entry.known
        self._entry = Entry.after(window, middle, cut, joints, start, self._open.configuration_end)
        self._latest = None
        self._windows += 1
        self._window.drop(cut)


@dataclass(frozen=True, eq=False)
class Entry:
    """Boundary conditions at the start of a window.

    Attributes:
        known: joints of committed segments, on the coordinate of the edge, the latest ones last.
        before: the pieces whose joints are the last moving one, and the one that holds before the window.
        within: whether the window begins within the segment before it.
        reached: configuration there.
        start: posterior of the start row of a segment that begins where the window does; None: undetermined.
    """

    known: tuple[Joint, ...]
    before: tuple[FittedPiece, ...]
    within: bool
    reached: float
    start: RowPosterior | None

    @classmethod
    def after(
        cls,
        window: LearnedWindow,
        middle: int,
        cut: int,
        joints: Sequence[Joint],
        start: RowPosterior | None,
        reached: float,
    ) -> Entry:
        """The boundary conditions of the window that starts in row `cut`, within piece `middle`, of another one."""
        within = cut > window.pieces[middle].start
        ended = [*window.before, *window.pieces[: middle + within]]
        moving = next((piece for piece in reversed(ended) if piece.joint.moves), None)
        before = [piece for piece in (moving, ended[-1]) if piece is not None]
        new = [
            piece.joint
            for piece, certainty in zip(window.pieces, window.run.certainties, strict=True)
            if certainty.no_single_joint is None and piece.start <= cut
        ]
        latest = list(dict.fromkeys([*new[::-1], *joints[::-1]]))[:_MOST_KNOWN][::-1]
        return cls(tuple(latest), tuple(replace(piece, settled=True) for piece in before), within, reached, start)

    def continued_by(self, run: LearnedRun, last: Ints, settings: LearnSettings) -> LearnedWindow:
        """A window that starts here, with known joints replacing new ones that explain the rows no better."""
        same: dict[int, Joint | None] = {}
        for hypothesis in dict.fromkeys(run.hypotheses):
            pieces_of_joint = [piece for piece, of in zip(run.pieces, run.hypotheses, strict=True) if of == hypothesis]
            rows = np.concatenate([piece.index(run.inlier) for piece in pieces_of_joint])
            same[hypothesis] = self._matching_known_joint(pieces_of_joint[0].joint, rows, run, settings)
        pieces = []
        for piece, hypothesis in zip(run.pieces, run.hypotheses, strict=True):
            joint = same[hypothesis]
            pieces.append(piece if joint is None else replace(piece, joint=joint, settled=True))
        on_edge = chained(pieces, run.track, run.inlier, run.noise, self.before, self.reached)
        certainties = (replace(run.certainties[0], start=self.start), *run.certainties[1:])
        return LearnedWindow(replace(run, certainties=certainties), tuple(on_edge), self.before, last)

    def _matching_known_joint(self, joint: Joint, rows: Ints, run: LearnedRun, settings: LearnSettings) -> Joint | None:
        """The known joint closest to the rows, if within the usual deviation of joints of one kind."""
        deviation = np.array([settings.rotation_misfit, settings.position_misfit])
        deviation = deviation[-1:] if run.track.quaternion is None else deviation

        def missed(candidate: Joint) -> Floats:
            errors = left_by(candidate, rows, run.track, run.noise.rotation_length)
            return np.asarray((errors.reshape(len(errors), -1, 3) ** 2).sum(axis=2).mean(axis=0))

        least = missed(joint)
        # Where the part moves freely its joint is meaningless.
        able = () if run.certainties[0].no_single_joint else self.known
        candidates = [candidate for candidate in able if candidate.kind == joint.kind]
        excess = [float(((missed(candidate) - least) / deviation**2).max()) for candidate in candidates]
        return candidates[int(np.argmin(excess))] if min(excess, default=np.inf) <= 1.0 else None


@dataclass(frozen=True, eq=False)
class LearnedWindow:
    """A window, learned as a run.

    Attributes:
        run: result for its rows.
        pieces: of the run, on the coordinate of the edge; known joints are `settled`.
        before: pieces of the windows before.
        last: (n,) number of the last measured row that each row stands for.
    """

    run: LearnedRun
    pieces: tuple[FittedPiece, ...]
    before: tuple[FittedPiece, ...]
    last: Ints

    def is_new(self, index: int) -> bool:
        """Whether a piece is on a new moving joint."""
        piece = self.pieces[index]
        return piece.joint.moves and not piece.settled and self.run.certainties[index].no_single_joint is None

    def cut(self) -> tuple[int, int]:
        """(piece in which the next window starts, its first row).

        Ideally a motion begins there: the rows of a part at rest do not show whether its joint has moved before.
        """
        n = len(self.last)
        latest = round(_COMMITTED * n)
        begins = [i for i, piece in enumerate(self.pieces) if latest - n // 4 <= piece.start <= latest]
        moving = [i for i in begins if self.pieces[i].joint.moves]
        chosen = max(moving or begins, default=None)
        if chosen is not None:
            return chosen, self.pieces[chosen].start
        return next(i for i, piece in enumerate(self.pieces) if piece.end >= latest), latest

    def segments(self, number: int, end: int | None = None) -> list[Segment]:
        """The segments of the window's rows, or of those before `end`, for run `number`."""
        segments: list[Segment] = []
        chain = [*self.before, *self.pieces]
        for i, (piece, sure) in enumerate(zip(self.pieces, self.run.certainties, strict=True)):
            if end is not None and piece.start >= end:
                break
            if end is not None and piece.end >= end:
                share = (end - piece.start) / (piece.end - piece.start + 1)
                piece = replace(piece, end=end - 1, log_evidence=piece.log_evidence * share)
                chain[len(self.before) + i] = piece
            segment = to_segment(piece, chain, sure, number, self.run.track, self.run.inlier, self.run.noise)
            segments.append(replace(segment, end=int(self.last[piece.end])))
        return segments


def joined_segments(first: Segment, second: Segment) -> Segment:
    """Two neighbouring segments of one joint as one."""
    rows = np.array([segment.end - segment.start + 1.0 for segment in (first, second)])
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


@dataclass(frozen=True, eq=False)
class WindowRows:
    """Rows of a window, each the mean of several measured ones; `last` (n,) are the numbers of the last of each."""

    track: PartTrack
    last: Ints

    def __len__(self) -> int:
        return len(self.track)

    def take(self, index: slice) -> WindowRows:
        """The rows with these indices."""
        return WindowRows(self.track.take(index), self.last[index])

    def coarsened(self, size: int) -> WindowRows:
        """Means of `size` rows each."""
        ends = np.minimum(np.arange(size, len(self) + size, size), len(self)) - 1
        return WindowRows(self.track.coarsened(size), self.last[ends])

    def followed_by(self, later: WindowRows) -> WindowRows:
        """These rows followed by later ones."""
        return WindowRows(self.track.followed_by(later.track), np.concatenate([self.last, later.last]))


class RowWindow:
    """Rows that were received and are still held.

    Attributes:
        stride: measured rows that one row of the window stands for.
    """

    def __init__(self) -> None:
        self.stride = 1
        self._rows: WindowRows | None = None
        self._new: list[WindowRows] = []

    def add(self, track: PartTrack) -> None:
        """Add measured rows."""
        self._new.append(WindowRows(track, track.rows))

    def rows(self) -> WindowRows | None:
        """The rows of the window; None if there are none."""
        new = _joined(self._new)
        if new is None:
            return self._rows
        if self.stride > 1:
            new = new.coarsened(self.stride)
        return new if self._rows is None else self._rows.followed_by(new)

    def close_open_row(self) -> WindowRows | None:
        """Return the rows; later measured rows start a new row of the window."""
        self._rows, self._new = self.rows(), []
        return self._rows

    def coarsen(self) -> None:
        """Average pairs of rows."""
        rows = self.close_open_row()
        self._rows = None if rows is None else rows.coarsened(2)
        self.stride *= 2

    def drop(self, count: int) -> None:
        """Remove the first rows."""
        rows = self.close_open_row()
        if rows is not None:
            kept = rows.take(slice(count, None))
            # Copies, so that what was dropped is not held by a view of it.
            self._rows = WindowRows(_copied(kept.track), kept.last.copy())


def _joined(parts: list[WindowRows]) -> WindowRows | None:
    """The concatenation of all parts at once, since pairwise joins would copy quadratically."""
    if not parts:
        return None
    tracks = [part.track for part in parts]
    first = tracks[0]

    def column(name: str) -> NDArray[np.float64] | None:
        return None if getattr(first, name) is None else np.concatenate([getattr(track, name) for track in tracks])

    rows = np.concatenate([track.rows for track in tracks])
    time = np.concatenate([track.time for track in tracks])
    position = np.concatenate([track.position for track in tracks])
    track = PartTrack(rows, time, position, column("quaternion"), column("action"), first.meaning)
    return WindowRows(track, np.concatenate([part.last for part in parts]))


def _copied(track: PartTrack) -> PartTrack:
    columns = {name: getattr(track, name) for name in ("rows", "time", "position", "quaternion", "action")}
    return replace(track, **{name: value.copy() for name, value in columns.items() if value is not None})
