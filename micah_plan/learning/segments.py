"""From pieces of rows to segments: joints fitted to all their rows, on one continuous configuration coordinate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from micah_plan.arrays import Booleans, Floats, Ints
from micah_plan.automaton.certainty import SegmentCertainty
from micah_plan.automaton.graph import Segment
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.kinematics import forward, inverse, jacobian, reversed_direction, shifted
from micah_plan.learning.joints.final_fit import NO_LACK_OF_FIT, LackOfFit
from micah_plan.learning.segmenting.noise import MeasurementNoise
from micah_plan.learning.track import PartTrack

_SMOOTHED_ROWS = 5  # rows that a smoothed configuration is estimated from
_PROJECTIONS = 10
_CUT_SHORT = 2.0  # stds of a measurement by which smoothing may move rows
_DECIMALS = 12
_FINEST_STEP = 0.1  # of the measurement noise; the rows of one recording cannot separate a smaller process noise from 0
_SAME_DIRECTION = 0.7  # cosine above which a joint continues the direction of the one before


@dataclass(frozen=True, eq=False)
class FittedPiece:
    """A stretch of rows with its joint, fitted to all rows that share it, and its action gain.

    Attributes:
        start, end: first and last row (inclusive) within the track.
        joint: with covariance; its configuration counts from an arbitrary pose.
        gain: (3,) h of the step model, 0 where actions are uninformative; along the axis of `leader`.
        leader: the joint that won the evidence; None for rigid.
        log_evidence: of the model for these rows.
        settled: whether the joint is on its coordinate already and stays as it is.
        lack_of_fit: evidence of the rows against the joint.
    """

    start: int
    end: int
    joint: Joint
    gain: Floats
    leader: Joint | None
    log_evidence: float
    settled: bool = False
    lack_of_fit: LackOfFit = NO_LACK_OF_FIT

    def index(self, inlier: Booleans) -> Ints:
        """Its rows that count, or all of them where none does."""
        rows = np.arange(self.start, self.end + 1)
        return rows[inlier[rows]] if inlier[rows].any() else rows


def chained(
    fitted: Sequence[FittedPiece],
    track: PartTrack,
    inlier: Booleans,
    noise: MeasurementNoise,
    before: Sequence[FittedPiece] = (),
    reached: float = 0.0,
) -> list[FittedPiece]:
    """The same pieces with their joints on one coordinate: equal where they meet, 0 at the first row.

    Each joint counts up in the direction in which it went furthest, unless it is of the kind of the last one and moves
    along the same line: then it keeps that sign, so a drawer that returns counts down. A part that returns to a joint
    is where it was on it.

    Args:
        before: settled pieces of earlier rows, of which the last one ends where these begin.
        reached: configuration there.
    """
    chain = list(before)
    placed: dict[Joint, Joint] = {}
    # Orientations of joints from positions alone are meaningless.
    length = 0.0 if track.quaternion is None else noise.rotation_length
    for piece in fitted:
        last = chain[-1].joint if chain else None
        if piece.joint in placed:
            piece = replace(piece, joint=placed[piece.joint], settled=True)
        if piece.settled:
            chain.append(piece)
            rigid = not piece.joint.moves
            reached = piece.joint.fixed_at if rigid else _near(piece.joint, piece.end, piece, track, inlier, noise)
            continue
        if not piece.joint.moves:
            moving = _last_moving(chain)
            if moving is not None and last is not None and last.kind != "rigid":
                reached = _configuration_of(piece.joint, moving, length)
            chain.append(replace(piece, joint=replace(piece.joint, fixed_at=reached)))
            continue
        joint = _directed(piece, chain, track, inlier, noise)
        start = _near(joint, piece.start, piece, track, inlier, noise)
        if last is not None and last.kind == "rigid":
            start = _configuration_of(last, joint, length)
        elif last is not None:
            reached, start = _meeting(last, reached, joint, start, length)
        placed[piece.joint] = joint = shifted(joint, start - reached)
        chain.append(replace(piece, joint=joint))
        reached = _near(joint, piece.end, piece, track, inlier, noise)
    return chain[len(before) :]


def to_segment(
    piece: FittedPiece,
    chain: Sequence[FittedPiece],
    certainty: SegmentCertainty,
    run: int,
    track: PartTrack,
    inlier: Booleans,
    noise: MeasurementNoise,
) -> Segment:
    """The segment of a chained piece, with its configurations and noise."""
    joint, used = piece.joint, piece.index(inlier)
    c = segment_configurations(joint, used, track, noise)
    if not joint.moves:
        start = end = joint.fixed_at
        limits = (joint.fixed_at, joint.fixed_at)
        process = 0.0
    else:
        observed = _observation_std(joint, joint, used, track, noise)
        smooth = _smoothed(c)
        if float(np.sqrt(np.mean((smooth - c) ** 2))) > _CUT_SHORT * observed:
            smooth = c  # the part moves far within few rows: smoothing would shorten its path
        # Rounded so that the first row of a chain is at 0 and not at what is left of adding and subtracting.
        smooth = np.round(smooth, _DECIMALS) + 0.0
        start, end = float(smooth[0]), float(smooth[-1])
        limits = (float(min(smooth.min(), start)), float(max(smooth.max(), end)))
        process = _process_std(piece, c, used, track, observed)
    measured_by = _last_moving(chain[: chain.index(piece) + 1]) or _first_moving(chain) or joint
    return Segment(
        joint=joint,
        run=run,
        start=int(track.rows[piece.start]),
        end=int(track.rows[piece.end]),
        configuration_start=start,
        configuration_end=end,
        configuration_range=limits,
        process_std=process,
        observation_std=_observation_std(joint, measured_by, used, track, noise),
        log_evidence=piece.log_evidence,
        probability=dict(certainty.kinds)[joint.kind],
        certainty=certainty,
    )


def segment_configurations(joint: Joint, rows: Ints, track: PartTrack, noise: MeasurementNoise) -> Floats:
    """(k,) configurations of rows, continuous from the first, which is the whole turn closest to 0."""
    rotation = None if track.rotation is None else track.rotation[rows]
    c = inverse(joint, track.position[rows], rotation, noise.rotation_length)
    return np.asarray(np.unwrap(c)) if joint.kind == "revolute" else c


def left_by(joint: Joint, rows: Ints, track: PartTrack, rotation_length: float) -> Floats:
    """(k, 6) or (k, 3) how far rows lie off a joint: rotation [rad], if it was measured, and position [m]."""
    rotation = None if track.rotation is None else track.rotation[rows]
    closest = forward(joint, inverse(joint, track.position[rows], rotation, rotation_length))
    off = track.position[rows] - closest.translation
    return off if rotation is None else np.hstack([(rotation * closest.rotation.inv()).as_rotvec(), off])


def _meeting(before: Joint, before_near: float, after: Joint, after_near: float, length: float) -> tuple[float, float]:
    """Configurations of two joints, near given ones, where their poses are closest, by alternating projection."""
    for _ in range(_PROJECTIONS):
        pose = forward(after, after_near)
        before_near = float(inverse(before, pose.translation, pose.rotation, length, near=before_near)[0])
        pose = forward(before, before_near)
        after_near = float(inverse(after, pose.translation, pose.rotation, length, near=after_near)[0])
    return before_near, after_near


def _configuration_of(rigid: Joint, moving: Joint, length: float) -> float:
    """Where on a moving joint a rigid one holds the part."""
    pose = forward(rigid, 0.0)
    return float(inverse(moving, pose.translation, pose.rotation, length)[0])


def _directed(
    piece: FittedPiece, chain: Sequence[FittedPiece], track: PartTrack, inlier: Booleans, noise: MeasurementNoise
) -> Joint:
    """The piece's joint, oriented like the chain or, at its start, in the direction of motion."""
    index = piece.index(inlier)
    c = _smoothed(segment_configurations(piece.joint, index, track, noise))
    moving = _last_moving(chain)
    if moving is not None and moving.kind == piece.joint.kind:
        scale = np.repeat([noise.rotation_length, 1.0], 3)
        old = jacobian(moving, segment_configurations(moving, index[:1], track, noise))[0] * scale
        new = jacobian(piece.joint, c[:1])[0] * scale
        cosine = float(old @ new) / max(float(np.linalg.norm(old) * np.linalg.norm(new)), 1e-12)
        if abs(cosine) > _SAME_DIRECTION:
            return piece.joint if cosine > 0 else reversed_direction(piece.joint)
    away = c - c[0]
    return piece.joint if away[int(np.argmax(np.abs(away)))] >= 0 else reversed_direction(piece.joint)


