"""Data of one coordinate for identification: runs cut into segments of equal layout."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from micah_plan.arrays import Booleans, Floats, Ints, earlier_rows, robust_std
from micah_plan.automaton.effects.ends import range_of
from micah_plan.automaton.effects.memories import LONGEST_DELAY
from micah_plan.automaton.effects.registry import form
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.hybrid import HybridAutomaton, Mode
from micah_plan.automaton.link_motion import LinkMotion, link_motions
from micah_plan.automaton.tracks import Track, in_base_frame, measuring_links
from micah_plan.recording.commands import Meaning
from micah_plan.residual.compared_runs import sections
from micah_plan.residual.row_ends import RowsSeen, annotated_rows, row_ends

# Commands before a segment that a delay may still have to carry out.
_STILL_TO_COME = LONGEST_DELAY + 1
# Rows on either side that determine how fast a part moves.
_BESIDE = 3
# Rows before a segment from the middle of a run: they bring filter and memories up to date and are not counted (a speed
# that is nine tenths of that before has become a twentieth of the error by then).
WARM_UP = 30
# Segments of long runs have at most this many rows, which costs a quarter more for warming up, and the time of a
# prediction goes with the longest segment. Fewer rows are read than `MOST_ROWS`, evenly over the recording.
_LONGEST = 60
MOST_ROWS = 20_000
# Roll-outs go over whole runs, up to this many rows.
_LONGEST_ROLLOUT = 3000
# With fewer runs than this, segments of the same run are held out from each other.
ENOUGH_RUNS = 4
_SHORTEST = 5
# Variance, over that of others, of an uninformative measurement.
UNSEEN = 1e9
# Readings of one value, on average, from which on they are counts; std of what a count leaves out, at the least.
_REPEATED, _OF_A_COUNT = 2.0, 0.5 / math.sqrt(12.0)
# Readings are whole counts apart, and where a part moves fast between rests few are one count apart.
_ONE_COUNT = 0.1
# Correlation of place and time from which on they are equivalent.
_SAME_CORRELATION = 0.95


# Stds of a measurement within which a command is to mean the same, and steps in which it may be heard.
_UNCLEAR, _MEMORY_ROWS = 2.0, 3


@dataclass(frozen=True, eq=False)
class CoordinateData:
    """One coordinate over S segments of up to T rows, short ones padded.

    Attributes:
        coordinate, index, unit: of the coordinate.
        z: (S, T) measured configuration [rad or m].
        u: (S, T) command from each row to the next, projected on the joint [rad or m]; 0 where there is none.
        place: (S, T) to which the command of each row leads if it means a place [rad or m].
        earlier: (2, S, k) `u` and `place` of the rows before each segment, the last first; NaN where there are none.
        moving: (S,) by how much the part moved on in a row about the first of a segment, by a straight line through the
            measurements there; 0 where a run begins.
        counted: (S, T) whether the step to this row counts; never at column 0.
        time: (S, T) since the start of the run [s].
        order: (S, T) place in the recording, from 0 to 1.
        mode: (S, T) index of the automaton's mode in which the row is.
        run: (S,) number of the run.
        action: (S, T, 3) recorded displacement [m]; None if the commands are not those of a single part.
        path: that is measured.
        lower, upper: ends of the range, infinite where there is none.
        ends_of_model: the model's own, where measured rows lie beyond them and the range was extended.
        row_ends: (2, S, T) for each row, where other coordinates and modes change them; None: constant.
        release: (2,) size of a command that leaves the lower and the upper end.
        holds: (2,) whether a mode holds the coordinate at the lower and the upper end.
        period: median time from row to row [s].
        rows: of the recording, before segments were chosen.
        modes: names of the automaton's modes.
        noise: (S, T) variance of each measurement as the model has it, over the mean of the rows that count; `UNSEEN`
            where a row is no measurement.
        is_outside: whether commands start from the belief while another sensor measured the part.
        effects: on the motion, that the model has already.
        meaning: of the commands, as stated by the recording; None: not stated.
        whole: the same rows in uncut runs, for roll-outs of their full length.
        segment: (S, T) of whole runs: number of the segment in which a row counts, -1 if in none.
    """

    coordinate: str
    index: int
    unit: str
    z: Floats
    u: Floats
    place: Floats
    earlier: Floats
    moving: Floats
    counted: Booleans
    time: Floats
    order: Floats
    mode: Ints
    run: Ints
    action: Floats | None
    path: LinkMotion
    lower: float
    upper: float
    ends_of_model: tuple[float, float]
    release: tuple[float, float]
    holds: tuple[bool, bool]
    period: float
    rows: int
    modes: tuple[str, ...]
    noise: Floats
    row_ends: Floats | None = None
    is_outside: bool = False
    effects: tuple[Effect, ...] = ()
    meaning: Meaning | None = None
    whole: CoordinateData | None = None
    segment: Ints | None = None

    def __post_init__(self) -> None:
        shape = self.z.shape
        of_rows = (self.u, self.place, self.counted, self.time, self.order, self.mode, self.noise)
        of_segments = (self.earlier.swapaxes(0, 1), self.moving, self.run)
        # The compiled loop does not look whether a row that it reads is there.
        if any(rows.shape != shape for rows in of_rows) or any(len(own) != len(self.z) for own in of_segments):
            raise ValueError(f"all rows must be in {shape[0]} segments of {shape[1]}")

    def measured_alike(self) -> CoordinateData:
        """The data, and its whole runs, with equal measurement noise in all rows."""
        whole = None if self.whole is None else self.whole.measured_alike()
        return replace(self, noise=np.where(self.is_measured, 1.0, self.noise), whole=whole)

    @property
    def clings(self) -> tuple[bool, bool]:
        """Whether the part may be held at its lower and upper end: where modes hold it or, if none does, at any end."""
        return self.holds if any(self.holds) else (bool(np.isfinite(self.lower)), bool(np.isfinite(self.upper)))

    @cached_property
    def blur(self) -> float:
        """Robust std of a measurement whose relative `noise` is 1, from steps that followed the command [rad or m]."""
        rows = np.arange(self.z.shape[1])
        latest = np.maximum.accumulate(np.where(self.is_measured, rows, -1), axis=1)
        before = np.concatenate([np.full((len(self.z), 1), -1), latest[:, :-1]], axis=1)
        s, now = np.nonzero(self.counted & self.is_measured & (before >= 0))
        then = before[s, now]
        asked = np.cumsum(self.u, axis=1) - self.u
        moved = self.z[s, now] - self.z[s, then] - (asked[s, now] - asked[s, then])
        # An error from one measured row to the next has the noise of two.
        error = moved / np.sqrt(self.noise[s, now] + self.noise[s, then])
        return float(robust_std(error))

    @cached_property
    def resolution(self) -> float:
        """Std of the quantisation error where readings repeat values; else 0 [rad or m]."""
        values, count = np.unique(self.z[self.counted & self.is_measured], return_counts=True)
        if len(values) < 2 or count.mean() < _REPEATED:
            return 0.0
        return float(np.quantile(np.diff(values), _ONE_COUNT)) * _OF_A_COUNT

    @property
    def is_measured(self) -> Booleans:
        """(S, T) whether a row is a measurement."""
        return self.noise < UNSEEN

    def visits_end(self) -> bool:
        """Whether the recording reaches an end of the range, where sensor and motion errors can be separated."""
        low, high = self.visited
        reach = 0.03 * (high - low)
        return low < self.ends_of_model[0] + reach or high > self.ends_of_model[1] - reach

    @property
    def repeats_one_motion(self) -> bool:
        """Whether all runs pass the same places at the same times, so that place and time are confounded."""
        place, time = self.z[self.counted], self.time[self.counted]
        if not (np.std(place) > 0 and np.std(time) > 0):
            return False
        return abs(float(np.corrcoef(place, time)[0, 1])) > _SAME_CORRELATION

    @property
    def command_size(self) -> float:
        """Root mean square of the commands; at least 1e-9."""
        return max(float(np.sqrt(np.mean(self.u[self.counted_starts] ** 2))), 1e-9)

    @property
    def goes_on(self) -> Booleans:
        """(S,) whether a segment continues earlier rows; its own first rows then do not count."""
        return np.asarray(~self.counted[:, 1:3].any(axis=1))

    @cached_property
    def numbered(self) -> Ints:
        """(S, T) index of each counted row, segment by segment; -1: not counted."""
        number = np.cumsum(self.counted).reshape(self.counted.shape) - 1
        return np.where(self.counted, number, -1)

    @property
    def counted_starts(self) -> Booleans:
        """(S, T) whether the step that starts at this row counts."""
        return earlier_rows(self.counted, -1)

    def of_segments(self, chosen: Ints) -> CoordinateData:
        """The data of some segments (k,)."""
        longest = int(np.flatnonzero(self.counted[chosen].any(axis=0)).max()) + 1
        names = ("z", "u", "place", "counted", "time", "order", "mode", "noise")
        cut = {name: getattr(self, name)[chosen][:, :longest] for name in names}
        ends = None if self.row_ends is None else self.row_ends[:, chosen][:, :, :longest]
        action = None if self.action is None else self.action[chosen][:, :longest]
        cut |= {"run": self.run[chosen], "earlier": self.earlier[:, chosen], "moving": self.moving[chosen]}
        return replace(self, **cut, row_ends=ends, action=action, whole=None, segment=None)

    @property
    def visited(self) -> tuple[float, float]:
        """Smallest and largest measured configuration of the rows that count."""
        measured = self.z[self.counted]
        return float(measured.min()), float(measured.max())


def coordinate_data_of(
    automaton: HybridAutomaton, tracks: tuple[Track, ...], reference: HybridAutomaton | None = None
) -> tuple[CoordinateData, ...]:
    """The data of all coordinates that some mode moves.

    Args:
        reference: the model before its ranges were opened (`range_exceeded.with_extended_range`); None: they were not.
    """
    segments, runs = _pieces(tracks, _cuts), _pieces(tracks, _whole_run)
    kept, result = _thinned_run(segments), []
    rows_of_tracks = [annotated_rows(automaton, track) for track in tracks]
    of_rows = [np.full(len(track.time), -1) for track in tracks]
    for s, piece in enumerate(kept):
        of_rows[piece.track][piece.start + 1 : piece.end] = s
    for number, link in measuring_links(automaton):
        if any(mode.driven[link.coordinate] for mode in automaton.modes):
            data, whole = (
                _coordinate_data(automaton, tracks, rows_of_tracks, (number, link.coordinate), rows_measured)
                for rows_measured in (kept, runs)
            )
            segment = np.full(whole.z.shape, -1)
            for s, piece in enumerate(runs):
                segment[s, : piece.end - piece.first] = of_rows[piece.track][piece.first : piece.end]
            segment[:, 0] = -1
            ends = range_of(reference or automaton, link.coordinate)
            whole = replace(whole, counted=(segment >= 0) & whole.is_measured, segment=segment, ends_of_model=ends)
            result.append(replace(data, ends_of_model=ends, whole=whole))
    return tuple(result)


@dataclass(frozen=True)
class _Piece:
    """Rows of a track: read from `first`, counted after `start`, up to `end`; `order` of the track's first row.

    Without a gap, they go on from row `begun`.
    """

    track: int
    begun: int
    first: int
    start: int
    end: int
    order: float


def _pieces(tracks: tuple[Track, ...], cuts: Callable[[int, int], list[tuple[int, int, int]]]) -> list[_Piece]:
    pieces, passed = [], 0
    total = sum(len(track.time) for track in tracks)
    for number, track in enumerate(tracks):
        for a, b in sections(track.time):
            for first, start, end in cuts(b - a, len(tracks)):
                # A roll-out or a filter that begins at a row without a measurement would not know its start.
                measured = np.flatnonzero(track.is_measured[a + first : a + end])
                begin = a + first + int(measured[0]) if len(measured) else a + end
                if a + end - max(a + start, begin) > 1:
                    pieces.append(_Piece(number, a, begin, max(a + start, begin), a + end, passed / total))
        passed += len(track.time)
    return pieces


def _coordinate_data(
    automaton: HybridAutomaton,
    tracks: tuple[Track, ...],
    rows_measured: list[RowsSeen],
    measuring: tuple[int, int],
    kept: list[_Piece],
) -> CoordinateData:
    (link, i), total = measuring, sum(len(track.time) for track in tracks)
    shape = (len(kept), max(piece.end - piece.first for piece in kept))
    z, u, place, time, order, action = (*(np.zeros(shape) for _ in range(5)), np.zeros((*shape, 3)))
    noise, mode, counted = np.ones(shape), np.zeros(shape, dtype=np.int64), np.zeros(shape, dtype=bool)
    ends = np.zeros((2, *shape)) if automaton.n > 1 else None
    vectors = len(automaton.links) == 1 and all(track.action is not None for track in tracks)
    moving, path = next(mode for mode in automaton.modes if mode.driven[i]), link_motions(automaton)[link]
    for s, piece in enumerate(kept):
        track, seen, first, end = tracks[piece.track], rows_measured[piece.track], piece.first, piece.end
        rows, count = slice(first, end), end - first
        z[s, :count], z[s, count:] = track.x[rows, i], track.x[end - 1, i]
        mode[s, :count] = seen.modes[rows]
        noise[s, :count] = np.where(track.is_measured[rows], seen.stds[rows, i] ** 2, np.inf)
        u[s, :count], place[s, :count] = _commanded(automaton, track, measuring, rows, moving)
        place[s, count:] = z[s, -1]
        time[s, :count] = track.time[rows] - track.time[0]
        order[s, :count] = piece.order + np.arange(first, end) / total
        # Without a measurement there is nothing to compare with.
        own = slice(piece.start - first + 1, count)
        counted[s, own] = np.isfinite(noise[s, own])
        if ends is not None:
            at = row_ends(automaton, track.x[rows], mode[s, :count], i)
            ends[:, s, :count] = at.low, at.high
            counted[s, 1:count] &= ~at.depends_on_noise(z[s, :count], u[s, :count])[:-1]
        if track.action is not None:
            recorded = track.action[rows, link]
            action[s, : len(recorded)] = recorded
            asked = in_base_frame(automaton, i, recorded)
            counted[s, :count] &= ~_depends_on_noise(path, z[s, :count], asked, seen.stds[rows, i])
    return CoordinateData(
        coordinate=automaton.coordinates[i].name,
        index=i,
        unit=automaton.coordinates[i].unit,
        z=z,
        u=u,
        place=place,
        **_initial_conditions(automaton, tracks, measuring, kept, moving),
        counted=counted,
        time=time,
        order=order,
        mode=mode,
        run=np.array([tracks[piece.track].run for piece in kept]),
        action=np.nan_to_num(action) if vectors else None,
        path=path,
        **_ends(automaton, i),
        period=float(np.median(np.concatenate([np.diff(track.time) for track in tracks]))),
        rows=total,
        modes=automaton.mode_names,
        noise=_relative(noise, counted),
        row_ends=ends,
        is_outside=all(track.is_outside for track in tracks),
        effects=_on_motion(automaton, automaton.coordinates[i].name),
    )


def _initial_conditions(
    automaton: HybridAutomaton, tracks: tuple[Track, ...], measuring: tuple[int, int], kept: list[_Piece], mode: Mode
) -> dict[str, Any]:
    """`earlier` commands and initial speeds `moving` of the segments, by field name."""
    earlier = [_earlier(automaton, tracks[piece.track], measuring, piece, mode) for piece in kept]
    moving = [_speed_at(tracks[piece.track], piece, measuring[1]) for piece in kept]
    return {"earlier": np.stack(earlier, axis=1), "moving": np.array(moving)}


def _earlier(automaton: HybridAutomaton, track: Track, measuring: tuple[int, int], piece: _Piece, mode: Mode) -> Floats:
    """(2, k) commands before a segment, latest first, as `_commanded` returns them; NaN where there are none."""
    begun = max(piece.begun, piece.first - _STILL_TO_COME)
    earlier = np.full((2, _STILL_TO_COME), np.nan)
    earlier[:, : piece.first - begun] = _commanded(automaton, track, measuring, slice(begun, piece.first), mode)[
        :, ::-1
    ]
    return earlier


def _commanded(automaton: HybridAutomaton, track: Track, measuring: tuple[int, int], rows: slice, mode: Mode) -> Floats:
    """(2, k) commanded displacements in some rows, and the positions to which they lead."""
    link, i = measuring
    displacement, origin = np.zeros(rows.stop - rows.start), track.origin[rows, i]
    if track.u is not None:
        displacement = np.vstack([track.u, 0 * track.u[:1]])[rows] @ mode.B[i]
    if track.action is None:
        return np.stack([displacement, origin + displacement])
    asked = in_base_frame(automaton, i, track.action[rows, link])
    return np.stack([displacement, origin + _displacements_to_positions(link_motions(automaton)[link], origin, asked)])


def _speed_at(track: Track, piece: _Piece, i: int) -> float:
    """Speed of coordinate i per row at the start of a segment; 0 where a run starts or measurements are missing."""
    rows = np.arange(max(piece.begun, piece.first - _BESIDE), min(piece.first + _BESIDE + 1, piece.end))
    rows = rows[track.is_measured[rows]]
    if piece.first == piece.begun or len(rows) <= _BESIDE:
        return 0.0
    return float(np.polyfit(rows, track.x[rows, i], 1)[0])


def _relative(variance: Floats, counted: Booleans) -> Floats:
    """(S, T) variances relative to their mean, `UNSEEN` where not measured."""
    mean = float(np.mean(variance[counted])) if counted.any() else 0.0
    relative = variance / mean if mean > 0 else np.ones_like(variance)
    return np.where(np.isfinite(variance), relative, UNSEEN)


def _depends_on_noise(path: LinkMotion, z: Floats, action: Floats, std: Floats) -> Booleans:
    """(T,) steps whose commanded displacement depends on noise of std (T,) in the configuration.

    Where a slide becomes an arc the displacements of actions (up to T, 3) from configurations (T,) are m before it, and
    rad behind it.
    """
    is_unclear = np.zeros(len(z), dtype=bool)
    if len(path.joints) == 1:
        return is_unclear
    k, action = len(action), np.nan_to_num(action)
    before, after = (path.commanded(z[:k] + side * std[:k], action) for side in (-_UNCLEAR, _UNCLEAR))
    for row in np.flatnonzero(np.abs(after - before) > std[:k]):
        is_unclear[row + 1 : row + 1 + _MEMORY_ROWS] = True
    return is_unclear


def _displacements_to_positions(path: LinkMotion, z: Floats, action: Floats) -> Floats:
    """(T,) displacements to commanded positions (up to T, 3) from configurations (T,)."""
    displacement, k = np.zeros_like(z), len(action)
    displacement[:k] = path.aimed(z[:k], np.nan_to_num(action))
    return displacement


def _on_motion(automaton: HybridAutomaton, coordinate: str) -> tuple[Effect, ...]:
    """The effects on a coordinate's motion; sensor and geometry are already applied to the configurations."""
    effects = [effect for effect in automaton.effects if effect.coordinate == coordinate]
    return tuple(effect for effect in effects if form(effect.name).layer not in ("sensor", "geometry"))


