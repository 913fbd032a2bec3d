"""An interacting-multiple-model filter with guards as transition probabilities: the usual way, for comparison."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.step_noise import free_process_std


class InteractingModels:
    """Blom and Bar-Shalom, 1988, with state-dependent transitions as in Seah and Hwang, "Stochastic linear hybrid
    systems: modeling, estimation, and application in air traffic control", 2009.

    One Kalman filter per mode. Before each step the Gaussians are mixed by the probabilities that the end of a whole
    step lies in a guard; what of the step is left after the crossing is not asked. A threshold's std adds to the
    state's, at every step anew.
    """

    def __init__(self, automaton: HybridAutomaton, mean: list[float], std: list[float]) -> None:
        q, n = len(automaton.modes), automaton.n
        self.automaton = automaton
        self.weights = np.eye(q)[0]
        self.means = np.tile(np.array(mean, dtype=float), (q, 1))
        self.covariances = np.tile(np.diag(np.square(std)), (q, 1, 1)).reshape(q, n, n)

    def predict(self, u: list[float]) -> None:
        a, inputs = self.automaton, np.array(u, dtype=float)
        names = [mode.name for mode in a.modes]
        parts: list[list[tuple[float, np.ndarray, np.ndarray]]] = [[] for _ in names]
        for i, mode in enumerate(a.modes):
            left = float(self.weights[i])
            noise = np.diag(np.square(free_process_std(a, mode)))
            ahead, spread = self.means[i] + mode.B @ inputs, self.covariances[i] + noise
            for edge in a.edges_from(mode.name):
                if edge.is_self_transition:
                    continue
                share = left
                for h in edge.guard.half_spaces:
                    std = np.sqrt(np.array(h.a) @ spread @ np.array(h.a) + edge.threshold_std**2 * any(h.a))
                    margin = float(h.margin(ahead, inputs))
                    share *= float(ndtr(margin / std)) if std > 0 else float(margin > 0)
                A = edge.reset.matrices(a.n, a.m)[0]
                moved = edge.reset.apply(self.means[i], inputs)
                parts[names.index(edge.target)].append((share, moved, A @ self.covariances[i] @ A.T))
                left -= share
            parts[i].append((max(left, 0.0), self.means[i], self.covariances[i]))
        for j, mode in enumerate(a.modes):
            weights = np.array([share for share, _, _ in parts[j]])
            self.weights[j] = weights.sum()
            if self.weights[j] > 0:
                self._mix(j, weights / weights.sum(), parts[j])
            self.means[j] = self.means[j] + mode.B @ inputs
            self.covariances[j] = self.covariances[j] + np.diag(np.square(free_process_std(a, mode)))
            for pin in mode.pins:
                self.means[j, pin.coordinate] = pin.value
                self.covariances[j, pin.coordinate] = self.covariances[j, :, pin.coordinate] = 0.0
                self.covariances[j, pin.coordinate, pin.coordinate] = pin.std**2

    def _mix(self, j: int, shares: np.ndarray, parts: list[tuple[float, np.ndarray, np.ndarray]]) -> None:
        mean = sum(w * m for w, (_, m, _) in zip(shares, parts, strict=True))
        spreads = [c + np.outer(m - mean, m - mean) for _, m, c in parts]
        self.means[j], self.covariances[j] = mean, sum(w * c for w, c in zip(shares, spreads, strict=True))

    def update(self, z: np.ndarray) -> None:
        R = np.diag(np.square(self.automaton.noise.observation_std))
        logs = np.full(len(self.weights), -np.inf)
        for j in np.flatnonzero(self.weights > 0):
            S = self.covariances[j] + R
            K, away = self.covariances[j] @ np.linalg.inv(S), z - self.means[j]
            logs[j] = np.log(self.weights[j]) - 0.5 * (away @ np.linalg.solve(S, away) + np.log(np.linalg.det(S)))
            self.means[j] += K @ away
            self.covariances[j] = self.covariances[j] - K @ self.covariances[j]
        self.weights = np.exp(logs - logs.max())
        self.weights /= self.weights.sum()
