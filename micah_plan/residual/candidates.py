"""Where the search for each form of effect starts on a lane, and which forms the lane can show at all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.effects.form import EffectForm
from micah_plan.automaton.effects.formulas import SMOOTH_BUMPS
from micah_plan.automaton.effects.registry import form, forms
from micah_plan.residual.lane import Lane
from micah_plan.residual.simulation import GATES, Term

# Actions across the joint of their own that are smaller than this share of the commands say nothing of their frame.
_ACROSS = 0.1
# A turn may make commands as long as the actions, give or take what a gain is uncertain by.
_AS_LONG = 1.02
# A threshold that lies further away than this share of the range is no shifted one but another stop.
_LARGEST_SHIFT = 0.15
NEVER_GATED = (-np.inf,) * GATES
# The form of a correction without a name.
UNNAMED = "unexplained"


@dataclass(frozen=True, eq=False)
class Candidate:
    """A term with starts for its parameters.

    Attributes:
        starts: (M, size) parameters with gates; those that are not free differ between starts only.
        free: columns within the term that are fitted.
        scale: (k,) what a large value of each of those is.
        bounds: (lower, upper) of columns that the lane bounds more than the form does: beyond them it would be another
            effect (a spring whose rest position is far away is a bias).
    """

    term: Term
    starts: Floats
    free: tuple[int, ...]
    scale: Floats
    bounds: Mapping[int, tuple[float, float]] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return self.term.form.name


def candidates(lane: Lane) -> tuple[Candidate, ...]:
    """All forms that the lane can show, each acting always and everywhere."""
    found = []
    for own in forms():
        if own.name == UNNAMED or own.layer in ("geometry", "place"):
            continue
        made = _STARTS[own.name](lane) if own.name in _STARTS else _plain(own, lane)
        if made is not None:
            found.append(_candidate(own, made, lane))
    return tuple(found)


def untried(name: str, lane: Lane) -> Candidate:
    """A form that was not tried since it would do the same as another (`indistinguishable`)."""
    return _candidate(form(name), _plain(form(name), lane), lane)


def _candidate(own: EffectForm, made: _Starts, lane: Lane) -> Candidate:
    starts, free, scale = made
    full = np.hstack([np.atleast_2d(starts), np.tile(NEVER_GATED, (len(np.atleast_2d(starts)), 1))])
    return Candidate(Term(own), full, free, np.asarray(scale, dtype=float), _bounds(own.name, lane))


def indistinguishable(part: Candidate, lane: Lane) -> tuple[str, ...]:
    """Forms that were not tried because on this lane they would do exactly the same as another."""
    same, name = [], part.name
    if name == "gain":
        same += [] if lane.visits_end() else ["sensor_scale"]
        same += ["frame_rotation"] if _may_be_a_turn(part.starts[0, 0], lane) else []
    if name == "bias":
        same += [] if lane.visits_end() else ["drift"]
        same += ["gravity"] if lane.unit == "m" else []
    return tuple(same)


def smooth(lane: Lane, *, is_lean: bool = False) -> Candidate:
    """The correction without a name: a smooth function of configuration, direction and speed of the command.

    Args:
        is_lean: fit only what depends on the command alone.
    """
    low, high = lane.visited
    margin = 0.02 * (high - low) + 1e-6
    size = lane.command_size
    start = [low - margin, high - low + 2 * margin, size, *(0.0,) * (3 + 2 * SMOOTH_BUMPS), *NEVER_GATED]
    free = tuple(range(3, 6 if is_lean else 6 + 2 * SMOOTH_BUMPS))
    scale = [0.3, 0.5, 0.5 * size, *(0.5 * size,) * SMOOTH_BUMPS, *(0.5,) * SMOOTH_BUMPS]
    return Candidate(Term(form(UNNAMED)), np.array([start]), free, np.array(scale[: len(free)]))


def _bounds(name: str, lane: Lane) -> dict[int, tuple[float, float]]:
    low, high = lane.visited
    width = high - low + 1e-6
    if name == "guard_shift":
        return {0: (-_LARGEST_SHIFT * width, _LARGEST_SHIFT * width)}
    if name == "spring":
        return {1: (low - width, high + width)}
    if name == "latch":
        return {1: (low, high), 2: (0.01 * width, 0.25 * width)}
    return {}


_Starts = tuple[Floats, tuple[int, ...], list[float]]
_Made = _Starts | None


def _plain(own: EffectForm, lane: Lane) -> _Starts:
    """Start of a form that nothing special is known of: neutral, or the middle of its bounds."""
    start, scale = [], []
    for parameter in own.parameters:
        large = lane.command_size if parameter.unit.startswith("coordinate") else 0.3
        low, high = max(parameter.lower, -large), min(parameter.upper, large)
        start.append(parameter.neutral if parameter.neutral is not None else 0.5 * (low + high))
        scale.append(large)
    return np.array([start]), tuple(range(len(start))), scale


def _sensor_scale(lane: Lane) -> _Made:
    """Only where an end is reached; else it is a gain."""
    return (np.array([[1.0]]), (0,), [0.3]) if lane.visits_end() else None


def _drift(lane: Lane) -> _Made:
    """Only where an end is reached; else it is a bias."""
    if not lane.visits_end():
        return None
    return np.array([[0.0]]), (0,), [0.3 * lane.command_size / lane.period]


def _frame_rotation(lane: Lane) -> _Made:
    """Only where actions across the joint have a life of their own.

    A small turn adds to each command a share of the action across the joint. Where that follows the command along it (a
    hand that always pushes at one angle, the chord of a long step) it adds what a gain or a saturation would.
    """
    if lane.action is None:
        return None
    rows = lane.counted_starts
    tangent, u = lane.path.tangents(lane.z[rows])[:, 3:], lane.u[rows]
    squared = np.maximum((tangent**2).sum(axis=1, keepdims=True), 1e-12)
    across = np.cross(lane.action[rows], tangent) / squared
    along = np.stack([np.ones_like(u), u, u * np.abs(u), u * u], axis=1)
    own = across - along @ np.linalg.lstsq(along, across, rcond=1e-9)[0]
    if np.sqrt(np.mean(own**2, axis=0)).max() < _ACROSS * lane.command_size:
        return None
    turns = np.vstack([0.4 * np.eye(3), -0.4 * np.eye(3)])
    return turns, (0, 1, 2), [0.3] * 3


def _may_be_a_turn(gain: float, lane: Lane) -> bool:
    """Whether a gain may be a turned frame: turned along the joint, actions can say no more than they are long."""
    if lane.action is None or _frame_rotation(lane) is not None:
        return False
    rows = lane.counted_starts
    arm2 = (lane.path.tangents(lane.z[rows])[:, 3:] ** 2).sum(axis=1)
    longest2 = float((lane.action[rows] ** 2).sum(axis=1) @ (1.0 / np.maximum(arm2, 1e-12)))
    return gain**2 * float((lane.u[rows] ** 2).sum()) < _AS_LONG**2 * longest2


def _delay(_: Lane) -> _Made:
    return np.array([[0.4], [1.0], [2.0], [3.5], [6.0]]), (0,), [1.0]


def _lag(_: Lane) -> _Made:
    return np.array([[0.3], [0.8], [2.0], [5.0]]), (0,), [1.0]


def _quantiles(lane: Lane, *shares: float) -> list[float]:
    sizes = np.abs(lane.u[lane.counted_starts])
    sizes = sizes[sizes > 1e-3 * lane.command_size]
    return [float(q) for q in np.quantile(sizes, shares)] if sizes.size else []


def _saturation(lane: Lane) -> _Made:
    at = _quantiles(lane, 0.3, 0.6, 0.85)
    return (np.array([[q] for q in at]), (0,), [0.3 * lane.command_size]) if at else None


def _dead_zone(lane: Lane) -> _Made:
    at = _quantiles(lane, 0.03, 0.1, 0.25, 0.45, 0.7)
    starts = [[q, lost] for q in at for lost in (0.0, 1.0)]
    return (np.array(starts), (0,), [0.2 * lane.command_size]) if at else None


def _backlash(lane: Lane) -> _Made:
    """Only where the command changes its direction, or the first steps may have been lost."""
    size = lane.command_size
    starts = [[width * size, side] for width in (0.5, 2.0) for side in (-1.0, 0.0, 1.0)]
    return np.array(starts), (0,), [0.5 * size]


def _stick_slip(lane: Lane) -> _Made:
    """The best of many grips: with a wrong one the part lets go in other rows, and nothing leads to the right one."""
    grip, own = np.geomspace(0.2, 10.0, 200)[:, None] * lane.command_size, form("stick_slip")
    memory, missed = own.at_rest((grip,)), np.zeros(len(grip))
    for t in range(lane.z.shape[1] - 1):
        arrived, memory = own.remember(np, lane.u[:, t], memory, (grip,))
        missed += (np.abs(lane.z[:, t + 1] - lane.z[:, t] - arrived) * lane.counted[:, t + 1]).sum(axis=1)
    return grip[np.argsort(missed, kind="stable")[:5]], (0,), [0.1 * lane.command_size]


def _spring(lane: Lane) -> _Made:
    low, high = lane.visited
    rests = (low, 0.5 * (low + high), high)
    starts = [[stiffness, rest, ahead] for rest in rests for stiffness in (0.05,) for ahead in (0.0, 1.0)]
    return np.array(starts), (0, 1), [0.1, 0.5 * (high - low) + 1e-6]


def _gravity(lane: Lane) -> _Made:
    if lane.unit != "rad":
        return None  # along a slide gravity is a bias
    return np.array([[0.0, 0.0]]), (0, 1), [0.3 * lane.command_size] * 2


def _latch(lane: Lane) -> _Made:
    low, high = lane.visited
    reach = 0.08 * (high - low) + 1e-6
    places = np.linspace(low, high, 7)
    size = lane.command_size
    return np.array([[0.3 * size, at, reach] for at in places]), (0, 1, 2), [0.3 * size, reach, reach]


def _limit(lane: Lane) -> _Made:
    low, high = lane.visited
    starts = [[low + share * (high - low), 1.0] for share in (0.4, 0.6, 0.8, 0.95)]
    starts += [[low + share * (high - low), -1.0] for share in (0.05, 0.2, 0.4, 0.6)]
    return np.array(starts), (0,), [0.1 * (high - low) + 1e-6]


def _guard_shift(lane: Lane) -> _Made:
    low, high = lane.visited
    width = high - low + 1e-6
    starts = []
    for end, side, seen in ((lane.lower, -1.0, low), (lane.upper, 1.0, high)):
        if np.isfinite(end):
            starts += [[seen - end, side], [0.05 * width, side], [-0.05 * width, side]]
    return (np.array(starts), (0,), [0.05 * width]) if starts else None


def _guard_hysteresis(lane: Lane) -> _Made:
    """Only where the part may cling to an end, and the recording gets there."""
    low, high = lane.visited
    reach = 0.05 * (high - low)
    seen = (lane.clings[0] and low < lane.lower + reach) or (lane.clings[1] and high > lane.upper - reach)
    at = _quantiles(lane, 0.3, 0.7, 0.95) if seen else []
    return (np.array([[q] for q in at]), (0,), [0.3 * lane.command_size]) if at else None


_STARTS = {
    "drift": _drift,
    "sensor_offset": lambda _: None,  # motion does not show it, see `reading`
    "sensor_scale": _sensor_scale,
    "frame_rotation": _frame_rotation,
    "delay": _delay,
    "lag": _lag,
    "saturation": _saturation,
    "dead_zone": _dead_zone,
    "backlash": _backlash,
    "stick_slip": _stick_slip,
    "spring": _spring,
    "gravity": _gravity,
    "latch": _latch,
    "limit": _limit,
    "guard_shift": _guard_shift,
    "guard_hysteresis": _guard_hysteresis,
}
