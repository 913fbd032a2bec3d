"""How actions truly move a part, and what an estimated channel misses of that."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from micah_plan.automaton.certainty import ActionChannel
from micah_plan.automaton.joint import Joint

QUANTILE = 1.959964
TOLD = 0.3  # rad


@dataclass(frozen=True)
class TrueChannel:
    """How actions move a part: by gain * rotation of the action, `delay` [s] later."""

    joint: Joint
    rotation: Rotation
    gain: float
    delay: float


def misses(truth: TrueChannel, found: ActionChannel) -> dict[str, float | bool]:
    """Whether the intervals hold the truth, and the errors."""
    covariance = np.array(found.covariance)
    rotation = Rotation.from_rotvec(found.frame_rotation)
    candidates = Rotation.concatenate([truth.rotation])
    if truth.joint.kind == "prismatic":
        turns = Rotation.from_rotvec(np.linspace(-np.pi, np.pi, 721)[:, None] * np.array(truth.joint.axis))
        candidates = turns * truth.rotation
    errors = (candidates * rotation.inv()).as_rotvec()
    values, vectors = np.linalg.eigh(covariance[:3, :3])
    seen = errors @ vectors / np.sqrt(np.maximum(values, 1e-18))
    nearest = int(np.argmin(np.sum(seen**2, axis=1)))
    error, reduced = errors[nearest], seen[nearest]
    told = values < TOLD**2
    freedom = 2 if truth.joint.kind == "prismatic" else 3
    d = min(int(told.sum()), freedom)
    stds = np.sqrt(np.diag(covariance))
    return {
        "all": bool(np.sum(reduced**2) < chi2.ppf(0.95, freedom)),
        "told": bool(np.sum(reduced[told] ** 2) < chi2.ppf(0.95, d)) if d else True,
        "told number": d,
        "gain": bool(abs(found.gain - truth.gain) < QUANTILE * stds[3]),
        "ln gain": bool(abs(np.log(found.gain / truth.gain)) < QUANTILE * stds[3] / found.gain),
        "delay": bool(abs(found.delay - truth.delay) < QUANTILE * stds[4]),
        "angle error": float(np.linalg.norm(error)),
        "gain error": float(abs(found.gain / truth.gain - 1)),
        "delay error": float(abs(found.delay - truth.delay)),
        "gain std": float(stds[3] / found.gain),
        "delay std": float(stds[4]),
        "angle std": float(np.sqrt(np.sum(values[:freedom]))),
    }
