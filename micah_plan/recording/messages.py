"""Sentences on recordings: suspicious numbers, breaks in a motion, how a file was read."""

from __future__ import annotations

from collections.abc import Sequence

from micah_plan.errors import shown
from micah_plan.message import Message, message
from micah_plan.quantities import count, percent, plain, quantity

NOT_MILLIMETRES = "positions and actions are read in m: if these are millimetres, add --units mm"
ROWS_PER_SECOND = "times are read in s: if they are not, give the rows per second: --rate HZ"


# Breaks in a motion; tracks and rows come as text (part 'door', rows 3 to 7 (t = 0.1 to 0.2 s))


@message
def read_turned(part: str, fold: int, rows: int, first: int, time: float) -> str:
    """A symmetric part was read in another orientation [s]."""
    angles = f"{'' if fold == 2 else 'multiples of '}{360 // fold}°"
    return (
        f"part '{part}' is read turned by {angles} in {count(rows, 'row')}, first in row {first} (t = {time:.4g} s), "
        "while its position goes on: does the object look the same when turned like that? These orientations are "
        "turned back; if the part did turn, read its positions only: --positions-only"
    )


@message
def is_noise(track: str, spread: float, unit: str) -> str:
    """Values that are white noise (rms)."""
    return (
        f"{track} jumps by {quantity(spread, unit, digits=2)} (rms) in every row, independently of the row before: is "
        "this noise, or are the rows out of order?"
    )


@message
def repeats(rows: int, track: str, repeated: int | None, where: str, is_rest: bool) -> str:
    """Rows that repeat the pose of a row (None: of the row before each), where most of them are, as text."""
    pose = "the pose of the row before" if repeated is None else f"the pose of row {repeated}"
    what = f"{count(rows, 'row')} of {track} {'repeats' if rows == 1 else 'repeat'} {pose} to the last digit{where}"
    if is_rest:
        return f"{what}: others lie exactly on a joint, so learn takes these as rests"
    return f"{what}: was the part out of sight? Repeated rows do not count as measurements"


@message
def jumps(track: str, distance: float, angle: float, where: str, others: int) -> str:
    """The largest jump [m, rad; 0 if negligible] and the number of others."""
    more = f" (and at {count(others, 'more row')})" if others else ""
    return (
        f"{track} jumps by {_size(distance, angle)} at {where}{more}, faster than it moves anywhere else: are rows "
        "missing, or was the tracker restarted? If it was, leave out the rows before or after it"
    )


@message
def exchanged(first: str, second: str, where: str) -> str:
    """Two parts that were taken for each other."""
    return f"{first} and {second} are exchanged in {where}: these rows are not used"


@message
def stray(track: str, distance: float, angle: float, where: str, others: int, is_at_end: bool) -> str:
    """Rows away from the rest of the motion [m, rad; 0 if negligible]."""
    more = f" (and in {count(others, 'more piece')})" if others else ""
    how = "where it cannot get" if is_at_end else "and comes back"
    return (
        f"{track} is {_size(distance, angle)} away in {where}{more}, {how}: did the tracker lose it, or mistake it for "
        "another? These rows are not used"
    )


def _size(distance: float, angle: float) -> str:
    named = [quantity(distance, "m", digits=2)] if distance else []
    named += [quantity(angle, "rad", digits=2)] if angle else []
    return " and ".join(named)


def in_run(run: int, about: Message) -> Message:
    """A message about one of several runs."""
    return Message(f"run {run}: {about}", about.code, {**about.values, "run": run})


# Suspicious numbers


def clock_unit(unit: str) -> str:
    """The remedy for times in another unit."""
    return f"times are read in s: if they are in {unit}, add --units {unit}"


def or_as_read(remedy: str) -> str:
    """A remedy, or the confirmation that numbers are right as read."""
    return f"{remedy}; if they are right as read, confirm it: --units m,s"


@message
def large_motion(part: str, extent: float) -> str:
    """A part that moves further than objects do [m]."""
    return f"part '{part}' moves over {quantity(extent, 'm')}"


@message
def far_away(part: str, distance: float) -> str:
    """A part further away than trackers see [m]."""
    return f"part '{part}' is {quantity(distance, 'm')} from the origin of the base frame"


@message
def large_force(part: str, force: float) -> str:
    """A force larger than hands exert [N]."""
    return (
        f"part '{part}' is pushed with {quantity(force, 'N')}; forces are read in N: if they are in another unit, "
        "convert them: --columns fx=FACTOR*fx,fy=FACTOR*fy,fz=FACTOR*fz"
    )


@message
def small_actions(part: str, moved: float, commanded: float) -> str:
    """A part that moves much further than all actions together [m]."""
    return (
        f"part '{part}' moves over {quantity(moved, 'm')}, all actions together over {quantity(commanded, 'm')}; "
        "actions are read in m: if they are in another unit, convert them: --columns "
        "ax=FACTOR*ax,ay=FACTOR*ay,az=FACTOR*az"
    )


