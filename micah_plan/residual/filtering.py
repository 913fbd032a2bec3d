"""The log density of every row of a coordinate under many hypotheses at once.

A hypothesis is a model (terms with their parameters) with noise of its own. The state is the configuration c and a
measurement error d that wanders: c⁺ = F(c, v, memory) + w, d⁺ = ρ d + e, seen as h(c) + d + ν. Each step is a Kalman
prediction and update, so every residual is an innovation, white if the hypothesis is right (Kailath, Sayed and Hassibi,
"Linear Estimation", ch. 9). A row is worth the density of Student's t, and a far one moves the state less (Agamennoni,
Nieto and Nebot, "Approximate inference in state-space models with heavy-tailed noise", IEEE TSP 2012).

All hypotheses go through the rows side by side, in one array operation per formula, each form on those that have it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from scipy.special import gammaln

from micah_plan.arrays import DIFFERENCE, ROUND_OFF, SURE_STDS, Booleans, Floats, Ints
from micah_plan.automaton.effects.form import EffectForm, Layer, Memory
from micah_plan.residual.candidates import GATES, Model
from micah_plan.residual.coordinate_data import CoordinateData

Kind = Literal["filter", "one_step", "rollout"]

STDS = ("white", "process", "motion", "wander")
"""Stds: of a reading; of what moves the part in a step, always and with a command of the usual size; of a reading's
error that wanders."""
NOISE = (*STDS, "low", "high")
"""Logs of `STDS` [of rad or m], and by how much the ends of the range are beside those that are known [rad or m]."""
# Correlation of the wandering error from row to row. Fitted, it comes near 1 and takes what a model lacks for noise.
_STAYS = 0.9
# Share of the variance that is left where something holds the part: a stop is no perfect pin.
_HELD_VARIANCE = 0.05
# Share of rows that may lie anywhere in the range (Box and Tiao, Biometrika 1968: contaminated normal).
_ANYWHERE = 1e-3
# Hypotheses x segments that go through the rows together: what the processor's cache holds of some twenty arrays.
_AT_ONCE = 16_000


@dataclass(frozen=True, eq=False)
class ModelBatch:
    """B hypotheses of one model, which differ in their parameters and noise.

    Attributes:
        model: the terms.
        values: (B, columns) parameters of the terms, gates included.
        noise: (B, 6) see `NOISE`.
        freedom: (B,) degrees of freedom of the t distribution.
    """

    model: Model
    values: Floats
    noise: Floats
    freedom: Floats

    def __len__(self) -> int:
        return len(self.values)


@dataclass(frozen=True, eq=False)
class Rows:
    """What B hypotheses make of the N rows that count, in the order of `of_rows`.

    Attributes:
        error: (B, N) measured minus predicted [rad or m].
        log_variance: (B, N) of it.
        density: (B, N) log density of each row [nats].
    """

    error: Floats
    log_variance: Floats
    density: Floats


def filtered(data: CoordinateData, batches: Sequence[ModelBatch]) -> Rows:
    """Rows of all hypotheses, one batch after the other."""
    counted = np.ascontiguousarray(data.counted.T)
    low, high = data.visited
    anywhere = _ANYWHERE / max(high - low, ROUND_OFF)
    parts = list[tuple[Floats, ...]]()
    for some in _in_parts(data, batches):
        error, variance = (rows.transpose(1, 0, 2)[:, counted] for rows in _Filter(data, some, "filter").run())
        freedom = np.concatenate([batch.freedom for batch in some])[:, None]
        parts.append((error, *_densities(error, variance, freedom, anywhere)))
    return Rows(*parts[0]) if len(parts) == 1 else Rows(*map(np.concatenate, zip(*parts, strict=True)))


def _densities(error: Floats, variance: Floats, freedom: Floats, anywhere: float) -> tuple[Floats, Floats]:
    """Logs of variances (b, N), and of densities: Student's t of freedoms (b, 1), or anywhere in the range."""
    log_variance, half = np.log(variance), 0.5 * (freedom + 1.0)
    log_density = error * error
    log_density /= variance
    log_density /= freedom
    log_density += 1.0
    np.log(log_density, out=log_density)
    log_density *= -half
    log_density += gammaln(half) - gammaln(0.5 * freedom) - 0.5 * np.log(freedom * np.pi)
    log_density -= 0.5 * log_variance
    density = np.exp(log_density, out=log_density)
    density += anywhere
    return log_variance, np.log(density, out=density)