def _cuts(rows: int, runs: int) -> list[tuple[int, int, int]]:
    """(first row read, first row counted, end) of the segments of a run."""
    wanted = math.ceil(rows / _LONGEST)
    if runs < ENOUGH_RUNS:
        wanted = max(wanted, min(math.ceil(2 * ENOUGH_RUNS / runs), rows // _SHORTEST))
    edges = np.linspace(0, rows, max(wanted, 1) + 1).astype(int)
    cuts = []
    for start, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        # The step into the first row of a later segment counts there, so that no step is lost.
        first = max(0, start - WARM_UP)
        cuts.append((first, max(start - 1, 0), end))
    return [cut for cut in cuts if cut[2] - cut[1] >= 2]


def _whole_run(rows: int, _: int) -> list[tuple[int, int, int]]:
    """A whole run as one segment; long ones are cut."""
    edges = np.linspace(0, rows, math.ceil(rows / _LONGEST_ROLLOUT) + 1).astype(int).tolist()
    return [(start, start, end) for start, end in pairwise(edges) if end - start > 1]


def _thinned_run(pieces: list[_Piece]) -> list[_Piece]:
    rows = sum(piece.end - piece.first for piece in pieces)
    if rows <= MOST_ROWS:
        return pieces
    count = max(2 * ENOUGH_RUNS, len(pieces) * MOST_ROWS // rows)
    return [pieces[i] for i in np.linspace(0, len(pieces) - 1, count).astype(int)]


def _ends(automaton: HybridAutomaton, i: int) -> dict[str, Any]:
    """Range of coordinate i: ends, whether a mode holds it there, and the command needed to leave."""
    (lower, upper), holds, release = range_of(automaton, i), [False, False], [0.0, 0.0]
    for mode in automaton.modes:
        for pin in mode.pins:
            if pin.coordinate != i:
                continue
            for side, end in enumerate((lower, upper)):
                if abs(pin.value - end) > 1e-6:
                    continue
                holds[side] = True
                for edge in automaton.edges_from(mode.name):
                    for h in edge.guard.half_spaces:
                        if h.b[i] and not h.on_state and not edge.is_self_transition:
                            away = (h.b[i] > 0) == (side == 0)
                            release[side] = max(release[side], h.c / abs(h.b[i])) if away else release[side]
    ends = {"lower": lower, "upper": upper, "ends_of_model": (lower, upper)}
    return {**ends, "holds": (holds[0], holds[1]), "release": (release[0], release[1])}
