"""A particle filter for any hybrid automaton, each particle an object with thresholds of its own: the reference."""

from __future__ import annotations

import numpy as np

from micah_plan.automaton.drawn_thresholds import threshold_stds, with_boundaries
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.transition import TransitionBatch


class ParticleFilter:
    """A bootstrap filter (Gordon, Salmond and Smith, 1993) that moves particles by the automaton's own transition."""

    def __init__(self, automaton: HybridAutomaton, mean: list[float], std: list[float], count: int, seed: int) -> None:
        """All particles start in the first mode, those that its invariant does not hold are drawn again."""
        self.automaton, self.rng = automaton, np.random.default_rng(seed)
        stds = threshold_stds(automaton)
        self.objects = TransitionBatch(automaton, stds * self.rng.standard_normal((count, stds.size)))
        self.modes = np.zeros(count, dtype=int)
        self.x = np.empty((count, automaton.n))
        wanted = np.arange(count)
        while wanted.size:
            self.x[wanted] = self.rng.normal(mean, std, (wanted.size, automaton.n))
            at_rest = np.zeros(automaton.m)
            held = [
                with_boundaries(automaton, self.objects.shifts[i]).modes[0].invariant.contains(self.x[i], at_rest)
                for i in wanted
            ]
            wanted = wanted[~np.array(held)]

    def predict(self, u: list[float]) -> None:
        noise = np.array(self.automaton.noise.process_std) * self.rng.standard_normal(self.x.shape)
        inputs = np.tile(np.array(u, dtype=float), (len(self.x), 1))
        self.modes, self.x = self.objects.step(self.modes, self.x, inputs, noise)

    def update(self, z: np.ndarray) -> None:
        """Systematic resampling by the likelihood of z (n,)."""
        away = (z - self.x) / np.array(self.automaton.noise.observation_std)
        logs = -0.5 * np.square(away).sum(axis=1)
        weights = np.exp(logs - logs.max())
        count = len(self.x)
        at = (self.rng.random() + np.arange(count)) / count
        chosen = np.searchsorted(np.cumsum(weights) / weights.sum(), at).clip(max=count - 1)
        self.modes, self.x = self.modes[chosen], self.x[chosen]
        if self.objects.shifts.shape[1]:
            self.objects = TransitionBatch(self.automaton, self.objects.shifts[chosen])

    @property
    def shares(self) -> np.ndarray:
        """(q,) of the modes."""
        return np.bincount(self.modes, minlength=len(self.automaton.modes)) / len(self.modes)
