"""Where the joint really is: what measured poses keep beside the joint, as a function of the configuration.

A wrong axis or pitch shows across the motion, whatever was commanded: with the axis moved by d, the part's origin is
off by (I - R(c)) d, and with a pitch h by h c along the axis. Both are linear, so the fit is a regression; errors of a
tracker wander, so it is made on a first-order autoregression of the residual.

Source: Hamilton, Time Series Analysis, ch. 8 (regression with autocorrelated errors, Cochrane and Orcutt).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.joint import Joint, axis_basis
from micah_plan.automaton.kinematics import forward, jacobian
from micah_plan.automaton.tracks import Track, measuring_links, moving_joint

Floats = NDArray[np.float64]

# Evidence [nats] and size against the scatter that a change of geometry must have: the model's own error is no effect.
_LEAST_EVIDENCE = 20.0
_LEAST_RATIO = 1.0
# Share of the squared residual that held-out rows may keep.
_MOST_LEFT = 0.6
_FOLDS = 4
_FEWEST_ROWS = 20


@dataclass(frozen=True, eq=False)
class GeometryFinding:
    """A change of a joint that held-out poses ask for."""

    effect: Effect
    std: tuple[float, ...]
    evidence: float


@dataclass(frozen=True, eq=False)
class _Rows:
    """One direction across the joint: residual (K,), regressors (K, k), block (K,) for holding out, start (K,)."""

    residual: Floats
    regressors: Floats
    block: NDArray[np.int64]
    starts: NDArray[np.bool_]


def geometry_findings(automaton: HybridAutomaton, tracks: Sequence[Track]) -> tuple[GeometryFinding, ...]:
    """Changes of turning joints that predict held-out poses clearly better; the best one per coordinate."""
    found = []
    for number, link in measuring_links(automaton):
        joint = moving_joint(automaton, number)
        if joint.kind not in ("revolute", "screw"):
            continue
        name = automaton.coordinates[link.coordinate].name
        axial, radial = _across(joint, tracks, number, link.coordinate)
        options = [
            _finding("screw_pitch", name, ("pitch",), axial),
            _finding("axis_offset", name, ("offset_1", "offset_2"), radial),
        ]
        found += [option for option in options if option is not None]
    return tuple(found)


def scatter_across(automaton: HybridAutomaton, tracks: Sequence[Track]) -> tuple[float, float]:
    """Root mean square distance of measured origins from their joints, and length of the lever arm or 1 [m, m/rad]."""
    squared, arms = 0.0, []
    for number, link in measuring_links(automaton):
        joint = moving_joint(automaton, number)
        away, lever = [], []
        for track in tracks:
            c = track.x[:, link.coordinate]
            tangent = jacobian(joint, c)[:, 3:]
            length2 = np.maximum((tangent**2).sum(axis=1, keepdims=True), 1e-12)
            off = track.position[:, number] - forward(joint, c).translation
            off = off - tangent * ((off * tangent).sum(axis=1, keepdims=True) / length2)
            away.append((off**2).sum(axis=1))
            lever.append(np.sqrt(length2[:, 0]))
        squared += float(np.mean(np.concatenate(away)))
        arms.append(float(np.mean(np.concatenate(lever))))
    return float(np.sqrt(squared / len(arms))), float(np.mean(arms))


def _across(joint: Joint, tracks: Sequence[Track], link: int, coordinate: int) -> tuple[_Rows, _Rows]:
    """Residuals along the axis and along the lever arm, with what would explain them."""
    parts: list[tuple[Floats, Floats, Floats, Floats]] = []
    blocks, starts = [], []
    axis, basis = np.array(joint.axis), axis_basis(joint.axis)
    for number, track in enumerate(tracks):
        c = track.x[:, coordinate]
        pose = forward(joint, c)
        away = track.position[:, link] - pose.translation
        tangent = jacobian(joint, c)[:, 3:]
        outward = np.cross(tangent, axis)
        outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-12)
        turn = Rotation.from_rotvec(c[:, None] * axis)
        moved = np.stack([basis[k] - turn.apply(basis[k]) for k in (0, 1)], axis=2)
        parts.append((away @ axis, (away * outward).sum(axis=1), c, (moved * outward[:, :, None]).sum(axis=1)))
        split = 1 if len(tracks) >= _FOLDS else _FOLDS
        blocks.append(number * split + np.arange(len(c)) * split // max(len(c), 1))
        starts.append(np.arange(len(c)) == 0)
    along, out, c, moved = (np.concatenate(column) for column in zip(*parts, strict=True))
    block, first = np.concatenate(blocks) % _FOLDS, np.concatenate(starts)
    return _Rows(along, c[:, None], block, first), _Rows(out, moved, block, first)


def _finding(name: str, coordinate: str, names: tuple[str, ...], rows: _Rows) -> GeometryFinding | None:
    if len(rows.residual) < _FEWEST_ROWS or np.ptp(rows.regressors[:, 0]) < 1e-6:
        return None
    constant = np.ones((len(rows.residual), 1))
    with_it, without = np.hstack([constant, rows.regressors]), constant
    evidence, squared, kept = 0.0, np.zeros(2), np.zeros(2)
    for fold in range(_FOLDS):
        train, test = rows.block != fold, rows.block == fold
        if train.sum() < _FEWEST_ROWS // 2 or not test.any():
            continue
        evidence += _predicts(rows, with_it, train, test) - _predicts(rows, without, train, test)
        for k, design in enumerate((with_it, without)):
            beta = _regression(rows, design, train)[0]
            squared[k] += float(((rows.residual - design @ beta)[test] ** 2).sum())
            # The new joint takes in the effect alone; a constant that makes it fit stays behind as an error.
            kept[k] += float(((rows.residual - design[:, 1:] @ beta[1:])[test] ** 2).sum())
    everything = np.ones(len(rows.residual), dtype=bool)
    beta, covariance, scatter, _ = _regression(rows, with_it, everything)
    size = float(np.std(rows.regressors @ beta[1:]))
    if evidence < _LEAST_EVIDENCE or size < _LEAST_RATIO * scatter or squared[0] > _MOST_LEFT * squared[1]:
        return None
    if kept[0] > _MOST_LEFT * kept[1]:
        return None
    std = np.sqrt(np.maximum(np.diag(covariance)[1:], 0.0))
    pairs = tuple(zip(names, (float(b) for b in beta[1:]), strict=True))
    spread = tuple(float(s) for s in std)
    return GeometryFinding(Effect(name, coordinate, pairs, spread), spread, evidence)


def _predicts(rows: _Rows, design: Floats, train: NDArray[np.bool_], test: NDArray[np.bool_]) -> float:
    """Log likelihood of the test rows' whitened residuals under what the training rows say [nats]."""
    beta, _, scatter, memory = _regression(rows, design, train)
    white, _ = _whitened(rows, rows.residual - design @ beta, memory)
    left = white[test]
    return float(-0.5 * np.sum((left / scatter) ** 2) - left.size * np.log(scatter))


