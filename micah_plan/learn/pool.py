"""The pool of hypotheses: joints of every kind fitted to windows of every size, and to the segments found so far."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.joint import JointKind
from micah_plan.learn.closed_form import fit_closed_form
from micah_plan.learn.hypothesis import Hypothesis
from micah_plan.learn.mlesac import Mixture, RobustFit, fit_robust
from micah_plan.learn.noise import NoiseScales
from micah_plan.learn.refine import refine
from micah_plan.learn.settings import LearnSettings
from micah_plan.learn.track import PartTrack

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

_LEVELS = 4
_FEWEST_ROWS = 8
_MOTION_STDS = 3.0  # a window that spans less than so many stds of noise cannot tell a joint
_ITERATIONS = 4


def windows(rows: int) -> list[tuple[int, int]]:
    """(start, end inclusive) of windows of 1, 1/2, 1/4, 1/8 of the rows, half overlapping."""
    found: list[tuple[int, int]] = []
    for level in range(_LEVELS):
        size = rows / 2**level
        if size < _FEWEST_ROWS and level:
            break
        for i in range(2 ** (level + 1) - 1):
            start = round(i * size / 2)
            found.append((start, min(round(start + size), rows) - 1))
    return found


def moves(track: PartTrack, start: int, end: int, inlier: Bools, noise: NoiseScales) -> bool:
    """Whether the poses of a window spread further than noise does."""
    index = np.arange(start, end + 1)[inlier[start : end + 1]]
    if len(index) < 2:
        return False
    if _spread(track.position[index]) > _MOTION_STDS * noise.position_std:
        return True
    return track.quaternion is not None and 2 * _spread(track.quaternion[index]) > _MOTION_STDS * noise.rotation_std


def window_hypotheses(
    track: PartTrack, inlier: Bools, noise: NoiseScales, kinds: Iterable[JointKind]
) -> list[Hypothesis]:
    """Joints of the moving kinds fitted to every window in which something moves: closed form, then refined."""
    found: list[Hypothesis] = []
    for start, end in windows(len(track)):
        if not moves(track, start, end, inlier, noise):
            continue
        index = slice(start, end + 1)
        position = track.position[index]
        rotation = None if track.rotation is None else track.rotation[index]
        weight = inlier[index].astype(float)
        for kind in kinds:
            if kind == "rigid":
                continue
            joint = fit_closed_form(kind, position, rotation, weight)
            if joint is not None:
                stds = (noise.rotation_std, noise.position_std)
                joint = refine(joint, position, rotation, weight, stds, _ITERATIONS)
                found.append(Hypothesis(joint, start, end))
    return found


def mixture_of(track: PartTrack, noise: NoiseScales, settings: LearnSettings) -> Mixture:
    """MLESAC's noise for a track; outliers are uniform over what the recording spans."""
    span = float(np.ptp(track.position, axis=0).max())
    return Mixture(
        rotation_std=noise.rotation_std,
        position_std=noise.position_std,
        rotation_span=2 * np.pi,
        position_span=max(2 * span, 20 * noise.position_std),
        weight=settings.outlier_weight,
    )


def robust_fit(
    kind: JointKind,
    track: PartTrack,
    index: NDArray[np.int64],
    inlier: Bools,
    noise: NoiseScales,
    settings: LearnSettings,
    rng: np.random.Generator,
) -> RobustFit | None:
    """MLESAC on some rows of a track."""
    return fit_robust(
        kind,
        track.position[index],
        None if track.rotation is None else track.rotation[index],
        mixture_of(track, noise, settings),
        rng,
        settings.draws,
        inlier[index].astype(float),
    )


def _spread(rows: Floats) -> float:
    """Largest distance from the mean."""
    return float(np.linalg.norm(rows - rows.mean(axis=0), axis=1).max())
