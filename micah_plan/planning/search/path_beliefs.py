"""Cheap belief prediction along many paths of the roadmaps at once.

Variances are per coordinate, without correlations. Process and measurement noise are diagonal, so this is the
filter of the transcription where resets do not couple coordinates, and an estimate where they do. As there, every
measurement is as precise as it is at the mode and at the place that the path leads through.

Source: Prentice and Roy, "The belief roadmap", IJRR 2009, for searching roadmaps for paths that localise.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from micah_plan.arrays import Floats, Ints
from micah_plan.automaton.hybrid import Edge, Mode
from micah_plan.automaton.step_noise import free_gain_std, free_process_std
from micah_plan.planning.limits import Limits
from micah_plan.planning.plan_cost import in_steps, variance_cost
from micah_plan.planning.search.roadmap import JoinedRoadmap
from micah_plan.planning.zero_time_transitions import stds_of
from micah_plan.task.problem import Problem

# Steps added at the end for measurements only: at most this many, and only while each narrows the belief by at least 2
# %.
MOST_LOCALISING_STEPS = 20
WORTH_A_STEP = 0.98


class PathBeliefs:
    """Variances (p, n) of p beliefs, each moving along the vertices of a joined roadmap."""

    def __init__(self, problem: Problem, limits: Limits, roadmap: JoinedRoadmap, points: Mapping[str, Floats]) -> None:
        """Args: the problem, its limits, the roadmap, and by mode the states (v, n) of its vertices."""
        automaton = problem.automaton
        self.problem, self.limits = problem, limits
        self.index = {name: i for i, name in enumerate(roadmap.graphs)}
        self.points = np.concatenate([points[name] for name in roadmap.graphs])
        sizes = [len(points[name]) for name in roadmap.graphs]
        self.mode_of = np.repeat(np.arange(len(sizes)), sizes)
        self.edge_of = {
            (int(i + roadmap.offsets[roadmap.ends[edge][0]]), int(j + roadmap.offsets[roadmap.ends[edge][1]])): edge
            for edge in sorted(roadmap.exits, reverse=True)
            for i, j in roadmap.exits[edge]
        }
        modes = [automaton.mode(name) for name in roadmap.graphs]
        sensing = [automaton.sensing(mode) for mode in modes]
        # Per mode (q, ...): inverse input matrix, process variance, variance of the gain, std measured and its growth.
        self._inverse = np.array([np.linalg.pinv(mode.B) for mode in modes])
        self._process = np.square([free_process_std(automaton, mode) for mode in modes])
        self._gain = np.square([free_gain_std(automaton, mode) for mode in modes])
        self._std, self._growth = (
            np.array([getattr(sensor, name) for sensor in sensing]) for name in ("std", "growth")
        )
        self._light = sensing[0].at
        self._k = problem.settings.sigmas

    def start(self, vertex: int) -> Floats:
        """(n,) variance after feedback has corrected an initial deviation of k standard deviations."""
        mode = self.problem.automaton.mode(list(self.index)[self.mode_of[vertex]])
        variance = np.square(np.array([self.problem.start.std], dtype=float))
        for pin in mode.pins:
            variance[:, pin.coordinate] = _combined_variance(variance[:, pin.coordinate], np.array([pin.std**2]))
        for _ in range(steps_to_correct_start(self.problem, self.limits, mode)):
            variance = self._measured(variance, self.points[[vertex]], self.mode_of[[vertex]])
        return np.asarray(variance[0])

    def hop(self, variance: Floats, origin: Ints, end: Ints) -> tuple[Floats, Floats, Floats]:
        """Variances (p, n) after each moved from a vertex (p,) to a neighbour (p,).

        Returns:
            the variances, the steps (p,) that going k-sigma deep into a guard costs, and the steps (p,) taken at least.
        """
        mode, delta = self.mode_of[origin], self.points[end] - self.points[origin]
        moves = mode == self.mode_of[end]
        u = np.abs(np.einsum("pmn,pn->pm", self._inverse[mode], delta)) / self.limits.max_step
        least = np.where(moves, u.max(axis=1, initial=0.0), 0.0)
        # A path of more steps than a plan may have is useless, however certain: so no more of them are followed.
        count = np.ceil(least / self.problem.settings.pace - 1e-9)
        count = np.minimum(count, self.problem.settings.max_knots).astype(np.int64)
        variance = variance.copy()
        for step in range(int(count.max(initial=0))):
            on = step < count
            each = delta[on] / count[on, None]
            x = self.points[origin[on]] + each * (step + 1.0)
            moving = variance[on] + self._gain[mode[on]] * each**2
            variance[on] = self._measured(moving, x, mode[on])
        overshoot = np.zeros(len(origin))
        leaves = np.flatnonzero(~moves)
        taken = np.array(
            [self.edge_of[i, j] for i, j in zip(origin[leaves].tolist(), end[leaves].tolist(), strict=True)]
        )
        for number in np.unique(taken).tolist():
            on, edge = leaves[taken == number], self.problem.automaton.edges[int(number)]
            overshoot[on] = self._overshoot(edge, variance[on])
            variance[on] = self._after(edge, variance[on])
        return variance, overshoot, least + overshoot

    def ending(self, variance: Floats, vertex: Ints, spare: Floats) -> Floats:
        """(p,) cost of the final variance in steps, with measurements at the goal as long as they pay.

        Args:
            spare: (p,) steps left for it.
        """
        index = list(self.problem.goal.indices)
        tolerance = np.array([tol for _, _, tol in self.problem.goal.target])
        before = np.full(len(variance), np.inf)
        open_ = np.full(len(variance), bool(index))
        for step in range(MOST_LOCALISING_STEPS):
            prior = variance + self._process[self.mode_of[vertex]]
            widest = np.max(self._k * np.sqrt(prior[:, index]) / tolerance, axis=1, initial=0.0)
            open_ &= (widest > 1.0) & (widest <= WORTH_A_STEP * before) & (step < spare)
            if not open_.any():
                break
            before = np.where(open_, widest, before)
            at = vertex[open_]
            variance = variance.copy()
            variance[open_] = self._measured(variance[open_], self.points[at], self.mode_of[at])
        return np.broadcast_to(in_steps(self.problem, variance_cost(self.problem, variance.T)), len(variance))

    def _measured(self, variance: Floats, x: Floats, mode: Ints) -> Floats:
        """One step's process noise, then one measurement at x (p, n)."""
        prior = variance + self._process[mode]
        observed = np.square(self._std[mode])
        if self._light:
            away = np.array([x[:, i] - value for i, value in self._light])
            observed = observed + np.square(self._growth[mode]) * np.square(away).sum(axis=0)[:, None]
        return _combined_variance(prior, observed)

    def _overshoot(self, edge: Edge, variance: Floats) -> Floats:
        """(p,) steps from a guard's boundary to where it holds with the planned confidence."""
        deepest = np.zeros(len(variance))
        free = self.problem.automaton.mode(edge.source).free
        for half_space, stds in zip(edge.guard.half_spaces, stds_of(edge), strict=True):
            a = np.array(half_space.a)
            if not a[free].any():
                continue
            std = np.sqrt(variance @ a**2 + stds**2)
            deepest = np.maximum(deepest, self._k * std / float(np.abs(a) @ self.limits.speed))
        return deepest

    def _after(self, edge: Edge, variance: Floats) -> Floats:
        """The variances after a transition: through the reset, and with the information of the contact."""
        automaton = self.problem.automaton
        if edge.reset.A is not None:
            variance = variance @ np.square(np.array(edge.reset.A)).T
        variance, located = variance.copy(), automaton.pins_located_by(edge)
        for pin in automaton.mode(edge.target).pins:
            before, pinned = variance[:, pin.coordinate], np.full(len(variance), pin.std**2)
            variance[:, pin.coordinate] = pinned if pin in located else _combined_variance(before, pinned)
        return variance


def steps_to_correct_start(problem: Problem, limits: Limits, mode: Mode) -> int:
    """Steps needed to correct an initial deviation of k standard deviations by feedback.

    At most as many as a plan may have: where an effect takes nearly all of an input, the number would be unbounded.
    """
    off = problem.settings.sigmas * np.array(problem.start.std) / limits.speed
    return int(min(np.max(off, where=mode.driven, initial=0.0), problem.settings.max_knots))


def _combined_variance(prior: Floats, measured: Floats) -> Floats:
    """Variance of two independent estimates combined; an infinite one adds no information."""
    both = np.maximum(prior + measured, np.finfo(float).tiny)
    joined = prior * np.divide(measured, both, out=np.ones_like(both), where=np.isfinite(measured))
    return np.asarray(joined)
