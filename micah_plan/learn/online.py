"""Learning while rows come in: committed segments that never change, and a window of rows that is looked at again.

While everything fits the window it is learned as a whole run, exactly. The window is full when the part has moved
`WINDOW_SWEEPS` times there and back, or after `settings.window` rows. Then what lies before its middle is committed: a
changepoint there has been looked at from as much of the future as of the past, and more rows would not move it. The
window goes on from the segment that is open there, with the joints of committed segments known and paid for, so a part
that returns to one has the same again. Steps have the size that the window's own motion asks for; where a joint not yet
known moves on through the whole window, the motion is slower than the window is long, and two rows become one.

A row is looked at in a few windows of bounded length, so time per row and memory are constant; only the committed
segments themselves grow, until they are taken.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from micah_plan.automaton.certainty import ActionChannel, EdgeCertainty, RowPosterior
from micah_plan.automaton.graph import BASE, KinematicEdge, Segment
from micah_plan.errors import InputError, shown
from micah_plan.learn.acted import learn_acted_run
from micah_plan.learn.actions.channel import with_delayed_actions
from micah_plan.learn.onward_run import KnownJoint, LearnedWindow, OpenState, first_window, learn_onward
from micah_plan.learn.row_window import RowWindow, WindowRows
from micah_plan.learn.run import LearnedRun
from micah_plan.learn.segmenting.noise import MeasurementNoise
from micah_plan.learn.segmenting.onward import Usual
from micah_plan.learn.segmenting.steps import sweeps_of
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