def _near(
    joint: Joint, row: int, piece: FittedPiece, track: PartTrack, inlier: Booleans, noise: MeasurementNoise
) -> float:
    """The configuration at a row from a local linear fit, which averages noise."""
    index = piece.index(inlier)
    c = segment_configurations(joint, index, track, noise)
    return _line_at(index.astype(float), c, float(row))


def _line_at(x: Floats, c: Floats, at: float) -> float:
    """Value at a place of a line through the nearest rows."""
    nearest = np.sort(np.argsort(np.abs(x - at), kind="stable")[:_SMOOTHED_ROWS])
    if len(nearest) < 3:
        return float(c[nearest].mean())
    return float(np.polyfit(x[nearest] - at, c[nearest], 1)[1])


def _smoothed(c: Floats) -> Floats:
    """(n,) moving average; ends by lines."""
    x = np.arange(len(c), dtype=float)
    if len(c) < 3:
        return c
    half = _SMOOTHED_ROWS // 2
    padded = np.pad(c, half, mode="reflect", reflect_type="odd") if len(c) > half else c
    smooth = np.convolve(padded, np.full(_SMOOTHED_ROWS, 1 / _SMOOTHED_ROWS), mode="valid") if len(c) > half else c
    smooth[0], smooth[-1] = _line_at(x, c, 0.0), _line_at(x, c, x[-1])
    return np.asarray(smooth)