def _regression(rows: _Rows, design: Floats, chosen: NDArray[np.bool_]) -> tuple[Floats, Floats, float, float]:
    """Coefficients, covariance, scatter of the whitened residual and its autoregression, over the chosen rows."""
    memory = 0.0
    beta: Floats = np.zeros(design.shape[1])
    covariance: Floats = np.eye(design.shape[1])
    scatter = 1.0
    for _ in range(4):
        target, _ = _whitened(rows, rows.residual, memory)
        columns = np.stack([_whitened(rows, column, memory)[0] for column in design.T], axis=1)
        a, b = columns[chosen], target[chosen]
        gram = a.T @ a + 1e-12 * np.eye(a.shape[1])
        beta = np.asarray(np.linalg.solve(gram, a.T @ b))
        scatter = max(float(np.sqrt(np.mean((b - a @ beta) ** 2))), 1e-9)
        covariance = np.asarray(scatter**2 * np.linalg.inv(gram))
        left = rows.residual - design @ beta
        follows = chosen & ~rows.starts
        before = np.roll(left, 1)
        power = float((before[follows] ** 2).sum())
        memory = float(np.clip((left[follows] * before[follows]).sum() / power, 0.0, 0.98)) if power > 0 else 0.0
    return beta, covariance, scatter, memory


def _whitened(rows: _Rows, values: Floats, memory: float) -> tuple[Floats, float]:
    """Values less what the row before foretells; the first row of a run is scaled to the same variance."""
    before = np.roll(values, 1)
    first = np.sqrt(max(1.0 - memory**2, 1e-6))
    return np.where(rows.starts, first * values, values - memory * before), first
