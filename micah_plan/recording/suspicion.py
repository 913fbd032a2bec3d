"""What looks like a mistake in a recording that can be read: units of length and time, order and signs of quaternions.

Nothing is corrected: each suspicion is one line that says what was seen and what to do. What `Conventions` state is not
doubted; units that they leave open are, and then nothing should be learned (`require_conventions`).

Rules, each of them with what it cannot see:

- **Length.** A part of an articulated object stays within a room and within the reach of a tracker. The largest room
  that is granted is 10 m in each direction, 17 m across. A part that moves over more than `LARGEST_EXTENT_M` (70 % of
  its rows, so that outliers do not count), or is farther than `FARTHEST_M` from the origin in most rows, was probably
  given in millimetres. A part that moves by less than 20 mm close to the origin does not show it.
- **No motion.** One row of each part in each run shows where it was, and nothing else.
- **Continuity.** Rows that are no measurements of one continuous motion, see `breaks`.
- **Actions.** A hand that is told to move more than `LARGEST_ACTION_M` per row, and a hundred times as far as the part
  moves (90 % of the rows each), was probably told millimetres. Parts that move less than 0.3 mm per row do not show it.
  One whose whole way is less than a thousandth of where the part gets was probably not told metres either.
- **Forces.** A hand that pushes with more than `LARGEST_FORCE_N` (90 % of the rows), a ton, was read in another unit.
- **Gaps.** One row more than `LONGEST_GAP_S` after the one before, in the same run, is a clock that was set or two
  recordings in one.
- **Time.** One pose in more than `LONGEST_STEP_S` (median) does not show how a part moves; a clock in milliseconds,
  microseconds or nanoseconds does. One faster than 200 Hz in milliseconds does not show it. One pose in less than
  `SHORTEST_STEP_S` is a clock in minutes, hours or days.
- **Quaternions.** Which component is the scalar cannot be seen from how fast a part turns: reordering is an orthogonal
  map of quaternions, so all angles between rows remain. But a part that turns about a fixed axis moves with it: its
  origin is p = c + R r with constant c, r. If that holds twice as well with the scalar taken first, or four times as
  well with other signs (the inverse turn; positions and turns of frames of which one is left-handed), it is probably
  so; but a screw, or a part that moves freely, can look like that, so it is only said. A part that does not turn, or
  only about what remains its axis, does not show it.

**Jumps.** What is printed of rows that are no measurements of one continuous motion, see `continuity`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.arrays import Floats
from micah_plan.errors import InputError
from micah_plan.quantities import FARTHEST_M, count, percent, quantity
from micah_plan.recording.checks import QUATERNION
from micah_plan.recording.continuity import FLOORS, Continuity, apart, continuity_of, stretches
from micah_plan.recording.conventions import TIMES
from micah_plan.recording.symmetry import ReadTurned, turned_back
from micah_plan.recording.turned_grip import TurnedGrip, turned_grip
from micah_plan.recording.value import Recording

LARGEST_EXTENT_M = 20.0
LONGEST_STEP_S = 5.0
LARGEST_ACTION_M = 0.3
LONGEST_GAP_S = 3600.0
SHORTEST_STEP_S = 1e-5
LARGEST_FORCE_N = 1e4

_FEWEST_ROWS = 10
_CLOCKS = tuple((name, second) for name, second in TIMES.items() if second < 1.0)
# The clock that is meant is the coarsest with which a pose comes at least this often [s].
_SLOWEST_S = 1.0
# Below this range of turning, noise and the motion of the origin cannot be told apart [rad].
_LEAST_TURN = 0.3
# The given order must leave much of the motion of the origin unexplained, and the other one at most half of that; other
# signs, of which there are four, a quarter: of 826 simulated recordings of all kinds 7 are doubted, screws among them.
_UNEXPLAINED = 0.2
_FAR_BETTER, _WITH_OTHER_SIGNS = 0.5, 0.25
# Signs of a quaternion that differ, by what it then means: what is mirrored along an axis turns the other way about the
# two others.
_SIGNS = {
    "turn the other way": ("qx", "qy", "qz"),
    "are of a frame whose x points the other way": ("qy", "qz"),
    "are of a frame whose y points the other way": ("qx", "qz"),
    "are of a frame whose z points the other way": ("qx", "qy"),
}
_AS_READ = "--units m,s"
# Millimetres are a thousand times metres; noise makes steps of the part look larger than they are.
_FAR_MORE = 100.0
# A hand that gains a hundredfold moves a part further than all of its actions; ten times that is another unit.
_FAR_LESS = 1000.0


def suspicions_of_recording(recording: Recording) -> tuple[str, ...]:
    """What looks wrong in a recording, one line each; empty if nothing does."""
    lines = [str(misreading) for misreading in misread(recording)]
    for part in recording.parts:
        rows = recording.select(part=part)
        lines += [_actions(rows, part), _forces(rows, part)]
        lines += ["" if "quaternion" in recording.conventions else _quaternion(rows, part)]
    lines += [*breaks(recording), _gap(recording), _no_motion(recording)]
    return tuple(line for line in lines if line)


@dataclass(frozen=True)
class Misreading:
    """Numbers that look as if they had other units than a recording.

    Attributes:
        sentence: what is odd, with its amount.
        remedy: how the numbers are read, and the option that says otherwise.
    """

    sentence: str
    remedy: str

    def __str__(self) -> str:
        """Both in one line."""
        return f"{self.sentence}; {self.remedy}"


def misread(recording: Recording) -> tuple[Misreading, ...]:
    """What looks as if the file had other units than a recording, and nobody said which."""
    stated = recording.conventions.keys()
    parts = () if "length" in stated else recording.parts
    lines = [_length(recording.select(part=part), part) for part in parts]
    lines += [] if stated & {"time", "rate"} else [_clock(recording)]
    return tuple(line for line in lines if line is not None)


def require_conventions(recording: Recording) -> None:
    """Check that nothing looks misread.

    Raises:
        InputError: for the first of `misread`, with the options that say how it is meant.
    """
    for misreading in misread(recording):
        remedy = f"{misreading.remedy}; if they are right as read, say that: {_AS_READ}"
        raise InputError(misreading.sentence, remedy=remedy)


def _length(rows: Recording, part: str) -> Misreading | None:
    extent = _extent(rows)
    distance = float(np.median(np.linalg.norm(rows.position, axis=1)))
    if extent > LARGEST_EXTENT_M:
        sentence = f"part '{part}' moves over {quantity(extent, 'm')}"
    elif distance > FARTHEST_M:
        sentence = f"part '{part}' is {quantity(distance, 'm')} from the origin of the base frame"
    else:
        return None
    return Misreading(sentence, "positions and actions are read in m: if these are millimetres, say so: --units mm")


def _extent(rows: Recording) -> float:
    """Over what a part moves, except for the few rows that are furthest out [m]."""
    return float(np.linalg.norm(np.subtract(*np.quantile(rows.position, [0.85, 0.15], axis=0))))


def _forces(rows: Recording, part: str) -> str:
    sizes = np.zeros(0) if rows.force is None else np.linalg.norm(rows.force, axis=1)
    sizes = sizes[np.isfinite(sizes)]
    force = float(np.quantile(sizes, 0.9)) if len(sizes) else 0.0
    if force <= LARGEST_FORCE_N:
        return ""
    sentence = f"part '{part}' is pushed with {quantity(force, 'N')}; forces are read in N: if they are not, say so"
    return f"{sentence}: --columns fx=FACTOR*fx,fy=FACTOR*fy,fz=FACTOR*fz"


def _actions(rows: Recording, part: str) -> str:
    if rows.action is None or len(rows) < _FEWEST_ROWS:
        return ""
    sizes = np.linalg.norm(rows.action, axis=1)
    sizes = sizes[sizes > 0.0]  # false for the empty one at the end of a run
    if not len(sizes):
        return ""
    asked = float(np.quantile(sizes, 0.9))
    moved = float(np.quantile(np.linalg.norm(np.diff(rows.position, axis=0), axis=1), 0.9))
    way, extent = float(sizes.sum()), _extent(rows)
    if extent > _FAR_LESS * way:
        sentence = f"part '{part}' moves over {quantity(extent, 'm')}, all actions together over {quantity(way, 'm')}"
        columns = "ax=FACTOR*ax,ay=FACTOR*ay,az=FACTOR*az"
        return f"{sentence}; actions are read in m: if they are not, say so: --columns {columns}"
    if asked <= LARGEST_ACTION_M or asked <= _FAR_MORE * moved:
        return ""
    return (
        f"part '{part}' moves by {quantity(moved, 'm')} per row where actions ask for {quantity(asked, 'm')}; actions "
        "are read in m: if these are millimetres, say so: --columns ax=0.001*ax,ay=0.001*ay,az=0.001*az"
    )


def _gap(recording: Recording) -> str:
    steps = _steps(recording)
    longest = float(steps.max(initial=0.0))
    if longest <= LONGEST_GAP_S or _slow(steps):
        return ""
    remedy = "was a clock set, or are these two recordings? then give each its number in a column 'run'"
    return f"a row is {quantity(longest, 's')} after the one before it; {remedy}"


def _no_motion(recording: Recording) -> str:
    if len(_steps(recording)):
        return ""
    return "no run has two rows of one part, so no motion is seen; give a part the same name and run in all of its rows"


def _clock(recording: Recording) -> Misreading | None:
    steps = _steps(recording)
    step = float(np.median(steps)) if len(steps) else 0.0
    if 0.0 < step < SHORTEST_STEP_S:
        remedy = "times are read in s: if they are not, say how many rows a second has: --rate HZ"
        return Misreading(f"rows are {quantity(step, 's')} apart, and no tracker is so fast", remedy)
    if not _slow(steps):
        return None
    clock = next((name for name, ticks in _CLOCKS if step * ticks <= _SLOWEST_S), "ns")
    remedy = f"times are read in s: if they are in {clock}, say so: --units {clock}"
    return Misreading(f"rows are {quantity(step, 's')} apart", remedy)


def _slow(steps: Floats) -> bool:
    return len(steps) + 1 >= _FEWEST_ROWS and float(np.median(steps)) > LONGEST_STEP_S


def _steps(recording: Recording) -> Floats:
    """Times between rows that follow each other in a run, of each part [s]."""
    _, part = np.unique(np.array(recording.part), return_inverse=True)
    order = np.lexsort((part, recording.run))  # stable: rows of one run and part stay in the order of time
    group = np.column_stack([recording.run, part])[order]
    return np.asarray(np.diff(recording.time[order])[(group[1:] == group[:-1]).all(axis=1)])


def _quaternion(rows: Recording, part: str) -> str:
    if rows.quaternion is None or len(rows) < _FEWEST_ROWS:
        return ""
    rotation = Rotation.from_quat(rows.quaternion)
    turned = float(np.quantile((rotation * rotation[len(rows) // 2].inv()).magnitude(), 0.95))
    if turned < _LEAST_TURN:
        return ""
    as_given = _unexplained(rows.position, rotation)
    if as_given < _UNEXPLAINED:
        return ""
    # (w, x, y, z) was read as (x, y, z, w), so the scalar stands first.
    others = {("have the scalar first", "--quaternion wxyz"): rows.quaternion[:, [1, 2, 3, 0]]}
    for meaning, names in _SIGNS.items():
        option = "--columns " + ",".join(f"{name}=-{name}" for name in names)
        signs = np.array([-1.0 if name in names else 1.0 for name in QUATERNION])
        others[meaning, option] = signs * rows.quaternion
    unexplained = {
        key: _unexplained(rows.position, Rotation.from_quat(quaternion)) for key, quaternion in others.items()
    }
    enough = {key: _FAR_BETTER if key[1] == "--quaternion wxyz" else _WITH_OTHER_SIGNS for key in unexplained}
    better = [key for key in unexplained if unexplained[key] <= enough[key] * as_given]
    if not better:
        return ""
    meaning, option = min(better, key=unexplained.__getitem__)
    if _turned_grip(rows) is not None and _turned_grip(replace(rows, quaternion=others[meaning, option])) is not None:
        return ""  # read like that they contradict the positions as well, see turned_grips
    return (
        f"part '{part}' turns about a fixed axis only if its quaternions {meaning} (they then leave "
        f"{percent(unexplained[meaning, option], 0)} of the motion unexplained, as they are {percent(as_given, 0)}); "
        f"they are read as turns of the part in the base frame, scalar last: if they are not, say so: {option}"
    )


def turned_grips(recording: Recording) -> dict[str, str]:
    """By part what looks as if a hand had turned on it, one line each; of a part on another one nothing is said."""
    if len(recording.parts) > 1 or not recording.has_orientation:
        return {}
    (part,) = recording.parts
    grip = _turned_grip(recording)
    is_misread = "quaternion" not in recording.conventions and bool(_quaternion(recording, part))
    return {} if grip is None or is_misread else {part: grip.in_words(part)}


def _turned_grip(rows: Recording) -> TurnedGrip | None:
    for run in rows.runs:
        own = rows.select(run=run)
        grip = turned_grip(own.position, own.poses().rotation)
        if grip is not None:
            return grip
    return None


def _unexplained(position: Floats, rotation: Rotation) -> float:
    """Share of the spread of the origin that p = c + R r leaves, with the best constant c and r (least squares)."""
    matrices = rotation.as_matrix()
    design = np.concatenate([np.tile(np.eye(3), (len(position), 1, 1)), matrices], axis=2).reshape(-1, 6)
    fitted = design @ np.linalg.lstsq(design, position.ravel(), rcond=None)[0]
    residual = np.linalg.norm(position.ravel() - fitted)
    return float(residual / max(float(np.linalg.norm(position - position.mean(axis=0))), np.finfo(float).tiny))


_FEW, _RARE = 3, 0.05
"""Repeats of so few rows at a time, that are so rare, are dropped frames, which nobody has to know."""

_AT_RANDOM = 1.5
"""Of the variance is the mean square of steps, which is 2 of noise, of what says nothing of the next row."""

_FEWEST = 16

_OVERLAP = 0.8
"""Of the rows of two parts that strayed together, for one to be taken for the other."""

_CLOSER = 0.25
"""Of the way to its own place is the way of a stray to the place of the part that it is taken for."""


@dataclass(frozen=True, eq=False)
class _Track:
    """One part in one run: where it is in the recording, its rows, and which are measurements."""

    name: str
    index: tuple[int, ...]
    rows: Recording
    continuity: Continuity

    def says(self, first: int, last: int) -> str:
        """Rows as they are numbered in the recording, and their times."""
        number = f"rows {self.index[first]} to {self.index[last]}" if last > first else f"row {self.index[first]}"
        begin, end = self.rows.time[[first, last]].tolist()
        return f"{number} (t = {begin:.4g}" + (f" to {end:.4g} s)" if last > first else " s)")

    def beside(self, first: int, last: int) -> int:
        """The measured row next to rows that are none: before them or, at the start, behind them."""
        measured = np.flatnonzero(self.continuity.is_measured)
        before = measured[measured < first]
        return int(before[-1] if len(before) else measured[measured > last][0])


_Stray = tuple[_Track, int, int]
"""A part, and the first and last row of a piece that is left out of its track."""


def breaks(recording: Recording) -> tuple[str, ...]:
    """One line for each piece of a track that is no measurement of its motion, and for each jump that is left."""
    recording, turned = turned_back(recording)
    every: list[str] = []
    for run in recording.runs:
        tracks = []
        for part in recording.parts:
            index = recording.index(run=run, part=part)
            if len(index):
                rows = recording.rows(index)
                tracks.append(_Track(f"part '{part}'", tuple(index.tolist()), rows, continuity_of(rows)))
        lines = [
            line for track in tracks for line in (*_noise_lines(track), *_repeat_lines(track), *_jump_lines(track))
        ]
        lines += _stray_lines(tracks)
        lines += [_turned_line(recording, each) for each in turned if each.run == run]
        every += [f"run {run}: {line}" if len(recording.runs) > 1 else line for line in lines]
    return tuple(every)


def _turned_line(recording: Recording, turned: ReadTurned) -> str:
    """Rows in which a part was taken for what it looks the same as."""
    share, first = 360 // turned.symmetry.fold, int(turned.rows[0])
    return (
        f"part '{turned.part}' is read turned by {'' if turned.symmetry.fold == 2 else 'multiples of '}{share}° in "
        f"{count(len(turned.rows), 'row')}, the first is row {first} (t = {recording.time[first]:.4g} s), though its "
        "place goes on: an object that looks the same when turned so? These orientations are turned back; if the part "
        "did turn, read its positions only: --positions-only"
    )


def _noise_lines(track: _Track) -> list[str]:
    """A part that is somewhere else in every row, whatever the row before said.

    The mean square of successive differences is twice the variance of white noise, and less of any motion (von Neumann,
    Annals of Mathematical Statistics 1941).
    """
    rows = track.rows.rows(track.continuity.is_measured)
    if len(rows) < _FEWEST:
        return []
    lines = []
    vectors = [(rows.position, "m", FLOORS[0])]
    if rows.quaternion is not None:
        turned = rows.poses().rotation
        vectors.append((np.asarray((turned * turned.mean().inv()).as_rotvec()), "rad", FLOORS[1]))
    for values, unit, floor in vectors:
        spread = float(np.sqrt(values.var(axis=0).sum()))
        steps = float((np.diff(values, axis=0) ** 2).sum(axis=1).mean())
        if spread > floor and steps > _AT_RANDOM * spread**2:
            lines.append(
                f"{track.name} is {quantity(spread, unit, digits=2)} (rms) elsewhere in every row, whatever the row "
                "before said: is this noise, or are the rows out of order?"
            )
    return lines


def _repeat_lines(track: _Track) -> list[str]:
    strays = np.zeros(len(track.rows), dtype=bool)
    for first, last in track.continuity.strays:
        strays[first : last + 1] = True
    pieces = stretches(track.continuity.repeats & ~strays)
    if not pieces or (max(b - a for a, b in pieces) + 1 < _FEW and track.continuity.repeats.mean() < _RARE):
        return []
    first, last = max(pieces, key=lambda piece: piece[1] - piece[0])
    total = sum(b - a + 1 for a, b in pieces)
    longest = "" if len(pieces) == 1 else f", most of them {track.says(first, last)}"
    where = f"{count(total, 'row')} of {track.name} " + ("repeats" if total == 1 else "repeat")
    pose = f"the pose of row {track.index[first - 1]}" if len(pieces) == 1 else "the pose of the row before"
    at = f", {track.says(first, last)}" if len(pieces) == 1 else longest
    return [f"{where} {pose} to the last digit{at}: was it out of sight? Repeated rows are no measurements"]


def _jump_lines(track: _Track) -> list[str]:
    if not track.continuity.jumps:
        return []
    jump = max(track.continuity.jumps, key=lambda jump: jump.distance)
    others = len(track.continuity.jumps) - 1
    more = f" (and at {count(others, 'more row')})" if others else ""
    return [
        f"{track.name} jumps by {_size(jump.distance, jump.angle)} at {track.says(jump.row, jump.row)}{more}, faster "
        "than it moves anywhere else: are rows missing, or was the tracker started anew? In the latter case leave out "
        "the rows before or after it"
    ]


def _stray_lines(tracks: Sequence[_Track]) -> list[str]:
    """Strays of all parts of a run; of two that stray to each other's place the names were exchanged."""
    every = [(track, first, last) for track in tracks for first, last in track.continuity.strays]
    pairs = [
        (a, b)
        for track, another in combinations(tracks, 2)
        for a, b in _at_once(track, another)
        if _is_taken_for(a, b) and _is_taken_for(b, a)
    ]
    lines = [
        f"{a[0].name} and {b[0].name} are exchanged in {a[0].says(*a[1:])}: these rows are not used" for a, b in pairs
    ]
    named = [stray for pair in pairs for stray in pair]
    for track in tracks:
        alone = [stray for stray in every if stray[0] is track and stray not in named]
        if alone:
            lines.append(_stray_line(track, [(first, last) for _, first, last in alone]))
    return lines


