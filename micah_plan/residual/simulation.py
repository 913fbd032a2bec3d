"""Many models of one coordinate run along all segments at once: predictions, innovations and their variances.

A model is a row of parameters. The configuration is a latent state, c⁺ = F(c, v, memory) + w, seen as h(c) + v; each
step is a Kalman prediction and update, so every residual is an innovation, white if the model is right (Kailath, Sayed
and Hassibi, "Linear Estimation", ch. 9). With gain 1 the same loop gives one-step predictions from measured rows, with
gain 0 the roll-out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from micah_plan.arrays import DIFFERENCE, SURE_STDS, Floats, Ints
from micah_plan.automaton.effects.form import EffectForm
from micah_plan.residual.coordinate_data import CoordinateData

Kind = Literal["filter", "one_step", "rollout"]

# Gating columns after a term's own parameters: since which place in the recording (0 to 1) and since when in a run [s].
GATES = 2
# Share of the variance that is left where a stop holds the part: a stop is no perfect pin.
_HELD_VARIANCE = 0.05


@dataclass(frozen=True)
class Term:
    """A form that acts in some modes (empty: in all)."""

    form: EffectForm
    modes: tuple[str, ...] = ()

    @property
    def size(self) -> int:
        """Columns of parameters: those of the form, then the gates."""
        return len(self.form.parameters) + GATES


Model = tuple[Term, ...]


@dataclass(frozen=True, eq=False)
class Prediction:
    """What B rows of parameters predict.

    Attributes:
        error: (B, S, T) measured minus predicted [rad or m]; 0 where a row does not count.
        variance: (B, S, T) of it, relative to the noise scale.
    """

    error: Floats
    variance: Floats


def columns(model: Model) -> int:
    """Number of parameters of a model, gates included."""
    return sum(term.size for term in model)


def simulate_terms(
    data: CoordinateData, model: Model, parameters: Floats, process_share: Floats, kind: Kind = "filter"
) -> Prediction:
    """Run B models along a coordinate's data.

    Args:
        parameters: (B, columns(model)).
        process_share: (B,) share of the noise variance that moves the part rather than blurs the measurement, 0 to 1.
        kind: predictions from the filtered state, from the measured one, or from the first row only.
    """
    run = _Run(data, model, parameters, process_share)
    count, rows = data.z.shape
    error = np.zeros((len(parameters), count, rows))
    variance = np.ones_like(error)
    for t in range(rows - 1):
        run.step(t)
        error[:, :, t + 1], variance[:, :, t + 1] = run.measure(t + 1, kind)
    return Prediction(error * data.counted, variance)


def generated(
    data: CoordinateData, model: Model, parameters: Floats, mode_at: Callable[[Floats], Ints]
) -> CoordinateData:
    """Data whose measurements are what a model makes of its starts and commands, without noise.

    Args:
        parameters: (1, columns(model)).
        mode_at: index of the mode at configurations.
    """
    made = replace(data, z=data.z.copy(), place=data.place.copy(), mode=data.mode.copy())
    run = _Run(made, model, parameters, np.zeros(1))
    for t in range(data.z.shape[1] - 1):
        made.place[:, t] = made.z[:, t] + made.u[:, t]
        made.mode[:, t] = mode_at(made.z[:, t])
        run.step(t)
        offset, slope = run.reading(t + 1)
        made.z[:, t + 1] = (offset + slope * run.c)[0]
    return made


class _Run:
    """The state of the loop: c and its variance (B, S), and the memories of the terms."""

    def __init__(self, data: CoordinateData, model: Model, parameters: Floats, process_share: Floats) -> None:
        self.data, self.model = data, model
        self.p = _split(model, parameters)
        self.q = process_share[:, None]
        self.process = np.moveaxis(self.q[:, :, None] * data.process_profile, 2, 0)
        self.blurred = np.moveaxis((1.0 - self.q[:, :, None]) * data.noise, 2, 0)
        self.layers: dict[str, list[int]] = {}
        for number, term in enumerate(model):
            self.layers.setdefault(term.form.layer, []).append(number)
        self.low, self.high, self.release = self._ends(parameters)
        self.commands = self._commands()
        self.always = [self._is_ungated(number) for number in range(len(model))]
        self.is_bounded = bool(np.isfinite([data.lower, data.upper]).any()) or "guard" in self.layers
        # A command of no size leaves every end, so nothing sticks there.
        self.is_held = any(bool(np.any(release > 0)) for release in self.release)
        ones = np.ones((len(parameters), data.z.shape[0]))
        offset, slope = self._sensor(0, ones)
        low, high = self._ends_at(0)
        self.c = np.minimum(np.maximum((data.z[:, 0] - offset) / slope, low), high) * ones
        self.variance = self.blurred[0] / slope**2 * ones
        self.memory = [term.form.at_rest_in(self.c, p) for term, p in zip(model, self.p, strict=True)]
        self.at_ends, self.ends_before = (self.c <= low, self.c >= high), (low, high)

    def step(self, t: int) -> None:
        """Predict the state of row t + 1."""
        v: Any = self.data.u[:, t] if self.commands is None else self.commands[:, :, t]
        for n in self.layers.get("place", ())[-1:]:  # the last says how a part follows places, whatever is before it
            v = self._responded(n, t)
        for n in self.layers.get("memory", ()):
            out, self.memory[n] = self.model[n].form.remember(np, v, self.memory[n], self.p[n])
            v = self._gated(n, t, out, v)
        for n in self.layers.get("command", ()):
            v = self._gated(n, t, self.model[n].form.command(np, v, self.p[n]), v)
        free = self.c + v
        for n in self.layers.get("force", ()):
            added = self.model[n].form.force(np, self.c, v, self.p[n])
            free = free + self._gated(n, t, added, 0.0)
        low, high = self._ends_at(t)
        self.variance = self.variance + self.process[t]
        if not self.is_bounded:
            self.c = free
            return
        ended = (free < low) | (free > high)
        free = np.minimum(np.maximum(free, low), high)
        if self.is_held:
            at_low, at_high = self._held(v, free, low, high)
            free = np.where(at_high, high, np.where(at_low, low, free))
            ended = ended | at_low | at_high
        self.variance = np.where(ended, _HELD_VARIANCE * self.variance, self.variance)
        self.c = free

    def _responded(self, n: int, t: int) -> Any:
        """The command that comes out of a place; what is uncertain of the configuration shrinks on the way there."""
        form_of_term, p, place, kept = self.model[n].form, self.p[n], self.data.place[:, t], self.memory[n]
        v, self.memory[n] = form_of_term.respond(np, self.c, place - self.c, kept, p)
        ahead, _ = form_of_term.respond(np, self.c + DIFFERENCE, place - self.c - DIFFERENCE, kept, p)
        self.variance = self.variance * np.minimum((1.0 + (ahead - v) / DIFFERENCE) ** 2, 1.0)
        return v

    def _held(self, v: Any, free: Any, low: Any, high: Any) -> tuple[Any, Any]:
        """Whether the part is held at its lower and upper end: until a command releases it, or the end is gone."""
        (before_low, before_high), (low_before, high_before) = self.at_ends, self.ends_before
        stays_low = before_low & (v <= self.release[0]) & (low == low_before)
        stays_high = before_high & (-v <= self.release[1]) & (high == high_before)
        self.ends_before = low, high
        self.at_ends = stays_low | (free <= low), stays_high | (free >= high)
        return stays_low & (self.release[0] > 0), stays_high & (self.release[1] > 0)

    def measure(self, t: int, kind: Kind) -> tuple[Floats, Floats]:
        """Compare with row t and take the measurement in."""
        offset, slope = self._sensor(t, self.c) if "sensor" in self.layers else (0.0, 1.0)
        error = self.data.z[:, t] - (offset + slope * self.c)
        spread = slope**2 * self.variance + self.blurred[t]
        if kind == "rollout":
            return error, spread
        gone = self._let_go(t, error, slope) if self.is_held else None
        if kind == "one_step":
            self.c = np.where(self.data.is_measured[:, t], self.c + error / slope, self.c)
            return error, spread
        gain = self.variance * slope / spread
        if gone is not None:
            gain = np.where(gone, 1.0 / slope, gain)
        self.c = self.c + gain * error
        if self.is_bounded:
            low, high = self._ends_at(t - 1)
            self.c = np.minimum(np.maximum(self.c, low), high)
        variance = self.variance * (1.0 - gain * slope)
        self.variance = variance if gone is None else np.where(gone, self.blurred[t] / slope**2, variance)
        return error, spread

    def _let_go(self, t: int, error: Floats, slope: Any) -> Any:
        """Which parts were predicted on the wrong side of being held: measured away from an end, or left behind there.

        Whether a part arrived at an end, and whether a command was just enough to leave it, noise decides. What is
        measured afterwards tells, as soon as it is no noise; else one wrong guess would last for many rows.
        """
        noise = SURE_STDS * self.data.blur * np.sqrt(self.data.noise[:, t])
        changed = np.zeros_like(error, dtype=bool)
        low, high = self._ends_at(t - 1)
        ends = []
        for end, side, at, release in zip((low, high), (1.0, -1.0), self.at_ends, self.release, strict=True):
            away = side * (self.c + error / slope - end)
            gone = at & (release > 0) & (side * error > np.minimum(release * slope, noise))
            caught = ~at & (release > 0) & (side * error < -noise) & (away < noise)
            ends.append((at & ~gone) | caught)
            changed = changed | gone | caught
        self.at_ends = ends[0], ends[1]
        return changed

    def reading(self, t: int) -> tuple[Any, Any]:
        """Offset and slope of the reading at row t."""
        return self._sensor(t, self.c)

    def _sensor(self, t: int, like: Floats) -> tuple[Any, Any]:
        """Offset and slope of the reading at row t; sensors are affine."""
        offset: Any = 0.0 * like
        slope: Any = 1.0 + 0.0 * like
        for n, term in enumerate(self.model):
            if term.form.layer == "sensor":
                time = self.data.time[:, t]
                zero = term.form.measured(np, offset, time, self.p[n])
                measured = term.form.measured(np, offset + slope, time, self.p[n])
                offset, slope = self._gated(n, t, zero, offset), self._gated(n, t, measured - zero, slope)
        return offset, slope

    def _ends(self, parameters: Floats) -> tuple[Any, Any, tuple[Any, Any]]:
        """Ends over all terms (used where no end is gated), and the commands that leave them."""
        column = np.zeros((len(parameters), 1))
        low, high = (end + column for end in self._given_ends())
        release: list[Any] = [self.data.release[0] + column, self.data.release[1] + column]
        for term, p in zip(self.model, self.p, strict=True):
            if term.form.layer == "guard":
                low, high = term.form.stops(np, low, high, p)
                for side in (0, 1):
                    if self.data.clings[side]:
                        release[side] = np.maximum(release[side], term.form.release(p))
        return low, np.maximum(high, low), (release[0], release[1])

    def _given_ends(self) -> tuple[float, float]:
        """The ends without effects. What a sensor reads beyond the model's range need not lie there."""
        return self.data.told if "sensor" in self.layers else (self.data.lower, self.data.upper)

    def _ends_at(self, t: int) -> tuple[Any, Any]:
        guards, row_ends = self.layers.get("guard", ()), self.data.row_ends
        if row_ends is None and all(self.always[n] for n in guards):
            return self.low, self.high
        none = np.zeros((len(self.q), len(self.data.z)))
        low, high = self._given_ends() if row_ends is None else (row_ends[0, :, t], row_ends[1, :, t])
        low, high = low + none, high + none
        for n in guards:
            changed = self.model[n].form.stops(np, low, high, self.p[n])
            low, high = self._gated(n, t, changed[0], low), self._gated(n, t, changed[1], high)
        return low, np.maximum(high, low)

    def _commands(self) -> Floats | None:
        """(B, S, T) commands read from the actions in another frame; None if no term asks for that."""
        data = self.data
        if data.action is None:
            return None
        for term, p in zip(self.model, self.p, strict=True):
            if term.form.layer == "frame":
                a, wide = list(np.moveaxis(data.action, -1, 0)), [value[:, :, None] for value in p]
                meant = np.stack([term.form.frame_command(np, a, list(unit), wide) for unit in np.eye(3)], axis=-1)
                places = np.broadcast_to(data.z, meant.shape[:-1])
                u = data.path.commanded(places.ravel(), meant.reshape(-1, 3))
                return np.asarray(np.nan_to_num(u).reshape(meant.shape[:-1]))
        return None

    def _is_ungated(self, n: int) -> bool:
        return not self.model[n].modes and bool(np.isneginf(self._gates[n]).all())

    def _gated(self, n: int, t: int, changed: Any, plain: Any) -> Any:
        """The changed value where and when the term acts, else the plain one."""
        if self.always[n]:
            return changed
        since_order, since_time = self._gates[n]
        acts = (self.data.order[:, t] >= since_order) & (self.data.time[:, t] >= since_time)
        modes = self.model[n].modes
        if modes:
            acts &= np.isin(self.data.mode[:, t], [self.data.modes.index(name) for name in modes])
        return np.where(acts, changed, plain)

    @property
    def _gates(self) -> Sequence[Any]:
        return [p[-GATES:] for p in self.p]


def _split(model: Model, parameters: Floats) -> list[list[Floats]]:
    """Per term, its columns as (B, 1) arrays."""
    pieces, at = [], 0
    for term in model:
        pieces.append([parameters[:, k : k + 1] for k in range(at, at + term.size)])
        at += term.size
    return pieces