def _observation_std(joint: Joint, measured_by: Joint, rows: Ints, track: PartTrack, noise: MeasurementNoise) -> float:
    """Std of one pose measurement as a configuration: the residuals across the joint, projected along it."""
    error = left_by(joint, rows, track, noise.rotation_length)
    direction = jacobian(measured_by, 0.0)[0]
    moves = float(direction[3:] @ direction[3:]) if measured_by.kind != "rigid" else 1.0
    turns = float(direction[:3] @ direction[:3]) * noise.rotation_length**2 if track.quaternion is not None else 0.0
    share = moves / max(moves + turns, 1e-12)
    along = float(joint.moves)
    position = max(float((error[:, -3:] ** 2).sum(axis=1).mean()) / (3 - along * share), noise.position_white**2)
    variance = moves * position
    if track.quaternion is not None:
        turning = float((error[:, :3] ** 2).sum(axis=1).mean()) / (3 - along * (1 - share))
        variance += turns * noise.rotation_length**2 * max(turning, noise.rotation_white**2)
    return float(np.sqrt(variance)) / max(moves + turns, 1e-12)


def _process_std(piece: FittedPiece, c: Floats, rows: Ints, track: PartTrack, observation_std: float) -> float:
    """Std of the steps beyond the actions' prediction or, without actions, beyond a smooth motion."""
    steps = np.diff(c)
    if len(steps) < 3:
        return 0.0
    if track.action is not None and piece.leader is not None and piece.gain.any():
        sign = 1.0 if np.dot(piece.leader.axis, piece.joint.axis) >= 0 else -1.0
        commanded = np.concatenate([np.zeros((1, 3)), np.cumsum(track.action, axis=0)])[rows]
        residual = steps - sign * np.diff(commanded, axis=0) @ piece.gain
    else:
        residual = steps - _smoothed(steps)
    # A measured step contains the noise of two rows; their covariance with the next step separates it.
    noise_variance = max(-float(np.mean(residual[1:] * residual[:-1])), 0.0)
    variance = float(np.mean(residual**2)) - 2 * noise_variance
    return float(np.sqrt(max(variance, (_FINEST_STEP * observation_std) ** 2)))


def _last_moving(chain: Sequence[FittedPiece]) -> Joint | None:
    """Joint of the last piece that moves."""
    return next((piece.joint for piece in reversed(chain) if piece.joint.moves), None)


def _first_moving(chain: Sequence[FittedPiece]) -> Joint | None:
    """Joint of the first piece that moves."""
    return next((piece.joint for piece in chain if piece.joint.moves), None)
