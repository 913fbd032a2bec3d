"""Refinement of a changepoint to the row between two known joints."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from micah_plan.arrays import Booleans, Floats, Ints
from micah_plan.learning.joints.joint_arrays import JointArrays
from micah_plan.learning.segmenting.evidence import tabulated
from micah_plan.learning.segmenting.noise_fit import fit_noise_to_residuals, initial_noise
from micah_plan.learning.segmenting.pool import Hypotheses, pool_of
from micah_plan.learning.segmenting.steps import averaged
from micah_plan.learning.settings import LearnSettings
from micah_plan.learning.track import PartTrack

_REACH = 12  # steps looked at on either side
# Times as many, for what they tell of noise and motion: of a time that does not shrink with the steps, as far as steps
# do not get too many. Few rows, interpolated or close in time, tell neither from the other.
_CONTEXT, _MOST_CONTEXT = 2, 200
_FIRST_REACH = 4  # steps of which the changepoint was known
_FINER = 4  # times finer each time
_UNLIKELY = 7.0  # nats; rows so much less likely than the best are not looked at with finer steps


@dataclass(frozen=True, eq=False)
class RefinedChangepoint:
    """A changepoint with its posterior.

    Attributes:
        row: first row of the later segment, in the track.
        rows: (k,) rows at which it may be.
        log_probability: (k,) of each, unnormalised. Not tempered like the evidence for joints: that joints are not
            ideal is a reason against another joint, but not against another row when both joints are known. A row
            counts by the share of readings that are new, since rows that are read on a grid repeat its error.
    """

    row: int
    rows: Ints
    log_probability: Floats


def refine_changepoint(
    joints: JointArrays,
    row: int,
    size: float,
    limits: tuple[int, int],
    track: PartTrack,
    inlier: Booleans,
    settings: LearnSettings,
) -> RefinedChangepoint:
    """The row at which a part goes over from one joint to another.

    Args:
        joints: the joint before and the joint after.
        row, size: the coarse changepoint, and the number of rows of the steps that determined it.
        limits: first row of the earlier segment, and first row after the later one.
        track, inlier: all rows, and which count.
    """
    rows, score = np.array([row]), np.zeros(1)
    context = _CONTEXT * _REACH * size
    likely = row - _FIRST_REACH * size, row + _FIRST_REACH * size
    while True:
        size = max(size / _FINER, 1.0)
        reach = _REACH * size
        beyond = int(np.ceil(min(context, _MOST_CONTEXT * size)))
        # As far as coarser steps leave it open.
        first, last = int(np.floor(min(row - reach, likely[0]))), int(np.ceil(max(row + reach, likely[1])))
        near = max(first, limits[0] + 1), min(last, limits[1] - 1)
        wide = max(row - beyond, limits[0]), min(row + beyond, limits[1])
        if near[1] <= near[0]:
            return RefinedChangepoint(row, rows, score)
        starts = np.unique(
            np.linspace(*wide, max(round((wide[1] - wide[0]) / size), 2), endpoint=False).astype(np.int64)
        )
        starts = starts[[inlier[a:b].any() for a, b in zip(starts, np.append(starts[1:], wide[1]), strict=True)]]
        if not len(starts) or not starts[0] < row <= starts[-1]:  # no row counts on one of its sides
            return RefinedChangepoint(row, rows, score)
        scores = _scores(joints, row, starts, wide[1], track, inlier, settings)
        inside = (starts >= near[0]) & (starts <= near[1])
        if not inside.any():
            return RefinedChangepoint(row, rows, score)
        rows, score = starts[inside], scores[inside]
        row = int(rows[np.argmax(score)])
        if size <= 1.0:
            return RefinedChangepoint(row, rows, score)
        open_rows = rows[score > score.max() - _UNLIKELY]
        likely = float(open_rows[0]) - size, float(open_rows[-1]) + size


def _scores(
    joints: JointArrays,
    row: int,
    starts: Ints,
    end: int,
    track: PartTrack,
    inlier: Booleans,
    settings: LearnSettings,
) -> Floats:
    """(k,) log probability of the steps starting at `starts`, with the changepoint at each of them."""
    steps = averaged(track, inlier, np.append(starts, end))
    longer = len(track) / max(end - int(starts[0]), 1)
    scaled = replace(settings, wander_durations=settings.wander_durations * longer)
    later = starts >= row
    hypotheses = Hypotheses(joints, np.stack([~later, later]))
    pool = pool_of(hypotheses, steps, initial_noise(steps, scaled))
    (noise,) = fit_noise_to_residuals([(pool, later.astype(np.int64))], scaled)
    earlier, later_on = tabulated(hypotheses, steps, noise, settings.rest, 1.0, begun=True).sums
    before = np.concatenate([[0.0], earlier[0, :-1]])
    sides = [slice(int(starts[0]), row), slice(row, end)]
    vectors = [track.position]
    if track.quaternion is not None and joints.turning.any():  # turns do not measure a slide
        vectors.append(track.quaternion)
    share = max(_new_readings(vector[side]) for vector in vectors for side in sides)
    return np.asarray(share * (before + later_on[:, -1]))


def _new_readings(vector: Floats) -> float:
    """Share of the rows (n, k) that differ from the row before, at least one of them."""
    changes = (vector[1:] != vector[:-1]).any(axis=1)
    return float((changes.sum() + 1) / (len(changes) + 1))
