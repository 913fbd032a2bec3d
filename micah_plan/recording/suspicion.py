"""Plausibility of readable recordings: units of length and time, order and signs of quaternions.

Nothing is corrected: each suspicion is one line with the observation and a remedy. What `Conventions` state is not
doubted; units that they leave open are, and then nothing should be learned (`require_conventions`).

The rules, with what they suspect and what they cannot detect, are the table "Warnings" in docs/concepts/learning.md;
the constants below are their thresholds. Breaks in a motion have their own module, `breaks`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.arrays import Floats
from micah_plan.errors import InputError
from micah_plan.quantities import FARTHEST_M
from micah_plan.recording import messages
from micah_plan.recording.breaks import breaks
from micah_plan.recording.checks import QUATERNION
from micah_plan.recording.conventions import TIMES
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
# Below this range of rotation, noise and the motion of the origin cannot be separated [rad].
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

# Millimetres are a thousand times metres; noise makes steps of the part look larger than they are.
_FAR_MORE = 100.0
# A hand that gains a hundredfold moves a part further than all of its actions; ten times that is another unit.
_FAR_LESS = 1000.0


def suspicions_of_recording(recording: Recording) -> tuple[str, ...]:
    """Suspicious properties of a recording, one line each; empty if there are none."""
    lines = [str(misreading) for misreading in suspected_misreadings(recording)]
    for part in recording.parts:
        rows = recording.select(part=part)
        lines += [_actions(rows, part), _forces(rows, part)]
        lines += ["" if "quaternion" in recording.conventions else _quaternion(rows, part)]
    lines += [*breaks(recording), _gap(recording), _no_motion(recording)]
    return tuple(line for line in lines if line)


@dataclass(frozen=True)
class Misreading:
    """Numbers that suggest other units than those of a recording.

    Attributes:
        sentence: the observation, with its amount.
        remedy: how the numbers are read, and the option that changes it.
    """

    sentence: str
    remedy: str

    def __str__(self) -> str:
        """Sentence and remedy in one line."""
        return f"{self.sentence}; {self.remedy}"


def suspected_misreadings(recording: Recording) -> tuple[Misreading, ...]:
    """Suspected units other than those of a recording, where no convention states them."""
    stated = recording.conventions.keys()
    parts = () if "length" in stated else recording.parts
    lines = [_length(recording.select(part=part), part) for part in parts]
    lines += [] if stated & {"time", "rate"} else [_clock(recording)]
    return tuple(line for line in lines if line is not None)


def require_conventions(recording: Recording) -> None:
    """Refuse a recording that looks misread.

    Raises:
        InputError: for the first of `suspected_misreadings`, with the options that define its meaning.
    """
    for misreading in suspected_misreadings(recording):
        raise InputError(misreading.sentence, remedy=messages.or_as_read(misreading.remedy))


def _length(rows: Recording, part: str) -> Misreading | None:
    extent = _extent(rows)
    distance = float(np.median(np.linalg.norm(rows.position, axis=1)))
    if extent > LARGEST_EXTENT_M:
        sentence = messages.large_motion(part, extent)
    elif distance > FARTHEST_M:
        sentence = messages.far_away(part, distance)
    else:
        return None
    return Misreading(sentence, messages.NOT_MILLIMETRES)


def _extent(rows: Recording) -> float:
    """Extent of a part's motion without outlying rows [m]."""
    return float(np.linalg.norm(np.subtract(*np.quantile(rows.position, [0.85, 0.15], axis=0))))


def _forces(rows: Recording, part: str) -> str:
    sizes = np.zeros(0) if rows.force is None else np.linalg.norm(rows.force, axis=1)
    sizes = sizes[np.isfinite(sizes)]
    force = float(np.quantile(sizes, 0.9)) if len(sizes) else 0.0
    return "" if force <= LARGEST_FORCE_N else messages.large_force(part, force)


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
        return messages.small_actions(part, extent, way)
    if asked <= LARGEST_ACTION_M or asked <= _FAR_MORE * moved:
        return ""
    return messages.large_actions(part, moved, asked)


def _gap(recording: Recording) -> str:
    steps = _steps(recording)
    longest = float(steps.max(initial=0.0))
    if longest <= LONGEST_GAP_S or _slow(steps):
        return ""
    return messages.long_gap(longest)


def _no_motion(recording: Recording) -> str:
    if len(_steps(recording)):
        return ""
    return messages.no_motion()


def _clock(recording: Recording) -> Misreading | None:
    steps = _steps(recording)
    step = float(np.median(steps)) if len(steps) else 0.0
    if 0.0 < step < SHORTEST_STEP_S:
        return Misreading(messages.fast_rows(step), messages.ROWS_PER_SECOND)
    if not _slow(steps):
        return None
    clock = next((name for name, ticks in _CLOCKS if step * ticks <= _SLOWEST_S), "ns")
    return Misreading(messages.slow_rows(step), messages.clock_unit(clock))


def _slow(steps: Floats) -> bool:
    return len(steps) + 1 >= _FEWEST_ROWS and float(np.median(steps)) > LONGEST_STEP_S


def _steps(recording: Recording) -> Floats:
    """Time steps between consecutive rows of each part and run [s]."""
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
    return messages.quaternion_order(part, meaning, unexplained[meaning, option], as_given, option)


def turned_grips(recording: Recording) -> dict[str, str]:
    """Warnings by part of a hand that turned on the object; only for parts on the base."""
    if len(recording.parts) > 1 or not recording.has_orientation:
        return {}
    (part,) = recording.parts
    grip = _turned_grip(recording)
    is_misread = "quaternion" not in recording.conventions and bool(_quaternion(recording, part))
    return {} if grip is None or is_misread else {part: grip.warning(part)}


def _turned_grip(rows: Recording) -> TurnedGrip | None:
    for run in rows.runs:
        own = rows.select(run=run)
        grip = turned_grip(own.position, own.poses().rotation)
        if grip is not None:
            return grip
    return None


def _unexplained(position: Floats, rotation: Rotation) -> float:
    """Unexplained fraction of the origin's spread under p = c + R r with the best constants c and r."""
    matrices = rotation.as_matrix()
    design = np.concatenate([np.tile(np.eye(3), (len(position), 1, 1)), matrices], axis=2).reshape(-1, 6)
    fitted = design @ np.linalg.lstsq(design, position.ravel(), rcond=None)[0]
    residual = np.linalg.norm(position.ravel() - fitted)
    return float(residual / max(float(np.linalg.norm(position - position.mean(axis=0))), np.finfo(float).tiny))
