"""Noise of one step: what the dynamics leave unexplained, and how far an uncertain gain carries an input."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.gain import mode_gains
from micah_plan.automaton.hybrid import HybridAutomaton, Mode

Floats = NDArray[np.float64]


def free_process_std(automaton: HybridAutomaton, mode: Mode) -> tuple[float, ...]:
    """(n,) std of the process noise in a mode: that of the model, and 0 for coordinates that it holds or ties."""
    held = _held(mode)
    return tuple(0.0 if i in held else std for i, std in enumerate(automaton.noise.process_std))


def free_gain_std(automaton: HybridAutomaton, mode: Mode) -> Floats:
    """(n,) relative std of how far an input moves each coordinate in a mode (`gain`); 0 for held and tied ones."""
    known: dict[str, Floats] = automaton.derived.setdefault("gain_std", {})
    if mode.name not in known:
        held = _held(mode)
        known[mode.name] = np.zeros(automaton.n)
        for i, _, std in mode_gains(automaton, mode):
            known[mode.name][i] = 0.0 if i in held else std
    return known[mode.name]


def step_noise_std(automaton: HybridAutomaton, mode: Mode, u: Floats) -> Floats:
    """(..., n) std of the noise of a step under inputs u (..., m): process noise, and the uncertain gain's."""
    free, gain = np.array(free_process_std(automaton, mode)), free_gain_std(automaton, mode)
    if not gain.any():
        return np.broadcast_to(free, (*u.shape[:-1], automaton.n))
    return np.asarray(np.hypot(free, gain * (u @ mode.B.T)))


def process_factor(automaton: HybridAutomaton, mode: Mode, u: Floats) -> Floats:
    """(..., n, n) N with N N' the covariance of a step's noise in a mode under u (..., m); ties included."""
    factor = step_noise_std(automaton, mode, u)[..., None] * np.eye(automaton.n)
    for tie in mode.ties:
        factor[..., tie.coordinate, :] = np.array(tie.weights) @ factor
    return factor


def _held(mode: Mode) -> set[int]:
    return {pin.coordinate for pin in mode.pins} | {tie.coordinate for tie in mode.ties}
