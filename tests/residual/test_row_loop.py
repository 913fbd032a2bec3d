"""The compiled loop over rows beside a filter for one hypothesis, written row by row in plain Python.

The reference evaluates the formulas with numbers, takes their slopes by differences, and shares no code with the loop.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import planted_effects as plants
import pytest
from scipy.stats import t as student_t

from micah_plan.automaton.effects.memories import LONGEST_DELAY
from micah_plan.automaton.effects.registry import form, forms
from micah_plan.automaton.tracks import tracks
from micah_plan.residual.candidates import NEVER_GATED, Term
from micah_plan.residual.coordinate_data import coordinate_data_of
from micah_plan.residual.filtering import ModelBatch, errors, filtered, noiseless_data
from micah_plan.residual.row_loop import LINE

# So small that no kink of a formula is within it.
STEP = 1e-8


class Reference:
    """One hypothesis in one segment."""

    def __init__(self, data, batch, number, s):
        self.data, self.s, self.freedom = data, s, batch.freedom[number]
        self.terms, first = [], 0
        for term in batch.model:
            values = batch.values[number, first : first + term.size].tolist()
            self.terms.append((term, values[:-2], values[-2:]))
            first += term.size
        noise = batch.noise[number]
        self.white, self.process, self.motion, self.wander = np.exp(2.0 * noise[:4]).tolist()
        self.beside = noise[4:]
        self.release = list(data.release)
        for term, p, _ in self.terms:
            if term.form.layer == "guard":
                for side in (0, 1):
                    if data.clings[side]:
                        self.release[side] = max(self.release[side], term.form.release(p))

    def of(self, layer):
        return [(k, *entry) for k, entry in enumerate(self.terms) if entry[0].form.layer == layer]

    def is_active(self, term, gates, t):
        data, s = self.data, self.s
        inside = not term.modes or data.modes[data.mode[s, t]] in term.modes
        return inside and data.order[s, t] >= gates[0] and data.time[s, t] >= gates[1]

    def ends(self, t):
        given = self.data.ends_of_model if self.of("sensor") else (self.data.lower, self.data.upper)
        given = given if self.data.row_ends is None else self.data.row_ends[:, self.s, t]
        low, high = given[0] + self.beside[0], given[1] + self.beside[1]
        for _, term, p, gates in self.of("guard"):
            if self.is_active(term, gates, t):
                low, high = term.form.stops(np, low, high, p)
        return float(low), float(max(high, low))

    def read(self, c, t):
        for _, term, p, gates in self.of("sensor"):
            if self.is_active(term, gates, t):
                c = term.form.measured(np, c, self.data.time[self.s, t], p)
        return c

    def free(self, c, t):
        """Where the part is free to go, the command that it gets, and memories after it."""
        data, s, after = self.data, self.s, dict(self.memory)
        v = data.u[s, t]
        for k, term, p, _ in self.of("place"):
            v, after[k] = term.form.respond(np, c, data.place[s, t] - c, self.memory[k], p)
        for k, term, p, gates in self.of("memory"):
            out, after[k] = term.form.remember(np, v, self.memory[k], p)
            v = out if self.is_active(term, gates, t) else v
        for _, term, p, gates in self.of("command"):
            v = term.form.command(np, v, p) if self.is_active(term, gates, t) else v
        there = c + v
        for _, term, p, gates in self.of("force"):
            there += term.form.force(np, c, v, p) if self.is_active(term, gates, t) else 0.0
        return float(there), float(v), after

    def begun(self, term, c, moved, p):
        """The memory at the first row: of commands before it, where they are known."""
        memory, delay = term.form.in_motion(c, moved, p), term.form.late_by
        kept = 0 if delay is None else math.ceil(p[delay])
        known = self.data.earlier[int(term.form.layer == "place"), self.s, :kept]
        late = [own if np.isnan(one) else one for own, one in zip(memory[len(memory) - kept :], known, strict=True)]
        return (*memory[: len(memory) - kept], *late)

    def rows(self, kind):
        """(T,) errors and variances."""
        data, s = self.data, self.s
        count = int(np.flatnonzero(data.counted[s]).max()) + 1
        error, variance = np.zeros(data.z.shape[1]), np.ones(data.z.shape[1])
        zero, one = self.read(0.0, 0), self.read(1.0, 0)
        low, high = self.ends(0)
        c = min(max((data.z[s, 0] - zero) / (one - zero), low), high)
        self.memory = {k: self.begun(term, c, data.moving[s], p) for k, (term, p, _) in enumerate(self.terms)}
        # As long as commands from before the log may act that nobody knows.
        delays = [p[term.form.late_by] for term, p, _ in self.terms if term.form.late_by is not None]
        unheard = max(delays, default=0.0) if np.isnan(data.earlier[0, s, 0]) else 0.0
        P = np.array([[self.white * data.noise[s, 0] / (one - zero) ** 2, 0.0], [0.0, self.wander]])
        d, at, before = 0.0, [c <= low, c >= high], (low, high)
        for t in range(count - 1):
            free, v, after = self.free(c, t)
            slope = (self.free(c + STEP, t)[0] - self.free(c - STEP, t)[0]) / (2.0 * STEP)
            self.memory, (low, high) = after, self.ends(t)
            there = min(max(free, low), high)
            slope = min(max(slope, -1.0), 1.0) if there == free else 0.0
            stays = [at[k] and (v, -v)[k] <= self.release[k] and (low, high)[k] == before[k] for k in (0, 1)]
            at, before = [stays[0] or there <= low, stays[1] or there >= high], (low, high)
            for k in (0, 1):
                if stays[k] and self.release[k] > 0.0:
                    there, slope = (low, high)[k], 0.0
            effort = (data.u[s, t] / data.command_size) ** 2
            of_place = P[0, 0] * (0.95 * slope**2 + 0.05) + self.process + self.motion * effort
            P = np.array([[of_place, 0.9 * slope * P[0, 1]], [0.0, 0.81 * P[1, 1] + 0.19 * self.wander]])
            P[1, 0] = P[0, 1]
            c, d = there, 0.9 * d
            if t == 0 and kind == "filter" and data.goes_on[s]:
                P[0, 0] += data.command_size**2
            zero, one = self.read(0.0, t + 1), self.read(1.0, t + 1)
            h, white = np.array([one - zero, 1.0]), self.white * data.noise[s, t + 1]
            e = data.z[s, t + 1] - zero - h @ [c, d]
            S = h @ P @ h + white
            error[t + 1], variance[t + 1] = e * data.counted[s, t + 1], S
            if kind == "rollout":
                continue
            gone = self.let_go(at, c + e / h[0], e, h[0], (low, high), t + 1)
            if kind == "one_step":
                if data.is_measured[s, t + 1]:
                    c, P[0, 0] = (data.z[s, t + 1] - zero) / h[0], (white + self.wander) / h[0] ** 2
                continue
            far = max((self.freedom + e**2 / S) / (self.freedom + 1.0), 1.0)
            gain = P @ h / S / far
            c, d = c + gain[0] * e, d + gain[1] * e
            P = (far if t <= unheard else 1.0) * (P - np.outer(gain, P @ h))
            if gone:
                c, P[0, 0], P[0, 1], P[1, 0] = (data.z[s, t + 1] - zero) / h[0], white / h[0] ** 2, 0.0, 0.0
            c = min(max(c, low), high)
        return error, variance

    def let_go(self, at, there, e, steep, ends, t):
        noise, changed = 4.0 * self.data.blur * math.sqrt(self.data.noise[self.s, t]), False
        for k, side in ((0, 1.0), (1, -1.0)):
            if self.release[k] > 0.0:
                away = side * (there - ends[k])
                gone = at[k] and side * e > min(self.release[k] * steep, noise)
                caught = not at[k] and side * e < -noise and away < noise
                at[k] = (at[k] and not gone) or caught
                changed = changed or gone or caught
        return changed


@pytest.fixture(scope="module")
def data(door):
    """Runs of a door that reaches its end and is held there; one row of one run is not measured."""
    (found,) = coordinate_data_of(door, tracks(door, plants.door_recording(plants.runs_of(plants.clinging, 4, 40, 8))))
    noise, counted = found.noise.copy(), found.counted.copy()
    noise[1, 7], counted[1, 7] = 1e9, False
    noise[2, 20:25] = 4.0
    return replace(found, noise=noise, counted=counted)


def drawn(data, model, rng, count):
    """Hypotheses with random parameters that are sensible."""
    values = []
    for term in model:
        size = data.command_size
        for q in term.form.parameters:
            large = size if q.unit.startswith("coordinate") else 0.5
            centre = q.neutral if q.neutral is not None else 0.5
            values.append(np.clip(centre + large * rng.standard_normal(count), q.lower, q.upper))
        gates = np.tile(NEVER_GATED, (count, 1))
        if rng.random() < 0.4:
            gates[::2, 0] = 0.5
            gates[1::4, 1] = 1.0
        values += list(gates.T)
    noise = rng.normal([-5.5, -6.5, -5.0, -5.5, 0.0, 0.0], [0.5] * 4 + [0.01] * 2, (count, 6))
    columns = np.array(values).T if values else np.zeros((count, 0))
    return ModelBatch(model, columns, noise, np.where(rng.random(count) < 0.5, 4.0, 60.0))


def compared(data, batch, kind):
    found, spread = errors(data, [batch], kind)
    for number in range(len(batch)):
        for s in range(len(data.z)):
            error, variance = Reference(data, batch, number, s).rows(kind)
            counted = data.counted[s]
            np.testing.assert_allclose(found[number, s], error, atol=2e-6)
            np.testing.assert_allclose(np.log(spread[number, s][counted]), np.log(variance[counted]), atol=2e-3)


NAMES = [one.name for one in forms() if one.layer not in ("frame", "geometry") and one.name != "unexplained"]
MODELS = [(), *((name,) for name in NAMES), ("gain", "delay", "latch"), ("follow", "lag", "spring"), ("gain", "gain")]


@pytest.mark.parametrize("names", MODELS, ids=" and ".join)
@pytest.mark.parametrize("kind", ["filter", "one_step", "rollout"])
def test_the_loop_does_what_a_filter_by_hand_does(data, names, kind) -> None:
    rng = np.random.default_rng(sum(map(ord, "".join(names))))
    modes = [(), (data.modes[0],)]
    model = tuple(Term(form(name), modes[rng.random() < 0.3]) for name in names)
    compared(data, drawn(data, model, rng, 6), kind)


@pytest.mark.parametrize("names", [("gain",), ("limit",), ("follow", "guard_shift")])
def test_ends_may_be_those_of_each_row(data, names) -> None:
    """Another coordinate is in the way now and then: the end comes nearer, and goes away again."""
    rng = np.random.default_rng(9)
    near = np.where(rng.random(data.z.shape) < 0.2, 0.6, data.upper)
    other = replace(data, row_ends=np.stack([np.full(data.z.shape, data.lower), near]))
    batch = drawn(other, tuple(Term(form(name)) for name in names), rng, 4)
    for kind in ("filter", "one_step", "rollout"):
        compared(other, batch, kind)
    assert np.abs(errors(other, [batch], "filter")[0] - errors(data, [batch], "filter")[0]).max() > 0.01


def test_a_delay_line_holds_the_longest_delay(data) -> None:
    """The newest command, and those before and after a delay that ends within a row."""
    assert LONGEST_DELAY + 2 <= LINE
    assert data.earlier.shape[2] == LONGEST_DELAY + 1


def test_densities_are_those_of_students_t_or_of_a_row_anywhere(data) -> None:
    batch = drawn(data, (Term(form("gain")),), np.random.default_rng(2), 5)
    rows = filtered(data, [batch])
    std = np.sqrt(rows.variance)
    low, high = data.visited
    density = student_t.pdf(rows.error / std, batch.freedom[:, None]) / std + 1e-3 / (high - low)
    np.testing.assert_allclose(rows.density(), np.log(density), atol=1e-9)
    np.testing.assert_allclose(rows.total, np.log(density).sum(axis=1), rtol=1e-12)
    np.testing.assert_array_equal(rows.error, errors(data, [batch], "filter")[0][:, data.counted])


def test_hypotheses_do_not_see_each_other(data) -> None:
    """Alone, in batches of one model, or among those of others: the same bytes."""
    rng = np.random.default_rng(4)
    models = [(Term(form(name)),) for name in ("gain", "lag", "gain", "limit", "gain")]
    batches = [drawn(data, model, rng, 3) for model in models]
    together, first = filtered(data, batches), 0
    for batch in batches:
        alone = filtered(data, [batch])
        np.testing.assert_array_equal(together.density()[first : first + len(batch)], alone.density())
        first += len(batch)


@pytest.mark.parametrize("names", [("gain",), ("follow",), ("delay", "spring")])
def test_generated_data_are_a_rollout_of_themselves(data, names) -> None:
    """Row by row by hand: the place that a command leads to, and the mode, are those of the motion itself."""
    model = tuple(Term(form(name)) for name in names)
    batch = drawn(data, model, np.random.default_rng(6), 1)
    made = noiseless_data(data, batch, lambda z: (z > 1.0).astype(np.int64))
    np.testing.assert_array_equal(made.z[:, 0], data.z[:, 0])
    np.testing.assert_allclose(made.place[:, :-1], (made.z + made.u)[:, :-1], atol=1e-12)
    assert np.abs(errors(made, [batch], "rollout")[0]).max() < 1e-12
    assert np.abs(made.z - data.z).max() > 0.01
