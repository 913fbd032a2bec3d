"""The evidence ln L(s, t, M) of every segment, row by row: a filter per candidate start and hypothesis.

One generative model serves all kinds: measured pose = joint at its configuration + white noise + a slowly wandering
tracker error (Ornstein-Uhlenbeck). Across the joint a filter follows the wander; along it another follows the
configuration (see motion.py). Rigid is the case without motion, with its pose profiled out in closed form from running
sums. So a revolute joint that rests is no likelier than a rigid one, and only the parameter count tells them apart.

Source: MICAH, ln L ≈ ln p(y | M, θ̂, a) - k/2 ln(t - s).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.joint import JointKind
from micah_plan.learn.hypothesis import JointView
from micah_plan.learn.motion import MotionModels, fit_motion
from micah_plan.learn.noise import NoiseScales
from micah_plan.learn.refine import parameter_count
from micah_plan.learn.track import PartTrack

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

_LOG_2PI = float(np.log(2 * np.pi))
_JUMP = 8.0  # how much wider than an ordinary innovation a jump of the tracker is
RIGID = -1  # index of the rigid model, which needs no hypothesis


@dataclass(frozen=True, eq=False)
class EvidenceColumn:
    """Evidence of all open segments up to one row.

    Attributes:
        starts: (m,) first rows of the segments.
        log_evidence: (m, k) for each candidate kind; -inf where no hypothesis of that kind exists.
        hypothesis: (m, k) index of the best hypothesis of that kind; RIGID for rigid.
    """

    starts: Ints
    log_evidence: Floats
    hypothesis: Ints


class _Wander:
    """Filter of signals made of a wandering error plus white noise, for a growing set of starts.

    `spread` (m,) is the variance of the wander before a row, `state` (m, ...) its mean.
    """

    def __init__(self, white: float, wander: float, shape: tuple[int, ...]) -> None:
        self.white, self.wander = white, wander
        self.state, self.spread = np.zeros((0, *shape)), np.zeros(0)

    def open(self) -> None:
        self.state = np.concatenate([self.state, np.zeros((1, *self.state.shape[1:]))])
        self.spread = np.append(self.spread, self.wander)

    def advance(self, value: Floats, kept: float, observed: bool) -> tuple[Floats, Floats]:
        """Innovations (m, ...) and their variances (m,) of the row's value; then on to the next row."""
        variance = self.spread + self.white
        innovation = value - self.state
        if observed:
            trust = self.spread / variance
            self.state += trust.reshape(-1, *(1,) * (self.state.ndim - 1)) * innovation
            self.spread = self.spread * (1 - trust)
        self.state *= kept
        self.spread = kept**2 * self.spread + self.wander * (1 - kept**2)
        return innovation, variance

    def keep(self, index: Ints) -> None:
        self.state, self.spread = self.state[index], self.spread[index]


