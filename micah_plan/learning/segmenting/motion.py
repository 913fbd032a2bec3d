"""Motion along a joint: step models of the latent configuration given the actions.

c_{t+1} = c_t + h·a_t + w_t. Without actions (CHAMP) h = 0, and w_t is 0 with probability ρ, the prior share of rest,
and N(μ, q) otherwise, with μ the typical step of the demonstration. With them w_t is the residual of the action: 0
while the part follows exactly, N(0, q |a_t|²) while it does so loosely, two states that rarely change; a few steps are
outliers. So a part that is left alone is explained at no cost, however long it rests, and a slow push that moves
nothing indicates a stop as a quick one does. A part may also wait for the hand, whatever that does, but the hand takes
it the sooner, the further it moves in the part's later direction: if it is pushed without effect for longer, it is
locked. That also holds where actions explain too little to predict steps from.

The action channel h is linear in three numbers for any frame, gain or side of the joint in which the actions were
given: in the part's frame every joint's direction of motion is constant, so J⁻¹ R g is one row vector (MICAH, equation
for the predicted pose, with the measured configuration replaced by its filtered estimate).

All hypotheses are filtered together over all rows; the parameters are fitted to each one's own rows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from micah_plan.arrays import Booleans, Floats
from micah_plan.learning.segmenting.linear_systems import least_norm
from micah_plan.learning.segmenting.log_sums import log_add
from micah_plan.learning.segmenting.noise import NoiseScales
from micah_plan.learning.segmenting.pool import Pool

_STEP_SHARES = np.array([0.03, 0.3, 1.5])  # of the mean squared step, as candidates for E[w²]
_GAP = 0.015  # of a part's travel: how far a hand goes on average, along the joint, before it has the part
_MOST_AMPLIFIED = 1.2  # how much longer than J⁻¹ an action channel in another frame may be
_EXPECTATION_STEPS = 6  # of expectation maximisation
FEWEST_ACTED = 12  # rows to identify an action channel
_LEAST_INFORMATION = 1e-8  # relative; in a direction of less, actions are uninformative
_TRACKED = 3  # steps over which a speed is followed
_SLOWEST = 0.5  # of the typical speed; slower is rest
_UNASKED = 0.1  # of the mean square action, at least, as which a step counts for how loosely it moves a part
_UNLED = 0.002  # probability of a step by another cause, or of a missing log entry
_OTHER_SPEED = 0.1  # probability that the speed is neither the typical one nor that before
_TINY = 1e-16
_TURNING = 0.01  # probability that a step reverses the one before
_STARTING = 0.05  # probability that a part that has not moved yet starts to
_SMOOTHED = 5  # steps, on each side, that determine the direction of one


@dataclass(frozen=True, eq=False)
class _StepModel:
    """A model of the steps of h hypotheses: log densities (n - 1, h) in three states.

    Going forth, going back, or not started; where actions lead: following exactly, loosely, or waiting for the hand.
    """

    forth: Floats
    back: Floats
    not_yet_grasped: Floats
    gain: Floats
    parameters: float
    allowed: Booleans


@dataclass(frozen=True, eq=False)
class StepModels:
    """Step models of h hypotheses, with the density of every row's step.

    Attributes:
        log_density: (h, n) of the configuration at a row, given those before [1/rad or 1/m]; 0 for rigid.
        unled: (h, n) the same of a step that the action does not lead, as one within which a part is caught or let go.
        gain: (h, 3) h [rad or m per m of action in the part's frame]; 0 where actions are uninformative.
        parameters: (h,) how many numbers were fitted.
    """

    log_density: Floats
    unled: Floats
    gain: Floats
    parameters: Floats

    def part(self, part: slice) -> StepModels:
        """The step models of some hypotheses."""
        return StepModels(self.log_density[part], self.unled[part], self.gain[part], self.parameters[part])


def fit_motion(
    pool: Pool, action: Floats | None, rest: float, scale: Floats, likelihood_power: float, begun: bool = False
) -> StepModels:
    """Maximum-likelihood step models.

    Args:
        action: (n, 3) in the part's frame [m]; None for CHAMP.
        rest: ρ where actions explain nothing.
        scale: (h, n) factor on the std of a row, from its error across the joint.
        begun: whether the part has moved before; otherwise it may not have started yet.
    """
    count, n = pool.seen.configuration.shape
    members = np.flatnonzero(pool.moving)
    result = StepModels(np.zeros((count, n)), np.zeros((count, n)), np.zeros((count, 3)), np.zeros(count))
    if not len(members) or n < 2:
        return result
    c = pool.seen.configuration[members]
    used = pool.hypotheses.used[members]
    weight = (used[:, 1:] & used[:, :-1]).T[:, :, None].astype(float)
    enough = np.maximum(weight.sum(axis=(0, 2)), 1.0)
    white = pool.along.white[members]
    squares = (weight[..., 0].T * (c[:, 1:] - c[:, :-1]) ** 2).sum(axis=1) / enough
    mean_square = np.maximum(squares, np.maximum(white * 1e-3, _TINY))
    grid = mean_square[:, None] * _STEP_SHARES
    free, led, still = _step_variances(grid, action, n)
    variances = np.concatenate([free, led, still], axis=2)
    innovations, quiet = innovations_of(
        _filtered_signals(c, action), pool.along.take(members), variances, scale[members]
    )
    not_yet_grasped = _quiet_density(innovations[0, :, :, -1], quiet[:, :, -1])
    # Without gaps: NumPy is slow at rows of three numbers.
    of_free, of_led = slice(0, free.shape[2]), slice(free.shape[2], -1)
    step, ramp, calm = (np.ascontiguousarray(rows[..., of_free]) for rows in (innovations[0], innovations[1], quiet))
    weights = np.repeat(weight, grid.shape[1], axis=2)
    speeds = _directions(c), *_speeds(c, weight, white)
    models = [_constant_velocity_model(step, ramp, calm, mean_square, weights, rest, *speeds, not_yet_grasped)]
    if action is not None:
        # A prior, which is not tempered as the likelihood is.
        contact_rate = _first_direction(c) / (likelihood_power * _GAP * np.maximum(np.ptp(c, axis=1), 1e-9))
        signals, quiet = np.ascontiguousarray(innovations[..., of_led]), np.ascontiguousarray(quiet[:, :, of_led])
        unled = log_add(models[0].forth, models[0].back) + np.log(0.5 * _UNLED)
        arguments = led, weight, pool.lever[members], not_yet_grasped, unled, enough, action, contact_rate
        by_actions = _action_driven_model(signals[0], signals[2:], quiet, *arguments)
        # However little they explain: a hand that pushes does not wait.
        models = [replace(models[0], not_yet_grasped=by_actions[0].not_yet_grasped), *by_actions]
    states = [
        np.stack([getattr(model, name) for model in models], axis=2) for name in ("forth", "back", "not_yet_grasped")
    ]
    density = _log_density_over_states(states, begun)
    numbers = np.array([m.parameters for m in models])
    score = (density * weight).sum(axis=0) - 0.5 * numbers * np.log(enough)[:, None]
    score = np.where(np.stack([m.allowed for m in models], axis=1), score, -np.inf)
    chosen, every = np.argmax(score, axis=1), np.arange(len(members))
    steps = density[:, every, chosen]
    result.log_density[members, 1:] = steps.T
    result.unled[members, 1:] = np.where(chosen, log_add(models[0].forth, models[0].back) + np.log(0.5), steps).T
    result.gain[members] = np.stack([m.gain for m in models], axis=1)[every, chosen]
    result.parameters[members] = numbers[chosen]
    return result


def _step_variances(grid: Floats, action: Floats | None, n: int) -> tuple[Floats, Floats, Floats]:
    """Variances (n - 1, h, g) of steps without an action, with one, and of a part that has not moved yet.

    The larger an action, the further the part may miss it; without a command it hardly moves.
    """
    free = np.broadcast_to(grid, (n - 1, *grid.shape))
    still = np.zeros((n - 1, len(grid), 1))
    if action is None:
        return free, free[:, :, :0], still
    asked = (action[:-1] ** 2).sum(axis=1)
    relative = np.maximum(asked / max(float(asked.mean()), 1e-300), _UNASKED)
    return free, relative[:, None, None] * grid, still


def _filtered_signals(c: Floats, action: Floats | None) -> Floats:
    """(h, n, k) regressors: configurations, a ramp, and the commanded path."""
    n = c.shape[1]
    signals = [c, np.broadcast_to(np.arange(n, dtype=float), c.shape)]
    if action is not None:
        commanded = np.concatenate([np.zeros((1, 3)), np.cumsum(action[:-1], axis=0)])
        signals += [np.broadcast_to(commanded[:, i], c.shape) for i in range(3)]
    return np.stack(signals, axis=-1)


def log_step_density(innovation: Floats, quiet: Floats, mean: Floats, variance: Floats, rest: float) -> Floats:
    """ln [ρ N(v; 0, S) + (1 - ρ) N(v; μ, S + q)], all broadcast: the density of an innovation v."""
    moving = quiet + variance
    log_rest = np.log(rest) - 0.5 * (np.log(2 * np.pi * quiet) + innovation**2 / quiet)
    log_go = np.log1p(-rest) - 0.5 * (np.log(2 * np.pi * moving) + (innovation - mean) ** 2 / moving)
    return log_add(log_rest, log_go)


def innovations_of(signals: Floats, along: NoiseScales, steps: Floats, scale: Floats) -> tuple[Floats, Floats]:
    """Innovations (k, n-1, h, g) of signals (h, n, k) and their variances without a step (n-1, h, g).

    A Kalman filter of the configuration, with steps of the variances `steps` (n-1, h, g) and the slow wander in its
    state, and of the fast wander, which is forgotten.
    """
    n, g = signals.shape[1], steps.shape[2]
    noise = (along.white[:, None] * scale).T[1:, :, None]
    added = steps + (along.slow * (1 - along.slow_kept**2))[:, None]
    kept, fast = along.fast_kept[:, None], along.fast[:, None]
    # How far to trust a row does not depend on the signals.
    of_place, of_wander, total = (np.empty(added.shape) for _ in range(3))
    place, both, wander = along.white[:, None] + fast, -fast, fast
    for t in range(n - 1):
        place, both, wander = place + added[t], kept * both, kept**2 * wander + (1 - kept**2) * fast
        seen_place, seen_wander = place + both, both + wander
        total[t] = seen_place + seen_wander + noise[t]
        of_place[t], of_wander[t] = seen_place / total[t], seen_wander / total[t]
        place, both = place - of_place[t] * seen_place, both - of_place[t] * seen_wander
        wander = wander - of_wander[t] * seen_wander
    rows = np.ascontiguousarray(signals.transpose(1, 2, 0))[..., None]
    innovations = np.empty((n - 1, signals.shape[2], len(signals), g))
    state, error = np.repeat(rows[0], g, axis=2), np.zeros((signals.shape[2], len(signals), g))
    for t in range(1, n):
        error *= kept
        np.subtract(rows[t], state, out=innovations[t - 1])
        innovations[t - 1] -= error
        state += of_place[t - 1] * innovations[t - 1]
        error += of_wander[t - 1] * innovations[t - 1]
    return innovations.transpose(1, 0, 2, 3), total - steps


def _constant_velocity_model(
    innovation: Floats,
    ramp: Floats,
    quiet: Floats,
    square: Floats,
    weight: Floats,
    rest: float,
    direction: Floats,
    before: Floats,
    speed_weight: Floats,
    not_yet_grasped: Floats,
) -> _StepModel:
    """(μ, q) by expectation maximisation for every E[w²] of the grid, the best of them.

    The filter drifts by its expected step (1 - ρ) μ. Its innovations are those without drift, less the drift times the
    innovations of a ramp, so that under noise a stop shows in the rows that follow. A part may turn back: the sign of
    the steps is a hidden state that rarely changes.
    """
    grid = square[:, None] * _STEP_SHARES
    resting = (1 - rest) * (ramp - 1)
    going = resting + 1
    folded = innovation * direction.T[:, :, None]
    mean = (folded * weight).sum(axis=0) / np.maximum((going * weight).sum(axis=0), 1.0)
    variance, missed = grid, folded - mean * going
    precision, log_quiet = 1 / quiet, np.log(quiet)
    for _ in range(_EXPECTATION_STEPS):
        moving = quiet + variance
        odds = log_quiet - np.log(moving) + (missed + mean) ** 2 * precision - missed**2 / moving
        odds = np.log1p(-rest) - np.log(rest) + 0.5 * odds
        share = weight / (1 + np.exp(-np.clip(odds, -500, 500)))
        of_going, of_resting = share / moving * going, (weight - share) * precision * resting
        pull = ((of_going + of_resting) * folded).sum(axis=0)
        mean = pull / np.maximum((of_going * going + of_resting * resting).sum(axis=0), 1e-300)
        missed = folded - mean * going
        square_missed = (share * (missed**2 - quiet)).sum(axis=0)
        variance = np.maximum(square_missed / np.maximum(share.sum(axis=0), 1e-9), 0.01 * grid)
    ways = np.array([1.0, -1.0])[:, None, None, None]  # forth and back
    both = log_step_density(innovation - ways * (mean * resting), quiet, ways * mean, variance, rest)
    # How fast a part is moved belongs to the demonstration and changes: as likely it goes on as it went before.
    speed = np.maximum(mean + speed_weight[:, None] * (np.abs(before)[:, :, None] - mean), _SLOWEST * mean)
    square_missed = (weight * ((folded - speed * going) ** 2 - quiet)).sum(axis=0)
    spread = np.maximum(square_missed / np.maximum(weight.sum(axis=0), 1.0), 0.01 * grid)
    as_before = log_step_density(innovation - ways * (speed * resting), quiet, ways * speed, spread, rest)
    # Or it changes at once.
    other_speed = _quiet_density(innovation, quiet + square[:, None]) + np.log(_OTHER_SPEED)
    both = log_add(log_add(both, as_before) + np.log(0.5 * (1 - _OTHER_SPEED)), other_speed)
    best = np.argmax((both.max(axis=0) * weight).sum(axis=0), axis=1)
    at = np.arange(len(best))
    sure = np.ones(len(best), dtype=bool)
    forth, back = both[:, :, at, best]
    return _StepModel(forth, back, not_yet_grasped, np.zeros((len(best), 3)), 2.0, sure)


def _log_density_over_states(densities: list[Floats], begun: bool) -> Floats:
    """(n, ...) log predictive density of each row, with the hidden states of `_StepModel` summed out.

    A demonstration may take its time before the part moves; a part that has moved and stands still is another matter.
    """
    states = np.stack(densities, axis=1)
    highest = states.max(axis=1)
    # No state is ever ruled out: a row that only one explains must not leave none.
    likelihood = np.exp(np.maximum(states - highest[:, None], -300.0)).reshape(len(states), 3, -1)
    turned = np.array([[1 - _TURNING, _TURNING], [_TURNING, 1 - _TURNING]])
    change = np.zeros((3, 3))
    change[:2, :2], change[:2, 2], change[2, 2] = turned, 0.5 * _STARTING, 1 - _STARTING
    chance = np.array([[0.5], [0.5], [0.0]] if begun else [[0.25], [0.25], [0.5]])
    # The last row of a step's product is the total, by which the chances of the next one are divided.
    change_and_total = np.concatenate([change, np.ones((1, 3))])
    after = np.empty((len(states), 4, likelihood.shape[2]))
    for likely, result in zip(likelihood, after, strict=True):
        np.matmul(change_and_total, np.maximum(chance, 1e-300) * likely, out=result)
        chance = result[:3] / result[3]
    return np.asarray(highest + np.log(after[:, 3]).reshape(highest.shape))


def _quiet_density(innovation: Floats, quiet: Floats) -> Floats:
    """Log density of innovations under variances `quiet`."""
    return np.asarray(-0.5 * (np.log(2 * np.pi * quiet) + innovation**2 / quiet))


def _speeds(c: Floats, weight: Floats, white: Floats) -> tuple[Floats, Floats]:
    """(n - 1, h) mean of the few steps before each, and the non-noise share of its scatter (h,)."""
    last = np.arange(c.shape[1] - 1)
    first = np.maximum(last - _TRACKED, 0)
    before = ((c[:, last] - c[:, first]) / np.maximum(last - first, 1)).T
    count = np.maximum(weight[..., 0].sum(axis=0), 1.0)
    middle = (weight[..., 0] * before).sum(axis=0) / count
    scatter = (weight[..., 0] * (before - middle) ** 2).sum(axis=0) / count
    return before, np.maximum(scatter - 2 * white / _TRACKED**2, 0.0) / np.maximum(scatter, _TINY)


def _directions(c: Floats) -> Floats:
    """(h, n - 1) signs of smoothed steps."""
    n = c.shape[1]
    reach = min(_SMOOTHED, n - 1)
    last, first = np.minimum(np.arange(1, n) + reach, n - 1), np.maximum(np.arange(n - 1) - reach, 0)
    return np.where(c[:, last] >= c[:, first], 1.0, -1.0)


def _first_direction(c: Floats) -> Floats:
    """(h,) direction 1 or -1 of the first motion beyond noise."""
    away = c - c[:, :1]
    far = np.abs(away) >= 0.5 * np.abs(away).max(axis=1, keepdims=True)
    return np.asarray(np.sign(away[np.arange(len(c)), np.argmax(far, axis=1)]))


def _action_driven_model(
    steps: Floats,
    commanded: Floats,
    quiet: Floats,
    grid: Floats,
    weight: Floats,
    lever: Floats,
    not_yet_grasped: Floats,
    unled: Floats,
    enough: Floats,
    action: Floats,
    contact_rate: Floats,
) -> list[_StepModel]:
    """Gains along the levers (h, 3), and in any direction, each for the best E[w²] of the grid.

    Args:
        steps, commanded: (n - 1, h, g) and (3, n - 1, h, g) innovations of the configuration and of the command.
        action: (n, 3) in the part's frame [m].
        unled: (n - 1, h) ln density of a step that actions do not lead, with how rare it is.
        contact_rate: (h,) rate at which a hand makes contact with the part [per rad or m of its motion], signed as the
            part then moves.
        enough: (h,) number of informative steps.
    """
    pushes = commanded.transpose(2, 3, 0, 1)
    weighted = pushes * (weight / (quiet + grid)).transpose(1, 2, 0)[:, :, None]
    normal = weighted @ pushes.swapaxes(2, 3)
    pull = (weighted @ steps.transpose(1, 2, 0)[..., None])[..., 0]
    information = np.einsum("hi,hgij,hj->hg", lever, normal, lever)
    strength = np.einsum("hi,hgi->hg", lever, pull) / np.where(information > 0, information, 1.0)
    gains = np.stack([strength[..., None] * lever[:, None], least_norm(normal, pull, _LEAST_INFORMATION)])
    residual = steps - (gains[..., None, :] @ pushes)[..., 0, :].transpose(0, 3, 1, 2)
    exactly = _quiet_density(residual, quiet)
    loosely = log_add(_quiet_density(residual, quiet + grid) + np.log1p(-_UNLED), unled[..., None])
    best = np.argmax((np.maximum(exactly, loosely) * weight).sum(axis=1), axis=2)
    at = np.arange(len(lever))
    along, turned = (gains[i, at, row] for i, row in enumerate(best))
    # In another frame an action says as much as in the right one, not more. Unbounded, h finds that one push moved
    # the part and another, in much the same direction, did not: a stop would be no evidence of anything any more.
    lengths = np.sqrt(np.sum(np.stack([lever, along, turned]) ** 2, axis=2))
    plausible = lengths[2] <= _MOST_AMPLIFIED * np.maximum(lengths[0], lengths[1])
    is_enough = enough >= FEWEST_ACTED
    exact, loose = ([density[i][:, at, chosen] for i, chosen in enumerate(best)] for density in (exactly, loosely))
    # A hand that is not there yet has the part the sooner, the further it gets the way that the part then goes.
    got = np.cumsum(action[:-1] @ np.concatenate([along, turned]).T, axis=0) * np.tile(contact_rate, 2)
    further = np.diff(np.maximum.accumulate(np.maximum(got, 0.0), axis=0), axis=0, prepend=0.0)
    absent = [not_yet_grasped - part for part in np.split(further, 2, axis=1)]
    return [
        _StepModel(exact[0], loose[0], absent[0], along, 3.0, is_enough),
        _StepModel(exact[1], loose[1], absent[1], turned, 5.0, is_enough & plausible),
    ]
