"""Sensor effects of the controller, from its estimated against the measured pose at rest.

During motion a belief may lead or lag the part. At rest it shows the sensor's error, if another sensor measured the
part: its readings x and beliefs e then differ by x = k e + o + r t. Each run (or segment of few long ones) is one
observation, since errors at rest are constant while it rests.

Source: Geisser, The predictive sample reuse method, JASA 1975 (each observation predicted from the others).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.effects.add import is_possible
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.tracks import Track
from micah_plan.residual.coordinate_data import ENOUGH_RUNS
from micah_plan.residual.geometry import DirectFinding
from micah_plan.residual.likelihood import LEAST_EVIDENCE, TIE, student_t_log_density

_FEWEST = 4
# Steps smaller than this share of the largest are rest; the smallest error that counts [rad or m].
_AT_REST = 0.05
_EXACT = 1e-7
# Variance of a median over that of a mean, of normal noise.
_OF_MEDIANS = 0.5 * np.pi
# Functions of (belief, time) that x - e may be, plainest first.
_MODELS: tuple[tuple[str, ...], ...] = (
    ("sensor_scale",),
    ("sensor_offset",),
    ("drift",),
    ("sensor_scale", "sensor_offset"),
)
_COLUMN = {"sensor_scale": 0, "sensor_offset": 1, "drift": 2}


def estimator_bias_findings(automaton: HybridAutomaton, tracks: Sequence[Track]) -> tuple[DirectFinding, ...]:
    """Sensor effects with significant evidence on held-out rests, in the order of their application."""
    findings: list[DirectFinding] = []
    for i, coordinate in enumerate(automaton.coordinates):
        rests = np.array([rest for track in tracks for rest in _rests(track, i, len(tracks))]).reshape(-1, 4)
        if len(rests) < _FEWEST:
            continue
        without = _density(rests, ())
        options = [_effects(rests, names, coordinate.name, _density(rests, names) - without) for names in _MODELS]
        # A stuck part is not a sensor that reads a seventh of the motion.
        possible = [option for option in options if all(is_possible(finding.effect) for finding in option)]
        most = max((option[0].evidence for option in possible), default=-np.inf)
        if most > LEAST_EVIDENCE:
            findings += next(option for option in possible if option[0].evidence >= most - TIE)
    return tuple(findings)


def _rests(track: Track, i: int, runs: int) -> list[tuple[float, float, float, float]]:
    """(measured, estimated, time, variance of their difference) at the rests of a run, one per segment."""
    if track.believed is None:
        return []
    x, e, time = track.x[:, i], track.believed[:, i], track.time - track.time[0]
    steps = np.maximum(np.abs(np.diff(x, prepend=np.nan)), np.abs(np.diff(e, prepend=np.nan)))
    is_finite = np.isfinite(steps) & np.isfinite(e)
    if not is_finite.any():
        return []
    rest = is_finite & (steps <= _AT_REST * steps[is_finite].max())
    count = 1 if runs >= ENOUGH_RUNS else int(np.ceil(2 * ENOUGH_RUNS / runs))
    pieces = [rows[rest[rows]] for rows in np.array_split(np.arange(len(x)), count)]
    rests = []
    for piece in pieces:
        if piece.size:
            middle = (float(np.median(values[piece])) for values in (x, e, time))
            rests.append((*middle, _OF_MEDIANS * float(np.var((x - e)[piece])) / piece.size))
    return rests


def _density(rests: Floats, names: tuple[str, ...]) -> float:
    """Log density of each rest's error under the prediction from the others [nats].

    Few rests may agree by chance: none is taken for more certain than the scatter of its own rows lets it be.
    """
    design, target = _regression(rests, names)
    share = rests[:, 3].mean()
    total, free = 0.0, len(target) - 1 - design.shape[1]
    if free < 1:
        return -np.inf
    for k in range(len(target)):
        a, b = np.delete(design, k, axis=0), np.delete(target, k)
        beta = np.linalg.lstsq(a, b, rcond=None)[0]
        spread = design[k] @ np.linalg.pinv(a.T @ a) @ design[k]
        scale = np.sqrt((max(((b - a @ beta) ** 2).sum() / free, share) + _EXACT**2) * (1.0 + spread))
        total += float(student_t_log_density((target[k] - design[k] @ beta) / scale, free) - np.log(scale))
    return total


def _regression(rests: Floats, names: tuple[str, ...]) -> tuple[Floats, Floats]:
    """(columns of the named terms, differences) of rests, one row each."""
    x, e, time, _ = rests.T
    columns = np.stack([e, np.ones_like(e), time], axis=1)
    return columns[:, [_COLUMN[name] for name in names]], x - e


def _effects(rests: Floats, names: tuple[str, ...], coordinate: str, evidence: float) -> list[DirectFinding]:
    """Effects of the reading model scale (c + offset) + rate t, so that c = reading / scale - offset."""
    design, target = _regression(rests, names)
    beta = np.linalg.lstsq(design, target, rcond=None)[0]
    noise = float(((target - design @ beta) ** 2).sum()) / (len(target) - design.shape[1])
    stds = np.sqrt(noise * np.diag(np.linalg.pinv(design.T @ design)))
    steps_at_rest = []
    for name, value, std in zip(names, beta.tolist(), stds.tolist(), strict=True):
        if name == "sensor_scale":
            scale = 1.0 / (1.0 + value) if value != -1.0 else np.inf
            pair, std = ("scale", scale), std * scale**2
        else:
            pair = ("offset" if name == "sensor_offset" else "rate", -value)
        steps_at_rest.append(DirectFinding(Effect(name, coordinate, (pair,), (std,)), (std,), evidence))
    return steps_at_rest