@message
def large_actions(part: str, moved: float, commanded: float) -> str:
    """Actions much larger than the motion of a row [m]."""
    return (
        f"part '{part}' moves by {quantity(moved, 'm')} per row where actions command {quantity(commanded, 'm')}; "
        "actions are read in m: if these are millimetres, convert them: --columns ax=0.001*ax,ay=0.001*ay,az=0.001*az"
    )


@message
def long_gap(seconds: float) -> str:
    """A gap in time [s]."""
    return (
        f"a row is {quantity(seconds, 's')} after the one before it; was a clock set, or are these two recordings? "
        "Then give each its number in a column 'run'"
    )


@message
def no_motion() -> str:
    """No two rows of one part in one run."""
    return "no run has two rows of one part, so no motion is seen; give a part the same name and run in all of its rows"


@message
def fast_rows(seconds: float) -> str:
    """Rows closer in time than trackers measure [s]."""
    return f"rows are {quantity(seconds, 's')} apart, faster than any tracker"


@message
def slow_rows(seconds: float) -> str:
    """Rows further apart in time than a motion is recorded [s]."""
    return f"rows are {quantity(seconds, 's')} apart"


@message
def quaternion_order(part: str, meaning: str, unexplained: float, as_read: float, option: str) -> str:
    """Quaternions that fit the positions only if they are read otherwise, with the unexplained shares of motion."""
    return (
        f"part '{part}' rotates about a fixed axis only if its quaternions {meaning} (this leaves "
        f"{percent(unexplained, 0)} of the motion unexplained, as read {percent(as_read, 0)}); they are read as "
        f"rotations from part to base, scalar last: if they are not, add {option}"
    )


@message
def grip_slips_on_line(part: str, distance: float, turned: float) -> str:
    """A part that moves along a line and turns [m, rad]."""
    return _grip_slips(part, f"moves {quantity(distance, 'm', digits=2)} along a line", turned)


@message
def grip_slips_on_circle(part: str, angle: float, radius: float, turned: float) -> str:
    """A part that moves round a circle and turns otherwise [rad, m, rad]."""
    path = f"moves {quantity(angle, 'rad', digits=2)} round a circle of radius {quantity(radius, 'm')}"
    return _grip_slips(part, path, turned)


def _grip_slips(part: str, path: str, turned: float) -> str:
    return (
        f"part '{part}' {path} and turns by {quantity(turned, 'rad', digits=2)}: one joint cannot do both. If a hand "
        "turns on what it holds, its orientations are not those of the part: --positions-only"
    )


# How a file was read


@message
def rows_left_out(lost: int, rows: int, longest: int) -> str:
    """Rows without a pose."""
    return f"{count(lost, 'row')} of {rows} have no pose and are left out, at most {longest} in a row"


@message
def poses_left_out(lost: int, part: str) -> str:
    """Poses of zeros or NaN."""
    return f"{count(lost, 'pose')} of {shown(part)} are zeros or not numbers and are left out"


@message
def y_upwards() -> str:
    """A Motive export without its axis."""
    return "a Motive export: y is taken to point upwards; if it does not, give the axis that does (--up z)"


@message
def frame_unknown(frame: str, vector: str, target: str) -> str:
    """Vectors in a frame that no transform places."""
    return f"no transform gives the frame {shown(frame)} of {vector}; it is read as {target}"


@message
def joined_at_poses(samples: int, kind: str, part: str, rates: tuple[float, float], apart: float) -> str:
    """Samples and poses [Hz] at different stamps, at least so far apart [s]."""
    how = "each spread until the next" if kind == "action" else "interpolated"
    return (
        f"{count(samples, kind)} of {shown(part)} at {rates[0]:.3g} Hz are joined to poses at {rates[1]:.3g} Hz "
        f"({how}); the nearest stamps are {quantity(apart, 's')} apart"
    )


@message
def joint_topics(measured: Sequence[str], commanded: Sequence[str]) -> str:
    """Topics that joints and targets were read from."""
    targets = f"; targets are those commanded on {', '.join(commanded)}" if commanded else ""
    return f"joints are those measured on {', '.join(measured)}{targets} (choose others by --topic)"


@message
def not_positions(topic: str) -> str:
    """A topic that is named like commands of another quantity."""
    return f"commands on {topic} are not positions by its name, so they are not read"


@message
def unnamed_targets(topic: str, sizes: Sequence[int], joints: int) -> str:
    """Commands without names, of another number than joints."""
    listed = " or ".join(map(str, sizes))
    return f"commands on {topic} are not read: {listed} numbers without names, {count(joints, 'joint')}"


@message
def targets_by_position(topic: str, joints: Sequence[str]) -> str:
    """Commands without names, assigned to the joints that they are nearest to."""
    return f"targets are the commands on {topic}, by the positions of the joints those of {', '.join(joints)}"


@message
def clock_offset(part: str, seconds: float, std: float, correlation: float | None) -> str:
    """How far the clock of commands is ahead [s]; correlation None: as given."""
    spread = "" if correlation is None else f" ± {quantity(2.0 * std, 's', digits=1)}"
    how = "as given" if correlation is None else f"found from the motion, correlation {correlation:.2f}"
    return f"commands of {part}: their clock is {plain(seconds, 4)} s{spread} ahead ({how})"
