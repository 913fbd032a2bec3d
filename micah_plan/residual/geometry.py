"""Corrections of a joint's geometry: measured poses off the joint as functions of the configuration.

A wrong axis or pitch shows across the motion that orientations give, for any commands: with the axis moved by d, the
part's origin is off by (I - R(c)) d, and with a pitch h by h c along the axis. Both are linear, so the fit is a
regression; tracker errors wander, so the residual is modelled as a first-order autoregression.

Source: Hamilton, Time Series Analysis, ch. 8 (regression with autocorrelated errors, Cochrane and Orcutt).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from micah_plan.arrays import SURE_STDS, Floats, Ints, earlier_rows
from micah_plan.automaton.digits import DIGITS
from micah_plan.automaton.effects.add import is_possible
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.joint import Joint, axis_basis
from micah_plan.automaton.kinematics import ROTATION_LENGTH, forward, inverse, jacobian
from micah_plan.automaton.link_motion import link_motions
from micah_plan.automaton.tracks import Track, measuring_links
from micah_plan.residual import messages
from micah_plan.residual.likelihood import EVIDENCE_PER_ROW

# Evidence [nats] that a change of geometry must have, in all and per row; what wanders can look like one.
_LEAST_EVIDENCE = 20.0
# Share of the squared residual that held-out rows may keep with the changed joint alone.
_MOST_LEFT = 0.6
_FOLDS = 4
_FEWEST_ROWS = 20
# Weight of orientation against position at which the angle is read from orientation alone [m/rad].
_BY_ORIENTATION = 1e3
# Degrees of the curves of poses off a joint (a high one extrapolates badly).
_DEGREES = (0, 1, 3, 5)
# What the digits of a model leave of exact data.
_EXACT = 10.0**-DIGITS


@dataclass(frozen=True, eq=False)
class DirectFinding:
    """An effect identified from held-out poses, independent of the motion model."""

    effect: Effect
    std: tuple[float, ...]
    evidence: float


@dataclass(frozen=True, eq=False)
class _Rows:
    """Pose errors off the joint, in one or several directions of its frame.

    Attributes:
        residual: (K,) [m]; regressors: (K, k); block: (K,) for holding out; starts: (K,) whether a run starts there.
        direction: (K,) each has a scatter, a memory and a constant of its own.
    """

    residual: Floats
    regressors: Floats
    block: Ints
    starts: NDArray[np.bool_]
    direction: Ints

    @property
    def constants(self) -> Floats:
        """(K, directions) one column per direction."""
        return np.asarray(self.direction[:, None] == np.arange(self.direction.max() + 1), dtype=float)


def geometry_findings(automaton: HybridAutomaton, tracks: Sequence[Track]) -> tuple[DirectFinding, ...]:
    """Corrections of turning joints with significant evidence on held-out poses; the best one per coordinate."""
    findings = []
    for number, link in measuring_links(automaton):
        joint, *others = link_motions(automaton)[number].joints
        if others or not joint.turns:
            continue
        name = automaton.coordinates[link.coordinate].name
        axial, radial = _across(joint, tracks, number, link.coordinate)
        options = [
            _finding("screw_pitch", name, ("pitch",), axial),
            _finding("axis_offset", name, ("offset_1", "offset_2"), radial),
        ]
        findings += [option for option in options if option is not None]
    return tuple(findings)


def transverse_rms(automaton: HybridAutomaton, tracks: Sequence[Track]) -> tuple[float, float]:
    """Root mean square distance of measured origins from their joints, and length of the lever arm or 1 [m, m/rad]."""
    squared, arms = 0.0, []
    for number, link in measuring_links(automaton):
        path, c = link_motions(automaton)[number], np.concatenate([track.x[:, link.coordinate] for track in tracks])
        length2 = (path.tangents(c)[:, 3:] ** 2).sum(axis=1)
        squared += float(
            np.mean(np.concatenate([(off_joint_error(automaton, t, number)[:, :3] ** 2).sum(axis=1) for t in tracks]))
        )
        arms.append(float(np.mean(np.sqrt(np.maximum(length2, 1e-12)))))
    return float(np.sqrt(squared / len(arms))), float(np.mean(arms))


def systematic_transverse_error(automaton: HybridAutomaton, tracks: Sequence[Track]) -> float:
    """Lower bound on the autocorrelated distance of measured origins from their joints [m]; white noise gives 0."""
    lasting2: list[float] = []
    for number, _ in measuring_links(automaton):
        away = [off_joint_error(automaton, track, number)[:, :3] for track in tracks]
        products = np.concatenate([(series[1:] * series[:-1]).sum(axis=1) for series in away])
        if len(products) > 1:
            lasting2.append(float(products.mean() - SURE_STDS * products.std() / np.sqrt(len(products))))
    return float(np.sqrt(max(float(np.mean(lasting2)), 0.0))) if lasting2 else 0.0


def off_joint_error(automaton: HybridAutomaton, track: Track, link: int) -> Floats:
    """(T, 6) measured minus predicted pose of a link without the part along the motion [m, rad], in the part's frame.

    The component along the motion is not part of it, since it is in the configuration. The rotation is 0 where
    orientation was not measured. A motion keeps its direction in the part's frame, and so does the error of a wrong
    joint.
    """
    path, position = link_motions(automaton)[link], track.position[:, link]
    rotation = None if track.quaternion is None else Rotation.from_quat(track.quaternion[:, link])
    c = path.configurations(position, rotation)
    pose, tangent = path.poses(c), path.tangents(c)
    frame = pose.rotation.inv()
    turn = np.zeros_like(position) if rotation is None else (rotation * pose.rotation.inv()).as_rotvec()
    scale = np.repeat([1.0, ROTATION_LENGTH if rotation is not None else 0.0], 3)
    away = scale * np.hstack([frame.apply(position - pose.translation), frame.apply(turn)])
    along = scale * np.hstack([frame.apply(tangent[:, 3:]), frame.apply(tangent[:, :3])])
    length2 = np.maximum((along**2).sum(axis=1, keepdims=True), 1e-12)
    away = away - along * ((away * along).sum(axis=1, keepdims=True) / length2)
    return np.asarray(away / np.repeat([1.0, ROTATION_LENGTH], 3))


@dataclass(frozen=True)
class OffJointError:
    """Configuration-dependent pose errors off a joint: their root mean squares [m, rad]."""

    coordinate: str
    position: float
    rotation: float
    evidence: float

    def __str__(self) -> str:
        position, rotation = (size if size > _EXACT else 0.0 for size in (self.position, self.rotation))
        return messages.poses_off_joint(self.coordinate, position, rotation)


def off_joint_errors(automaton: HybridAutomaton, tracks: Sequence[Track]) -> tuple[OffJointError, ...]:
    """`off_joint_error_of` for every measured coordinate."""
    findings = [
        off_joint_error_of(
            automaton.coordinates[link.coordinate].name,
            [track.x[:, link.coordinate] for track in tracks],
            [off_joint_error(automaton, track, number) for track in tracks],
        )
        for number, link in measuring_links(automaton)
    ]
    return tuple(finding for finding in findings if finding is not None)


def off_joint_error_of(coordinate: str, places: Sequence[Floats], away: Sequence[Floats]) -> OffJointError | None:
    """The off-joint error as a smooth function of the configuration; None if it is not significant.

    Args:
        places: configurations (T,) of each run, away: (T, 6) as `off_joint_error` gives it.
    """
    c, every = np.concatenate(list(places)), np.concatenate(list(away))
    if len(c) < _FEWEST_ROWS or np.ptp(c) < 1e-9:
        return None
    every_curve = np.polynomial.legendre.legvander(2.0 * (c - c.min()) / np.ptp(c) - 1.0, max(_DEGREES))
    block, starts = _blocks([len(place) for place in places])
    fitted, total = np.zeros_like(every), 0.0
    for k in range(every.shape[1]):
        if np.std(every[:, k]) < _EXACT:
            continue
        tried = []
        for degree in _DEGREES:
            curves = every_curve[:, : degree + 1]
            rows = _Rows(every[:, k], curves, block, starts, np.zeros(len(c), dtype=np.int64))
            tried.append((*_held_out(rows, np.zeros((len(c), 0))), curves, rows))
        evidence, residual, curves, rows = max(tried, key=lambda trial: trial[0])
        if evidence > max(_LEAST_EVIDENCE, EVIDENCE_PER_ROW * len(c)) and residual < _MOST_LEFT:
            total += evidence
            fitted[:, k] = curves @ _regression(rows, curves, np.ones(len(c), dtype=bool))[0]
    sizes = np.sqrt((fitted**2).reshape(-1, 2, 3).sum(axis=2).mean(axis=0))
    if sizes.max() < _EXACT:
        return None
    return OffJointError(coordinate, float(sizes[0]), float(sizes[1]), total)


def _across(joint: Joint, tracks: Sequence[Track], link: int, coordinate: int) -> tuple[_Rows, _Rows]:
    """(along the axis, across the lever arm) pose errors with the regressors that would explain them.

    Where orientation was measured, the angle comes from it alone: then a moved axis also shows along the motion.
    """
    along, out, tangential, c = [], [], [], []
    axis, basis = np.array(joint.axis), axis_basis(joint.axis)
    by_out, by_tangent = [], []
    for track in tracks:
        turned = None if track.quaternion is None else Rotation.from_quat(track.quaternion[:, link])
        angle = track.x[:, coordinate]
        if turned is not None and joint.turns and not joint.climbs:
            angle = inverse(joint, track.position[:, link], turned, _BY_ORIENTATION, near=angle)
        away = track.position[:, link] - forward(joint, angle).translation
        tangent = jacobian(joint, angle)[:, 3:]
        tangent = tangent - np.outer(tangent @ axis, axis)
        tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12)
        outward = np.cross(tangent, axis)
        turn = Rotation.from_rotvec(angle[:, None] * axis)
        moved = np.stack([basis[k] - turn.apply(basis[k]) for k in (0, 1)], axis=2)
        along.append(away @ axis)
        c.append(angle)
        out.append((away * outward).sum(axis=1))
        by_out.append((moved * outward[:, :, None]).sum(axis=1))
        if turned is not None and joint.turns and not joint.climbs:
            tangential.append((away * tangent).sum(axis=1))
            by_tangent.append((moved * tangent[:, :, None]).sum(axis=1))
    block, first = _blocks([len(track.x) for track in tracks])
    axial = _Rows(np.concatenate(along), np.concatenate(c)[:, None], block, first, np.zeros(len(block), dtype=np.int64))
    count = 1 + bool(tangential)
    radial = _Rows(
        np.concatenate([*out, *tangential]),
        np.concatenate([*by_out, *by_tangent]),
        np.tile(block, count),
        np.tile(first, count),
        np.repeat(np.arange(count), len(block)),
    )
    return axial, radial


def _finding(name: str, coordinate: str, names: tuple[str, ...], rows: _Rows) -> DirectFinding | None:
    if len(rows.residual) < _FEWEST_ROWS or np.ptp(rows.regressors[:, 0]) < 1e-6:
        return None
    without = rows.constants
    with_it, count = np.hstack([without, rows.regressors]), without.shape[1]
    everything = np.ones(len(rows.residual), dtype=bool)
    beta, covariance, _, _ = _regression(rows, with_it, everything)
    evidence, residual = _held_out(rows, without)
    if evidence < max(_LEAST_EVIDENCE, EVIDENCE_PER_ROW * len(rows.residual)) or residual > _MOST_LEFT:
        return None
    std = np.sqrt(np.maximum(np.diag(covariance)[count:], 0.0))
    pairs = tuple(zip(names, (float(b) for b in beta[count:]), strict=True))
    spread = tuple(float(s) for s in std)
    effect = Effect(name, coordinate, pairs, spread)
    return DirectFinding(effect, spread, evidence) if is_possible(effect) else None


def _held_out(rows: _Rows, without: Floats) -> tuple[float, float]:
    """(evidence for the regressors given others (K, j) [nats], remaining share of squared errors).

    Both on held-out blocks.
    """
    with_it, count = np.hstack([without, rows.regressors]), without.shape[1]
    everything = np.ones(len(rows.residual), dtype=bool)
    unit = _regression(rows, with_it, everything)[2][rows.direction]
    evidence, kept = 0.0, np.zeros(2)
    for fold in range(_FOLDS):
        train, test = rows.block != fold, rows.block == fold
        if train.sum() < _FEWEST_ROWS // 2 or not test.any():
            continue
        for k, (design, sign) in enumerate(((with_it, 1.0), (without, -1.0))):
            fitted, _, scatter, memory = _regression(rows, design, train)
            missed, spread = rows.residual - design @ fitted, scatter[rows.direction][test]
            foretold = _whitened(rows, missed[:, None], memory)[test, 0]
            evidence -= sign * float(0.5 * np.sum((foretold / spread) ** 2) + np.log(spread).sum())
            # The new joint takes in the effect alone; a constant that makes it fit stays behind as an error.
            effect = design[:, count:] @ fitted[count:]
            kept[k] += float((((rows.residual - effect) / unit)[test] ** 2).sum())
    return evidence, float(kept[0] / max(kept[1], 1e-300))


def _blocks(rows: Sequence[int]) -> tuple[Ints, NDArray[np.bool_]]:
    """(K,) fold of each row: its run, or part of the few runs; and whether a run starts there."""
    split = 1 if len(rows) >= _FOLDS else _FOLDS
    blocks = [number * split + np.arange(count) * split // max(count, 1) for number, count in enumerate(rows)]
    return np.concatenate(blocks) % _FOLDS, np.concatenate([np.arange(count) == 0 for count in rows])


def _regression(rows: _Rows, design: Floats, chosen: NDArray[np.bool_]) -> tuple[Floats, Floats, Floats, Floats]:
    """Coefficients with covariance, and per direction the std and autocorrelation of the residual."""
    count = int(rows.direction.max()) + 1
    memory, scatter = np.zeros(count), np.ones(count)
    beta: Floats = np.zeros(design.shape[1])
    covariance: Floats = np.eye(design.shape[1])
    for _ in range(4):
        whitened = _whitened(rows, np.column_stack([design, rows.residual]), memory)[chosen]
        columns, target = whitened[:, :-1], whitened[:, -1]
        direction = rows.direction[chosen]
        unit = scatter[direction]
        a, b = columns / unit[:, None], target / unit
        gram = a.T @ a
        gram = gram + 1e-12 * np.trace(gram) * np.eye(a.shape[1])
        beta = np.asarray(np.linalg.solve(gram, a.T @ b))
        covariance = np.asarray(np.linalg.inv(gram))
        missed, residual = target - columns @ beta, rows.residual - design @ beta
        before = earlier_rows(residual, 1, axis=0)
        for k in range(count):
            scatter[k] = max(float(np.sqrt(np.mean(missed[direction == k] ** 2))), 1e-9)
            follows = chosen & ~rows.starts & (rows.direction == k)
            power = float((before[follows] ** 2).sum())
            product = float((residual[follows] * before[follows]).sum())
            memory[k] = float(np.clip(product / power, 0.0, 0.98)) if power > 0 else 0.0
    return beta, covariance, scatter, memory


def _whitened(rows: _Rows, values: Floats, memory: Floats) -> Floats:
    """Values (K, j) minus their autoregressive prediction; the first row of a run is scaled to the same variance."""
    memory_of_run = memory[rows.direction]
    first = np.sqrt(np.maximum(1.0 - memory_of_run**2, 1e-6))
    white = values - memory_of_run[:, None] * earlier_rows(values, 1, axis=0)
    white[rows.starts] = first[rows.starts, None] * values[rows.starts]
    return white
