"""Segmenting a window of steps that goes on from earlier ones, whose joints are known and paid for.

First the known joints, and rests on them, are asked whether they explain the window; only if not, it is searched for
new ones as a whole recording would be. Page's test decides: the steps' surprise under the known joints, beyond what is
usual for them, is summed from where it begins; a sum worth more than a new joint's parameters calls for the search. So
a door that is opened and closed for hours costs a fraction of learning it.

Source: Page, "Continuous inspection schemes", Biometrika 1954.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from micah_plan.arrays import Booleans, Floats, Ints
from micah_plan.automaton.joint import JointKind
from micah_plan.learn.joints.joint_arrays import JointArrays
from micah_plan.learn.segmenting.changepoints import (
    LengthPrior,
    RunningEvidence,
    Segmentation,
    length_priors,
    most_probable,
)
from micah_plan.learn.segmenting.evidence import EvidenceTable, tabulated
from micah_plan.learn.segmenting.held import along_joint, places_held
from micah_plan.learn.segmenting.motion import FEWEST_ACTED
from micah_plan.learn.segmenting.noise import NoiseModel, trust_in
from micah_plan.learn.segmenting.noise_fit import first_noise, misses, noises_left
from micah_plan.learn.segmenting.occam import parameter_count
from micah_plan.learn.segmenting.pool import Hypotheses, pool_of, refitted, window_hypotheses, windows
from micah_plan.learn.segmenting.segmentation import ANOTHER_JOINT, Segmented, merged, segment_track
from micah_plan.learn.settings import LearnSettings
from micah_plan.learn.track import PartTrack

_ROUNDS = 2  # of segments and joints in turn
_DOF = 8.0  # of Student's distribution
_SLACK = 0.5  # nats per step by which surprise may exceed the usual: joints fitted elsewhere, a tracker that wanders


@dataclass(frozen=True, eq=False)
class Usual:
    """How well joints explain the steps that they were found in.

    Attributes:
        scale: (d,) root mean square errors of the steps [rad, m].
        surprise: mean of a step's, with this scale [nats].
    """

    scale: Floats
    surprise: float


@dataclass(frozen=True, eq=False)
class KnownJoints:
    """What earlier steps leave to later ones.

    Attributes:
        joints: k joints on their coordinates.
        first: index of the one that was found to hold where the window begins; -1 if that is none of them.
        usual: how well they explain steps.
    """

    joints: JointArrays
    first: int
    usual: Usual


def usual_of(found: Segmented) -> Usual:
    """How well the joints of a segmentation explain its steps."""
    errors = _errors(found.segmentation, found.table)
    groups = errors.reshape(len(errors), -1, 3)
    scale = np.repeat(np.sqrt((groups**2).mean(axis=(0, 2))), 3)
    return Usual(scale, float(_surprise(errors, scale).mean()))


def segment_onward(
    track: PartTrack,
    known: KnownJoints,
    settings: LearnSettings,
    rng: np.random.Generator,
) -> tuple[Segmented, Segmented | None]:
    """The most probable segments of a window; the first hypotheses of its pool are the known joints.

    Args:
        track: steps of the window without outliers.
        rng: resamples the particles.

    Returns:
        the segments, and the search for new joints; None where the known ones are enough.
    """
    if known.joints.moving.any():
        found = _with_rests(track, known, settings, rng)
        if _is_usual(found, known.usual):
            return found, None
    fresh = segment_track(track, settings)
    used = list(dict.fromkeys(piece.hypothesis for piece in fresh.segmentation.pieces))
    moves = fresh.table.pool.moving[fresh.segmentation.which]
    rows = np.tile(moves if moves.any() else ~moves, (len(known.joints), 1))
    pool = Hypotheses(known.joints, rows).joined(fresh.table.pool.hypotheses.take(used))
    owner = np.arange(len(known.joints))
    return _selected(pool, owner, track, fresh.noise, known, settings, rng), fresh


def _with_rests(track: PartTrack, known: KnownJoints, settings: LearnSettings, rng: np.random.Generator) -> Segmented:
    """The segments of known joints and of rests, which need to be found anew."""
    noise = first_noise(track, settings)
    owner, rows = _where_known(known, track, noise)
    pool = Hypotheses(known.joints.take(owner), rows)
    if "rigid" in settings.kinds:
        pool = pool.joined(window_hypotheses(track, ("rigid",), noise))
    found = _selected(pool, owner, track, noise, known, settings, rng)
    for _ in range(_ROUNDS):
        which = found.segmentation.which
        (noise,) = noises_left([(found.table.pool, which)], settings)
        new = [which == i for i in np.unique(which) if i >= len(owner)]
        own = [np.isin(which, np.flatnonzero(owner == i)) for i in range(len(known.joints))]
        owner = np.arange(len(known.joints))
        pool = Hypotheses(known.joints, np.array([one if one.any() else ~one for one in own]))
        if new:
            kinds: list[JointKind] = ["rigid"] * len(new)
            pool = pool.joined(refitted(kinds, np.array(new), track, noise))
        before, found = found, _selected(pool, owner, track, noise, known, settings, rng)
        if [piece.start for piece in found.segmentation.pieces] == [p.start for p in before.segmentation.pieces]:
            break
    return found


def _where_known(known: KnownJoints, track: PartTrack, noise: NoiseModel) -> tuple[Ints, Booleans]:
    """Known joints, each once for every stretch of the window in which it may hold, and these rows.

    How fast a part moves, and what actions say of it, is learned where its joint holds and not where the part rests:
    where the actions tell that the part was held, in all other rows, too.
    """
    rows = len(track)
    spans = [(a, b) for a, b in windows(rows) if 4 * (b - a + 1) >= rows - 4]
    owner = [i for i, moves in enumerate(known.joints.moving) for _ in (spans if moves else spans[:1])]
    inside = np.zeros((len(owner), rows), dtype=bool)
    stretches = [span for moves in known.joints.moving for span in (spans if moves else spans[:1])]
    for one, (start, end) in zip(inside, stretches, strict=True):
        one[start : end + 1] = True
    if track.action is not None:
        every = np.ones((len(known.joints), rows), dtype=bool)
        pool = pool_of(Hypotheses(known.joints, every), track, noise)
        for i in np.flatnonzero(pool.moving).tolist():
            places = places_held(along_joint(pool, i, track.action))
            beside = np.asarray(~places.any(axis=0))
            if len(places) and beside.sum() >= FEWEST_ACTED:
                owner, inside = [*owner, i], np.concatenate([inside, beside[None]])
    return np.array(owner, dtype=np.int64), inside


def _selected(
    pool: Hypotheses,
    owner: Ints,
    track: PartTrack,
    noise: NoiseModel,
    known: KnownJoints,
    settings: LearnSettings,
    rng: np.random.Generator,
) -> Segmented:
    """The most probable segments under the known joints and those of the others that are worth their parameters.

    Args:
        owner: which known joint each of the first hypotheses is.
    """
    prior = length_priors(track, settings)[0]
    trust = trust_in(first_noise(track, settings), settings)
    table = tabulated(pool, track, noise, settings.rest, trust, known.first >= 0)
    table = _paid(table, owner, known.first, prior, len(settings.kinds))
    k = len(owner)
    every = range(len(pool))
    apart = most_probable(RunningEvidence(table, settings.kinds, every), prior, rng, settings.particles)
    new = sorted({piece.hypothesis for piece in apart.pieces if piece.hypothesis >= k})
    best = _charged(apart, table, k) if not new else _shared(table, k, new, prior, settings, rng)
    # Where nothing is known, as after rows that no joint holds, something new must stay.
    while len(new) > (k == 0):
        fewer = [[i for i in new if i != dropped] for dropped in new]
        tried = [_shared(table, k, some, prior, settings, rng) for some in fewer]
        i = max(range(len(tried)), key=lambda j: tried[j].log_probability)
        if tried[i].log_probability <= best.log_probability:
            break
        new, best = fewer[i], tried[i]
    return Segmented(track, noise, prior, best, table)


def _shared(
    table: EvidenceTable,
    known: int,
    new: list[int],
    prior: LengthPrior,
    settings: LearnSettings,
    rng: np.random.Generator,
) -> Segmentation:
    """The most probable segments under the known joints and new ones, whose parameters are paid once."""
    members = [*range(known), *new]
    found = most_probable(RunningEvidence(table, settings.kinds, members, new), prior, rng, settings.particles)
    return _charged(found, table, known)


def _charged(found: Segmentation, table: EvidenceTable, known: int) -> Segmentation:
    """Segments under free joints, less what the new ones among them cost."""
    rows: dict[int, int] = {}
    for piece in found.pieces:
        rows[piece.hypothesis] = rows.get(piece.hypothesis, 0) + piece.end - piece.start + 1
    moving = table.pool.moving
    held = bool(moving[list(rows)].any() or moving[:known].any())
    new = [i for i in rows if i >= known]
    cost = table.cost(np.array(new, dtype=int), np.array([float(rows[i]) for i in new]), held).sum()
    further = sum(bool(moving[i]) for i in new)
    further -= not moving[:known].any() and further > 0
    # A part does not get from one rest to another without a motion.
    rigid = [not moving[piece.hypothesis] for piece in found.pieces]
    jumps = sum(a and b for a, b in pairwise(rigid))
    log_probability = found.log_probability - float(cost) - (further + jumps) * ANOTHER_JOINT
    return Segmentation(merged(found.pieces), log_probability)


def _paid(table: EvidenceTable, owner: Ints, first: int, prior: LengthPrior, kinds: int) -> EvidenceTable:
    """The same densities, with the known joints free of cost: of their parameters, and of the choice of their kinds.

    What holds where the window begins was found with the rows before it in view, which tell a rest from a motion that
    has not begun. Another joint pays for the changepoint and for being overlooked.
    """
    k = len(owner)
    costs = {name: getattr(table, name).copy() for name in ("parameters", "occam", "held")}
    for name, values in costs.items():
        values[:k] = 0.0 if name == "parameters" else -np.log(kinds)
    density = table.log_density.copy()
    if first >= 0:
        other = np.ones(density.shape[2], dtype=bool)
        other[:k] = owner != first
        density[0, 0, other] -= np.log(max(prior.mean, 1.0)) + ANOTHER_JOINT
    return replace(table, log_density=density, **costs)


def _is_usual(found: Segmented, usual: Usual) -> bool:
    """Page's test: nowhere do steps surprise more than a new joint would cost."""
    excess = _surprise(_errors(found.segmentation, found.table), usual.scale) - usual.surprise - _SLACK
    total = np.concatenate([[0.0], np.cumsum(found.table.trust * excess)])
    worst = float((total - np.minimum.accumulate(total)).max())
    parameters = parameter_count("revolute", found.track.quaternion is not None)
    return bool(worst < ANOTHER_JOINT + 0.5 * parameters * np.log(len(found.track)))


def _surprise(errors: Floats, scale: Floats) -> Floats:
    """(n,) of errors (n, d): minus ln of Student's density, up to a constant."""
    size = _DOF + errors.shape[1]
    return np.asarray(0.5 * size * np.log1p(((errors / scale) ** 2).sum(axis=1) / size))


def _errors(segmentation: Segmentation, table: EvidenceTable) -> Floats:
    """(n, d) errors of the steps under the joints that explain them."""
    return misses(table.pool, segmentation.which)[0]