class EvidenceStream:
    """Evidence of the segments of a track under a pool of hypotheses, one row at a time.

    Args:
        track: n rows.
        inlier: (n,) rows that count; the others are bridged.
        noise: noise scales.
        views: the pool, all of moving kinds.
        kinds: candidate kinds, in the order of the evidence's columns.
        use_actions: whether motion is predicted from the actions (Act-CHAMP).
        rest: prior probability that a part on a moving joint rests in a step, where actions do not tell.
        along: whether the motion along the joints counts; if not, the evidence is that of the poses across them.
    """

    def __init__(
        self,
        track: PartTrack,
        inlier: Bools,
        noise: NoiseScales,
        views: Sequence[JointView],
        kinds: tuple[JointKind, ...],
        use_actions: bool,
        rest: float,
        along: bool = True,
    ) -> None:
        self.along = along
        self.track, self.inlier, self.kinds, self.views = track, inlier, kinds, tuple(views)
        self.has_orientation = track.quaternion is not None
        steps = np.diff(track.time, prepend=track.time[0])
        self._kept = np.exp(-steps / max(noise.wander_time, 1e-12))
        action = track.action if use_actions else None
        self.motion: MotionModels = fit_motion(views, action, inlier, 1 - self._kept**2, rest)
        h = len(self.views)
        self._configuration = np.array([v.configuration for v in views]).reshape(h, len(track))
        self._error = np.array([v.error for v in views]).reshape(h, len(track), 6)
        self._drift = np.zeros((h, len(track)))
        if action is not None:
            self._drift[:, 1:] = self.motion.gain @ action[:-1].T
        self._usual_step = (1 - self.motion.rest) * self.motion.mean
        self._drift += self._usual_step[:, None]
        self._white = np.array([v.white_variance for v in views])
        self._wander = np.array([v.wander_variance for v in views])
        counts = [parameter_count(v.hypothesis.joint.kind, self.has_orientation) for v in views]
        self._parameters = np.array(counts, dtype=float) + (self.motion.parameters if along else 0.0)
        self._rotation4 = 2 * track.quaternion if track.quaternion is not None else None
        p2, b2 = noise.position_white**2, noise.position_wander**2
        r2, d2 = noise.rotation_white**2, noise.rotation_wander**2
        self._across = [_Wander(p2, b2, (h, 3)), _Wander(r2, d2, (h, 3))]
        # Rigid: the filter of the pose itself and of the constant 1 share a gain, so they are one signal.
        self._fixed = [_Wander(p2, b2, (4,)), _Wander(r2, d2, (5,))]
        self._sums = [np.zeros((0, 2)), np.zeros((0, 2))]  # Σ 1·1/S and Σ y·y/S; the vectors Σ 1·y/S are next
        self._crosses = [np.zeros((0, 3)), np.zeros((0, 4))]
        self._along, self._along_spread = np.zeros((0, h)), np.zeros((0, h))
        self._still_spread = np.zeros((0, h))
        self._moving = np.zeros((0, h))
        self._log_dets = np.zeros((0, 2))
        self._tail = np.zeros(0)
        self._jumps = noise.outlier_ratio
        self._count = np.zeros(0)
        self.starts: Ints = np.zeros(0, dtype=np.int64)
        self.row = -1

    def advance(self) -> EvidenceColumn:
        """Open a segment at the next row and take that row into all open segments."""
        self.row += 1
        self._open()
        seen = bool(self.inlier[self.row])
        channels = 2 if self.has_orientation else 1
        squares, peaks = np.zeros_like(self._moving), np.zeros(len(self.starts))
        kept = self._kept[self.row + 1] if self.row + 1 < len(self.track) else 1.0
        for i in range(channels):
            value = self._error[:, self.row, 3:] if i == 0 else self._error[:, self.row, :3]
            innovation, variance = self._across[i].advance(value, kept, seen)
            squares += (innovation**2).sum(axis=2) / variance[:, None]
            peaks -= 1.5 * (_LOG_2PI + np.log(variance))
        across = peaks[:, None] + self._tails(squares)[0]
        self._advance_fixed(kept, seen)
        along = self._advance_along(seen) if self.along else 0.0
        if seen:
            self._moving += across + along
            self._count += 1
        return self._column()

    def keep(self, index: Ints) -> None:
        """Go on with these of the open segments only (indices into the last column)."""
        for channel in (*self._across, *self._fixed):
            channel.keep(index)
        self._sums = [s[index] for s in self._sums]
        self._crosses = [s[index] for s in self._crosses]
        for name in ("_along", "_along_spread", "_still_spread", "_moving", "_log_dets", "_tail", "_count", "starts"):
            setattr(self, name, getattr(self, name)[index])

    def _open(self) -> None:
        h = len(self.views)
        for channel in (*self._across, *self._fixed):
            channel.open()
        self._sums = [np.vstack([s, np.zeros((1, s.shape[1]))]) for s in self._sums]
        self._crosses = [np.vstack([s, np.zeros((1, s.shape[1]))]) for s in self._crosses]
        self._along = np.vstack([self._along, self._configuration[:, self.row]])
        self._along_spread = np.vstack([self._along_spread, np.full(h, np.inf)])
        self._still_spread = np.vstack([self._still_spread, self._wander])
        self._moving = np.vstack([self._moving, np.zeros(h)])
        self._log_dets = np.vstack([self._log_dets, np.zeros(2)])
        self._tail = np.append(self._tail, 0.0)
        self._count = np.append(self._count, 0.0)
        self.starts = np.append(self.starts, self.row)

    def _tails(self, squares: Floats) -> tuple[Floats, Floats]:
        """ln of the mixture (1 - γ) N + γ (a jump, `_JUMP` times as wide) over N's peak, and the share of N.

        Args:
            squares: of whitened innovations, summed over the 3 or 6 channels of a row.
        """
        size = 6 if self.has_orientation else 3
        normal = np.log1p(-self._jumps) - 0.5 * squares
        jump = np.log(self._jumps) - size * np.log(_JUMP) - 0.5 * squares / _JUMP**2
        total = np.logaddexp(normal, jump)
        return total, np.exp(normal - total)

    def _advance_fixed(self, kept: float, seen: bool) -> None:
        """Take the row into the running sums of the rigid model, as much of it as is no jump."""
        taken = []
        squares = np.zeros(len(self.starts))
        for i in range(2 if self.has_orientation else 1):
            pose = self.track.position[self.row] if i == 0 else self._rotation4[self.row]  # type: ignore[index]
            innovation, variance = self._fixed[i].advance(np.append(1.0, pose), kept, seen)
            ones, values = innovation[:, 0], innovation[:, 1:]
            weight = self._sums[i][:, :1]
            mean = self._crosses[i] / np.maximum(weight, 1e-300)
            missed = np.where(weight > 0, values - ones[:, None] * mean, 0.0)
            squares += (missed**2).sum(axis=1) / variance
            taken.append((ones, values, variance))
        if not seen:
            return
        total, share = self._tails(squares)
        self._tail += total + 0.5 * share * squares
        for i, (ones, values, variance) in enumerate(taken):
            self._sums[i][:, 0] += share * ones**2 / variance
            self._sums[i][:, 1] += share * (values**2).sum(axis=1) / variance
            self._crosses[i] += (share / variance * ones)[:, None] * values
            self._log_dets[:, i] += 1.5 * (_LOG_2PI + np.log(variance))

    def _advance_along(self, seen: bool) -> Floats:
        """ln p of the configuration's innovation, less what the across channels already counted for its direction."""
        still = self._still_spread + self._white
        counted = -0.5 * (_LOG_2PI + np.log(still))
        kept = self._kept[self.row + 1] if self.row + 1 < len(self.track) else 1.0
        updated = self._still_spread * (self._white / still) if seen else self._still_spread
        self._still_spread = kept**2 * updated + self._wander * (1 - kept**2)
        renewed = self._wander * (1 - self._kept[self.row] ** 2)
        first = np.isinf(self._along_spread)
        still_there = np.where(first, 0.0, self._along_spread + renewed)
        spread = still_there + np.where(first, 0.0, self.motion.spread)
        self._along = self._along + np.where(first, 0.0, self._drift[:, self.row])
        if not seen:
            self._along_spread = np.where(first, np.inf, spread)
            return np.zeros_like(counted)
        variance = spread + self._white
        measured = self._configuration[:, self.row]
        innovation = np.where(first, 0.0, measured - self._along)
        quiet = still_there + self._white  # not variance - motion.spread, which rounds to 0 where steps are huge
        density = self.motion.log_density(innovation + self._usual_step, quiet)
        density = np.where(first, counted, density)
        trust = np.where(first, 1.0, spread / variance)
        self._along = self._along + trust * (measured - self._along)
        self._along_spread = np.where(first, self._white, spread * (1 - trust))
        return np.asarray(density - counted)

    def _column(self) -> EvidenceColumn:
        m, rows = len(self.starts), self._count[:, None]
        table = np.full((m, len(self.kinds)), -np.inf)
        which = np.full((m, len(self.kinds)), RIGID, dtype=np.int64)
        penalised = self._moving - _penalty(self._parameters, rows)
        for column, kind in enumerate(self.kinds):
            if kind == "rigid":
                size = np.array([float(parameter_count("rigid", self.has_orientation))])
                table[:, column] = self._rigid() - _penalty(size, rows)[:, 0]
                continue
            members = np.array([i for i, v in enumerate(self.views) if v.hypothesis.joint.kind == kind], dtype=np.int64)
            if len(members):
                best = members[np.argmax(penalised[:, members], axis=1)]
                which[:, column] = best
                table[:, column] = penalised[np.arange(m), best]
        return EvidenceColumn(self.starts.copy(), table, which)

    def _rigid(self) -> Floats:
        total = self._tail.copy()
        for i in range(2 if self.has_orientation else 1):
            ones, squares = self._sums[i][:, 0], self._sums[i][:, 1]
            explained = (self._crosses[i] ** 2).sum(axis=1) / np.maximum(ones, 1e-300)
            total -= 0.5 * np.maximum(squares - explained, 0.0) + self._log_dets[:, i]
        return total


def _penalty(parameters: Floats, rows: Floats) -> Floats:
    """k/2 ln n (m, h) of models with k (h,) parameters on n (m, 1) rows.

    Fewer rows than parameters fit exactly and would make them free; they pay as for k rows.
    """
    return np.asarray(0.5 * parameters * np.log(np.maximum(rows, parameters)))