def _stray_line(track: _Track, strays: Sequence[tuple[int, int]]) -> str:
    """The longest of the strays of a track, and how many there are."""
    first, last = max(strays, key=lambda stray: stray[1] - stray[0])
    size = _size(*apart(track.rows.position, track.rows.quaternion, track.beside(first, last), first).tolist())
    is_at_end = first == 0 or last == len(track.rows) - 1
    more = f" (and in {count(len(strays) - 1, 'more piece')})" if len(strays) > 1 else ""
    return (
        f"{track.name} is {size} away in {track.says(first, last)}{more}, "
        f"{'where it cannot get' if is_at_end else 'and comes back'}: was it lost by the tracker, or mistaken? "
        "These rows are not used"
    )


def _size(distance: float, angle: float) -> str:
    """A distance and an angle in words, without what is nothing beside the other."""
    shown = [quantity(distance, "m", digits=2)] if distance > 0.1 * FLOORS[0] else []
    shown += [quantity(angle, "rad", digits=2)] if angle > 0.1 * FLOORS[1] else []
    return " and ".join(shown)


def _at_once(track: _Track, second: _Track) -> list[tuple[_Stray, _Stray]]:
    """Strays of two parts that lie in the same rows, most of the time of the longer one."""
    pairs = []
    begins, ends = (second.rows.time[[stray[k] for stray in second.continuity.strays]] for k in (0, 1))
    for first, last in track.continuity.strays:
        begin, end = track.rows.time[[first, last]].tolist()
        for k in range(int(np.searchsorted(ends, begin)), int(np.searchsorted(begins, end, side="right"))):
            shared = min(end, float(ends[k])) - max(begin, float(begins[k]))
            if shared >= _OVERLAP * max(end - begin, float(ends[k] - begins[k])):
                pairs.append(((track, first, last), (second, *second.continuity.strays[k])))
    return pairs


def _is_taken_for(stray: _Stray, another: _Stray) -> bool:
    """Whether a stray of one part is where another part, which strays in the same rows, was before."""
    (track, first, last), (place, begin, end) = stray, another
    here = track.rows.position[first]
    from_own = np.linalg.norm(here - track.rows.position[track.beside(first, last)])
    from_other = np.linalg.norm(here - place.rows.position[place.beside(begin, end)])
    return bool(from_other < _CLOSER * from_own)