def of_rows(data: CoordinateData, of_segment: Ints) -> Ints:
    """(N,) what each row that counts has from its segment (S,): segments side by side, the first rows of all first."""
    return np.asarray(np.broadcast_to(of_segment, data.counted.T.shape)[data.counted.T])


def errors(data: CoordinateData, batches: Sequence[ModelBatch], kind: Kind) -> tuple[Floats, Floats]:
    """(B, S, T) measured minus predicted [rad or m], 0 where a row does not count, and the variance of that."""
    parts = [_Filter(data, some, kind).run() for some in _in_parts(data, batches)]
    error, variance = (np.concatenate(rows, axis=1).transpose(1, 2, 0) for rows in zip(*parts, strict=True))
    return error * data.counted, variance


def _in_parts(data: CoordinateData, batches: Sequence[ModelBatch]) -> list[list[ModelBatch]]:
    """As many at once as the processor's cache holds."""
    most = max(1, _AT_ONCE // len(data.z))
    parts, size = [list[ModelBatch]()], 0
    for batch in batches:
        if parts[-1] and size + len(batch) > most:
            parts.append([])
            size = 0
        parts[-1].append(batch)
        size += len(batch)
    return parts


@dataclass(eq=False)
class _Acting:
    """A form in those of the hypotheses that have it.

    Attributes:
        rows: of the batch.
        p: per parameter (b, 1).
        order, time: (b, 1) since when; None: always and everywhere.
        modes: numbers of the modes in which it acts; empty: in all.
        memory: of earlier commands.
    """

    form: EffectForm
    rows: slice | Ints
    p: list[Floats]
    gates: tuple[Floats, Floats] | None
    modes: list[int]
    memory: Memory = field(default=())


class _Filter:
    """The state of the loop over rows, and the memories of the terms.

    Attributes:
        state: (2, B, S) c and d. covariance: (3, B, S) of c, of c with d, and of d.
    """

    def __init__(self, data: CoordinateData, batches: Sequence[ModelBatch], kind: Kind) -> None:
        self.data, self.kind = data, kind
        self.shape = sum(map(len, batches)), len(data.z)
        self.acting = _by_layer(data, batches)
        self.z, self.u, self.place, self.noise, self.time, self.order, self.mode = (
            np.ascontiguousarray(rows.T)
            for rows in (data.z, data.u, data.place, data.noise, data.time, data.order, data.mode)
        )
        self.ends = None if data.row_ends is None else np.ascontiguousarray(data.row_ends.transpose(0, 2, 1))
        noise = np.concatenate([batch.noise for batch in batches])
        variances = np.exp(2.0 * noise[:, : len(STDS)])
        self.white, self.process, self.motion, self.wander = (variances[:, k : k + 1] for k in range(len(STDS)))
        self.beside = noise[:, -2:-1], noise[:, -1:]
        self.is_alike = bool((self.noise == 1.0).all())
        self.effort = (self.u / data.command_size) ** 2
        self.freedom = np.concatenate([batch.freedom for batch in batches])[:, None]
        self.commands = self._commands()
        self.given_ends = self._given_ends()
        self.is_bounded = bool(np.isfinite([data.lower, data.upper]).any()) or "guard" in self.acting
        self.release = self._release()
        self.is_held = any(bool(np.any(release > 0)) for release in self.release)
        self.low, self.high = self._ends_at(0)
        offset, slope = self._reading(0)
        self.state, self.covariance = np.zeros((2, *self.shape)), np.zeros((3, *self.shape))
        self.state[0] = np.clip((self.z[0] - offset) / slope, self.low, self.high)
        self.covariance[0] = self.white * self.noise[0] / slope**2
        self.covariance[2] = self.wander
        for acting in self._all():
            acting.memory = acting.form.at_rest_in(self.c[acting.rows].copy(), acting.p)  # the memory keeps it
        self.at_ends, self.ends_before = (self.c <= self.low, self.c >= self.high), (self.low, self.high)

    def run(self) -> tuple[Floats, Floats]:
        """(T, B, S) errors and their variances."""
        rows = len(self.z)
        error, variance = np.zeros((rows, *self.shape)), np.ones((rows, *self.shape))
        for t in range(rows - 1):
            self._predict(t)
            if t == 0:
                self._forget()
            self._measure(t + 1, error[t + 1], variance[t + 1])
        return error, variance

    def _forget(self) -> None:
        """Take the second row of a segment that goes on as it was measured: what moves on need not have begun here."""
        if self.kind == "filter":
            self.covariance[0] += self.data.goes_on * self.data.command_size**2

    def step(self, t: int) -> None:
        """Go on to row t + 1."""
        self._predict(t)

    def reading(self, t: int) -> Floats:
        """(S,) what the first hypothesis reads in row t."""
        offset, slope = self._reading(t)
        return np.asarray((offset + slope * self.c)[0])

    @property
    def c(self) -> Floats:
        """(B, S) configuration."""
        return np.asarray(self.state[0])

    def _all(self) -> list[_Acting]:
        return [acting for layer in self.acting.values() for acting in layer]

    def _predict(self, t: int) -> None:
        v = np.empty(self.shape)
        v[:] = self.u[t]
        if self.commands is not None:
            rows, u = self.commands
            v[rows] = u[:, :, t]
        slope = np.ones(self.shape) if "force" in self.acting or "place" in self.acting else None
        for acting in self.acting.get("place", ()):
            self._respond(acting, t, v, slope)
        for acting in self.acting.get("memory", ()):
            before = v[acting.rows].copy()  # the memory keeps it
            out, acting.memory = acting.form.remember(np, before, acting.memory, acting.p)
            v[acting.rows] = self._gated(acting, t, out, before)
        for acting in self.acting.get("command", ()):
            before = v[acting.rows]
            out = self._gated(acting, t, acting.form.command(np, before, acting.p), before)
            if slope is not None and "place" in self.acting:
                ahead = before + DIFFERENCE * (slope[acting.rows] - 1.0)
                after = self._gated(acting, t, acting.form.command(np, ahead, acting.p), ahead)
                slope[acting.rows] = 1.0 + (after - out) / DIFFERENCE
            v[acting.rows] = out
        free = self.c + v
        for acting in self.acting.get("force", ()):
            c, command = self.c[acting.rows], v[acting.rows]
            added = acting.form.force(np, c, command, acting.p)
            steeper = (acting.form.force(np, c + DIFFERENCE, command, acting.p) - added) / DIFFERENCE
            free[acting.rows] += self._gated(acting, t, added, 0.0)
            if slope is not None:
                slope[acting.rows] += self._gated(acting, t, steeper, 0.0)
        self._move(v, free, slope, t)

    def _respond(self, acting: _Acting, t: int, v: Floats, slope: Floats | None) -> None:
        """Commands that come out of a place; what is uncertain of the configuration shrinks on the way there."""
        c, place, kept = self.c[acting.rows].copy(), self.place[t], acting.memory  # the memory keeps it
        out, acting.memory = acting.form.respond(np, c, place - c, kept, acting.p)
        ahead, _ = acting.form.respond(np, c + DIFFERENCE, place - c - DIFFERENCE, kept, acting.p)
        v[acting.rows] = out
        if slope is not None:
            slope[acting.rows] = 1.0 + (ahead - out) / DIFFERENCE

    def _move(self, v: Floats, free: Floats, slope: Floats | None, t: int) -> None:
        """Take the part to where it is free to go, or to what ends its way."""
        if slope is not None:
            np.minimum(np.maximum(slope, -1.0, out=slope), 1.0, out=slope)
        if self.is_bounded:
            self.low, self.high = self._ends_at(t)
            ended = np.minimum(np.maximum(free, self.low), self.high)
            is_free = ended == free
            if self.is_held:
                at_low, at_high = self._held(v, ended)
                ended = np.where(at_high, self.high, np.where(at_low, self.low, ended))
                is_free &= ~(at_low | at_high)
            if not is_free.all():
                slope = is_free.astype(np.float64) if slope is None else np.multiply(slope, is_free, out=slope)
            free = ended
        of_place, of_both, of_reading = self.covariance
        if slope is not None:
            of_both *= slope
            slope *= slope
            slope *= 1.0 - _HELD_VARIANCE
            slope += _HELD_VARIANCE
            of_place *= slope
        of_place += self.process + self.motion * self.effort[t]
        of_both *= _STAYS
        of_reading *= _STAYS**2
        of_reading += (1.0 - _STAYS**2) * self.wander
        self.state[0] = free
        self.state[1] *= _STAYS

    def _held(self, v: Floats, free: Floats) -> tuple[Booleans, Booleans]:
        """Whether the part is held at its lower and upper end: until a command releases it, or the end is gone."""
        (before_low, before_high), (low_before, high_before) = self.at_ends, self.ends_before
        stays_low = before_low & (v <= self.release[0]) & (self.low == low_before)
        stays_high = before_high & (-v <= self.release[1]) & (self.high == high_before)
        self.ends_before = self.low, self.high
        self.at_ends = stays_low | (free <= self.low), stays_high | (free >= self.high)
        return stays_low & (self.release[0] > 0), stays_high & (self.release[1] > 0)

    def _measure(self, t: int, error: Floats, variance: Floats) -> None:
        """Compare with row t, write the error and its variance, and take the measurement in."""
        offset, slope = self._reading(t)
        white = self.white if self.is_alike else self.white * self.noise[t]
        (place, wandered), (of_place, of_both, of_reading) = self.state, self.covariance
        if "sensor" in self.acting:
            error[:] = self.z[t] - offset - slope * place
            to_place, to_reading = slope * of_place + of_both, slope * of_both + of_reading
            np.multiply(slope, to_place, out=variance)
            variance += to_reading
        else:
            np.subtract(self.z[t], place, out=error)
            to_place, to_reading = of_place + of_both, of_both + of_reading
            np.add(to_place, to_reading, out=variance)
        error -= wandered
        variance += white
        if self.kind == "rollout":
            return
        gone = self._let_go(t, error, slope) if self.is_held else None
        if self.kind == "one_step":
            seen = self.data.is_measured[:, t]
            self.state[0] = np.where(seen, place + (error + wandered) / slope, place)
            self.covariance[0] = np.where(seen, (white + self.wander) / slope**2, of_place)
            return
        weight = error * error
        weight /= variance
        weight += self.freedom
        np.divide(self.freedom + 1.0, weight, out=weight)
        np.minimum(weight, 1.0, out=weight)
        weight /= variance
        gain = to_place * weight
        weight *= to_reading
        place += gain * error
        wandered += weight * error
        of_reading -= weight * to_reading
        of_both -= gain * to_reading
        gain *= to_place
        of_place -= gain
        if gone is not None and gone.any():
            place[:] = np.where(gone, (self.z[t] - offset) / slope, place)
            of_place[:] = np.where(gone, white / slope**2, of_place)
            of_both[gone] = 0.0
        if self.is_bounded:
            np.minimum(np.maximum(place, self.low, out=place), self.high, out=place)

    def _let_go(self, t: int, error: Floats, slope: Any) -> Booleans:
        """Which parts were predicted on the wrong side of being held: measured away from an end, or left behind there.

        Whether a part arrived at an end, and whether a command was just enough to leave it, noise decides. What is
        measured afterwards tells, as soon as it is no noise; else one wrong guess would last for many rows.
        """
        noise = SURE_STDS * self.data.blur * np.sqrt(self.noise[t])
        changed = np.zeros(self.shape, dtype=bool)
        ends = []
        for end, side, at, release in zip((self.low, self.high), (1.0, -1.0), self.at_ends, self.release, strict=True):
            away = side * (self.c + error / slope - end)
            gone = at & (release > 0) & (side * error > np.minimum(release * slope, noise))
            caught = ~at & (release > 0) & (side * error < -noise) & (away < noise)
            ends.append((at & ~gone) | caught)
            changed |= gone | caught
        self.at_ends = ends[0], ends[1]
        return changed

    def _reading(self, t: int) -> tuple[Any, Any]:
        """Offset and slope of the reading at row t; sensors are affine."""
        if "sensor" not in self.acting:
            return 0.0, 1.0
        offset, slope = np.zeros(self.shape), np.ones(self.shape)
        for acting in self.acting["sensor"]:
            time = self.time[t]
            before, steep = offset[acting.rows], slope[acting.rows]
            zero = acting.form.measured(np, before, time, acting.p)
            one = acting.form.measured(np, before + steep, time, acting.p)
            offset[acting.rows] = self._gated(acting, t, zero, before)
            slope[acting.rows] = self._gated(acting, t, one - zero, steep)
        return offset, slope

    def _release(self) -> tuple[Floats, Floats]:
        """(B, 1) commands that leave the lower and the upper end."""
        release = [np.full((self.shape[0], 1), size) for size in self.data.release]
        for acting in self.acting.get("guard", ()):
            for side in (0, 1):
                if self.data.clings[side]:
                    needed = np.maximum(release[side][acting.rows], acting.form.release(acting.p))
                    release[side][acting.rows] = needed
        return release[0], release[1]

    def _ends_at(self, t: int) -> tuple[Floats, Floats]:
        guards = self.acting.get("guard", ())
        is_same = self.ends is None and not any(acting.gates or acting.modes for acting in guards)
        if is_same and t:
            return self.low, self.high
        wide = (self.shape[0], 1) if is_same else self.shape
        low, high = self.given_ends if self.ends is None else (self.ends[0, t], self.ends[1, t])
        low, high = low + self.beside[0] + np.zeros(wide), high + self.beside[1] + np.zeros(wide)
        for acting in guards:
            before = low[acting.rows], high[acting.rows]
            after = acting.form.stops(np, *before, acting.p)
            low[acting.rows] = self._gated(acting, t, after[0], before[0])
            high[acting.rows] = self._gated(acting, t, after[1], before[1])
        return low, np.maximum(high, low)

    def _given_ends(self) -> tuple[Floats, Floats]:
        """(B, 1) ends without effects. What a sensor reads beyond the model's range need not lie there."""
        ends = np.full((2, self.shape[0], 1), [[[self.data.lower]], [[self.data.upper]]])
        for acting in self.acting.get("sensor", ()):
            ends[:, acting.rows] = np.reshape(self.data.told, (2, 1, 1))
        return ends[0], ends[1]

    def _commands(self) -> tuple[slice | Ints, Floats] | None:
        """Commands (b, S, T) of those that read the actions in another frame."""
        if "frame" not in self.acting or self.data.action is None:
            return None
        (acting,) = self.acting["frame"]
        action, wide = list(np.moveaxis(self.data.action, -1, 0)), [value[:, :, None] for value in acting.p]
        meant = np.stack([acting.form.frame_command(np, action, list(unit), wide) for unit in np.eye(3)], axis=-1)
        places = np.broadcast_to(self.data.z, meant.shape[:-1])
        u = self.data.path.commanded(places.ravel(), meant.reshape(-1, 3))
        return acting.rows, np.asarray(np.nan_to_num(u).reshape(meant.shape[:-1]))

    def _gated(self, acting: _Acting, t: int, changed: Any, plain: Any) -> Any:
        """The changed value where and when a term acts, else the plain one."""
        if acting.gates is None and not acting.modes:
            return changed
        acts: Any = True
        if acting.gates is not None:
            acts = (self.order[t] >= acting.gates[0]) & (self.time[t] >= acting.gates[1])
        if acting.modes:
            acts = acts & np.isin(self.mode[t], acting.modes)
        return np.where(acts, changed, plain)


def generated(data: CoordinateData, hypothesis: ModelBatch, mode_at: Callable[[Floats], Ints]) -> CoordinateData:
    """Data whose measurements are what one hypothesis makes of their starts and commands, without noise.

    Args:
        mode_at: index of the mode at configurations.
    """
    made = replace(data, z=data.z.copy(), place=data.place.copy(), mode=data.mode.copy())
    run = _Filter(made, [hypothesis], "rollout")
    for t in range(data.z.shape[1] - 1):
        run.place[t] = made.place[:, t] = made.z[:, t] + made.u[:, t]
        run.mode[t] = made.mode[:, t] = mode_at(made.z[:, t])
        run.step(t)
        made.z[:, t + 1] = run.reading(t + 1)
    return made


def _by_layer(data: CoordinateData, batches: Sequence[ModelBatch]) -> dict[Layer, list[_Acting]]:
    """The terms of all batches by their layer, in the order in which a step goes through them.

    The first of each hypothesis come first, then the second: a form is evaluated once for all that have it there.
    """
    found: dict[tuple[Layer, int, str, tuple[str, ...]], list[tuple[int, EffectForm, Floats]]] = {}
    first = 0
    for batch in batches:
        at, count = 0, dict[Layer, int]()
        for term in batch.model:
            layer = term.form.layer
            number = count.get(layer, 0)
            count[layer] = number + 1
            own = batch.values[:, at : at + term.size]
            found.setdefault((layer, number, term.form.name, term.modes), []).append((first, term.form, own))
            at += term.size
        first += len(batch)
    result: dict[Layer, list[_Acting]] = {}
    for (layer, _, _, modes), entries in sorted(found.items(), key=lambda item: item[0][1]):
        rows = np.concatenate([np.arange(start, start + len(values)) for start, _, values in entries])
        values = np.concatenate([values for _, _, values in entries])
        is_one_piece = len(rows) == rows[-1] - rows[0] + 1
        gates = values[:, -GATES:]
        result.setdefault(layer, []).append(
            _Acting(
                form=entries[0][1],
                rows=slice(int(rows[0]), int(rows[-1]) + 1) if is_one_piece else rows,
                p=[values[:, k : k + 1] for k in range(values.shape[1] - GATES)],
                gates=None if np.isneginf(gates).all() else (gates[:, :1], gates[:, 1:]),
                modes=[data.modes.index(name) for name in modes],
            )
        )
    return result
