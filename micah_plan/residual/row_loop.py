"""The compiled loop over rows: instructions of a step for many hypotheses, inside a filter.

Numba compiles it on the first call and caches the result next to this file or in the user's cache. The cache is
invalidated by changes of this file only, so the whole loop is here.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple, TypeVar

import numba
import numpy as np

from micah_plan.arrays import Booleans, Floats, Ints
from micah_plan.symbolic.straight_line import Operation

_Function = TypeVar("_Function", bound=Callable[..., Floats | int | None])

FILTER, ONE_STEP, ROLLOUT = range(3)
# Registers that every program has, and where its own begin.
PLACE_OF_PART, MOVED_ON, COMMAND, COMMANDED_PLACE, TIME, ORDER, LOW, HIGH = range(8)
FREE, SLOPE, OFFSET, STEEPNESS, FIRST_OWN = range(8, 13)
# Hypotheses x segments that go through the rows together: the processor's cache holds some hundred registers of each.
_LANES = 256
# Noise and ends of each hypothesis: variances, freedom of the t distribution, ends beside those of
# the rows, commands that leave an end, density of the t distribution of unit scale at 0.
WHITE, PROCESS, MOTION, WANDER, FREEDOM, BESIDE_LOW, BESIDE_HIGH, RELEASE_LOW, RELEASE_HIGH, PEAK = range(10)
# The state of each hypothesis besides its registers, and the values of the row.
_WANDERED, _OF_PLACE, _OF_BOTH, _OF_READING, _ERROR, _VARIANCE = range(6)
_LOW_BEFORE, _HIGH_BEFORE, _AT_LOW, _AT_HIGH, _IS_GONE = range(6, 11)
_READ, _NOISE, _EFFORT, _POWER, _DENSITY, _PRODUCT, _TOTAL, _UNHEARD, _STATES = range(11, 20)
# Values of a delay line: a power of 2, and more than the longest delay has before and after it.
LINE = 32
# Densities of so many rows are multiplied before the logarithm is taken: each is between 1e-12 and 1e12 per rad or m.
_MULTIPLIED = 8


def _compiled(function: _Function) -> _Function:
    """The function compiled by Numba at its first call, with NumPy's results for division by 0."""
    compiled: _Function
    try:
        compiled = numba.njit(cache=True, error_model="numpy")(function)
    except RuntimeError:  # there is no folder that may be written to: it is then compiled in each process
        compiled = numba.njit(error_model="numpy")(function)
    return compiled


class Programs(NamedTuple):
    """Instructions (n, 4) by the time they run.

    Attributes:
        once: for the parameters. begun: memories of what has moved on by `MOVED_ON` to `PLACE_OF_PART`.
        ends: puts `LOW` and `HIGH` of a row in order, its only instruction if no effect changes them.
        step: `COMMAND`, `FREE` and `SLOPE` from `PLACE_OF_PART`, `COMMAND` and `COMMANDED_PLACE`.
        reading: `OFFSET` and `STEEPNESS`.
        registers: how many there are.
        constants: (c, 2) register and value.
        parameters: (k,) registers of them.
        lines: (k, 3) first register of each delay line, its content (0 displacements, 1 places), and the register of
            its delay.
    """

    once: Ints
    begun: Ints
    ends: Ints
    step: Ints
    reading: Ints
    registers: int
    constants: Floats
    parameters: Ints
    lines: Ints


class RowsGiven(NamedTuple):
    """Data of rows (S, T), as in `coordinate_data.CoordinateData`.

    Attributes:
        effort: squared commands, over their usual size. moved: (1, S, T), or (B, S, T) of each hypothesis: commands.
        ends: (2, S, T), or (2, 1, 1) if constant. goes_on: (S,) additional variance of the second row.
        moving: (S,) by how much the part moved on into the first row.
        earlier: (2, S, k) displacements and places that were commanded in the rows before the first, the last first;
            NaN where there are none.
        in_mode: (k, modes) in which modes the k sets of modes are. last: (S,) last row that counts.
        number: (S, T) column of the results in which a row is; -1: in none.
    """

    z: Floats
    moved: Floats
    effort: Floats
    place: Floats
    noise: Floats
    time: Floats
    order: Floats
    mode: Ints
    ends: Floats
    goes_on: Floats
    moving: Floats
    earlier: Floats
    in_mode: Booleans
    last: Ints
    number: Ints


class Settings(NamedTuple):
    """Settings shared by all hypotheses of a batch.

    Attributes:
        kind: `FILTER`, `ONE_STEP` or `ROLLOUT`.
        is_bounded: whether there are ends. is_held: whether something may hold the part there.
        surely: an error that cannot be noise, where `RowsGiven.noise` is 1; unseen: noise of rows without a
            measurement.
        anywhere: density of a row that may lie anywhere in the range.
        stays: correlation of the wandering error. held_variance: share of the variance that an end leaves.
    """

    kind: int
    is_bounded: bool
    is_held: bool
    surely: float
    unseen: float
    anywhere: float
    stays: float
    held_variance: float


@_compiled
def evaluate(code: Ints, r: Floats, in_mode: Booleans, mode: Ints, t: int) -> None:
    """Execute instructions on registers (R, lanes) for rows in modes (lanes,), the t-th of their segments."""
    lanes = r.shape[1]
    for k in range(code.shape[0]):
        operation = code[k, 0]
        o, a, b = r[code[k, 1]], r[code[k, 2]], r[code[k, 3]]
        if operation == Operation.MUL:
            for j in range(lanes):
                o[j] = a[j] * b[j]
        elif operation == Operation.ADD:
            for j in range(lanes):
                o[j] = a[j] + b[j]
        elif operation == Operation.SUB:
            for j in range(lanes):
                o[j] = a[j] - b[j]
        elif operation == Operation.ASSIGN:
            for j in range(lanes):
                o[j] = a[j]
        elif operation == Operation.FMAX:
            for j in range(lanes):
                o[j] = a[j] if a[j] >= b[j] else b[j]
        elif operation == Operation.FMIN:
            for j in range(lanes):
                o[j] = a[j] if a[j] <= b[j] else b[j]
        elif operation == Operation.FABS:
            for j in range(lanes):
                o[j] = abs(a[j])
        elif operation == Operation.NEG:
            for j in range(lanes):
                o[j] = -a[j]
        elif operation == Operation.DIV:
            for j in range(lanes):
                o[j] = a[j] / b[j]
        elif operation == Operation.IF_ELSE_ZERO:
            for j in range(lanes):
                o[j] = b[j] if a[j] != 0.0 else 0.0
        elif operation == Operation.SELECT:
            for j in range(lanes):
                o[j] = b[j] if a[j] != 0.0 else o[j]
        elif operation == Operation.LT:
            for j in range(lanes):
                o[j] = 1.0 if a[j] < b[j] else 0.0
        elif operation == Operation.LE:
            for j in range(lanes):
                o[j] = 1.0 if a[j] <= b[j] else 0.0
        elif operation == Operation.SIGN:
            for j in range(lanes):
                o[j] = 1.0 if a[j] > 0.0 else (-1.0 if a[j] < 0.0 else a[j])
        elif operation == Operation.SQ:
            for j in range(lanes):
                o[j] = a[j] * a[j]
        elif operation == Operation.IN_MODES:
            for j in range(lanes):
                o[j] = 1.0 if in_mode[code[k, 2], mode[j]] else 0.0
        elif operation == Operation.KEEP:
            r[code[k, 1] + t % LINE] = a
        elif operation == Operation.EARLIER:
            _delayed_values(r[code[k, 2] : code[k, 2] + LINE], b, t, o)
        else:
            _evaluate_rare(operation, o, a, b)


@_compiled
def _delayed_values(line: Floats, rows: Floats, t: int, o: Floats) -> None:
    """Values of a delay line (LINE, lanes) at given ages in rows (lanes,)."""
    for j in range(len(o)):
        o[j] = line[(t - int(rows[j])) % LINE, j]


@_compiled
def _evaluate_rare(operation: int, o: Floats, a: Floats, b: Floats) -> None:
    """Execute one of the slow or rare instructions."""
    for j in range(len(o)):
        x, y = a[j], b[j]
        if operation == Operation.EXP:
            o[j] = math.exp(x)
        elif operation == Operation.SIN:
            o[j] = math.sin(x)
        elif operation == Operation.COS:
            o[j] = math.cos(x)
        elif operation == Operation.TANH:
            o[j] = math.tanh(x)
        elif operation == Operation.INV:
            o[j] = 1.0 / x
        elif operation == Operation.SQRT:
            o[j] = np.sqrt(x)
        elif operation == Operation.LOG:
            o[j] = np.log(x)
        elif operation in (Operation.POW, Operation.CONSTPOW):
            o[j] = np.power(x, y)
        elif operation == Operation.AND:
            o[j] = 1.0 if x != 0.0 and y != 0.0 else 0.0
        elif operation == Operation.NOT:
            o[j] = 1.0 if x == 0.0 else 0.0
        elif operation == Operation.TWICE:
            o[j] = x + x
        elif operation == Operation.EQ:
            o[j] = 1.0 if x == y else 0.0
        elif operation == Operation.NE:
            o[j] = 1.0 if x != y else 0.0
        elif operation == Operation.OR:
            o[j] = 1.0 if x != 0.0 or y != 0.0 else 0.0
        elif operation == Operation.TAN:
            o[j] = math.tan(x)
        elif operation == Operation.ASIN:
            o[j] = np.arcsin(x)
        elif operation == Operation.ACOS:
            o[j] = np.arccos(x)
        elif operation == Operation.ATAN:
            o[j] = math.atan(x)
        elif operation == Operation.ATAN2:
            o[j] = math.atan2(x, y)
        elif operation == Operation.FLOOR:
            o[j] = np.floor(x)
        elif operation == Operation.CEIL:
            o[j] = np.ceil(x)
        elif operation == Operation.FMOD:
            o[j] = np.fmod(x, y)
        elif operation == Operation.SINH:
            o[j] = math.sinh(x)
        elif operation == Operation.COSH:
            o[j] = math.cosh(x)


@_compiled
def _load(r: Floats, constants: Floats, parameters: Ints, values: Floats) -> None:
    """Load constants and parameters (k, B) into the registers, repeated for all segments."""
    for k in range(constants.shape[0]):
        r[int(constants[k, 0])] = constants[k, 1]
    for k in range(parameters.shape[0]):
        for j in range(r.shape[1]):
            r[parameters[k], j] = values[k, j % values.shape[1]]
    r[STEEPNESS] = 1.0


@_compiled
def _load_row(rows: RowsGiven, r: Floats, state: Floats, mode: Ints, first: int, hypotheses: int, t: int) -> None:
    """Load a row of each segment; where a segment has ended, its last row."""
    for i in range(r.shape[1] // hypotheses):
        s = first + i
        at = min(t, rows.last[s])
        time, order, place = rows.time[s, at], rows.order[s, at], rows.place[s, at]
        z, noise, effort, of_mode = rows.z[s, at], rows.noise[s, at], rows.effort[s, at], rows.mode[s, at]
        for j in range(i * hypotheses, (i + 1) * hypotheses):
            r[TIME, j], r[ORDER, j], r[COMMANDED_PLACE, j] = time, order, place
            state[_READ, j], state[_NOISE, j], state[_EFFORT, j], mode[j] = z, noise, effort, of_mode
            r[COMMAND, j] = rows.moved[min(j - i * hypotheses, rows.moved.shape[0] - 1), s, at]


@_compiled
def _load_ends(ends: Floats, last: Ints, r: Floats, per_hypothesis: Floats, first: int, t: int) -> None:
    """Load the ends of a row, with each hypothesis' offsets."""
    hypotheses, is_alike = per_hypothesis.shape[1], ends.shape[2] == 1
    for i in range(r.shape[1] // hypotheses):
        s = 0 if is_alike else first + i
        at = 0 if is_alike else min(t, last[s])
        for j in range(hypotheses):
            r[LOW, i * hypotheses + j] = ends[0, s, at] + per_hypothesis[BESIDE_LOW, j]
            r[HIGH, i * hypotheses + j] = ends[1, s, at] + per_hypothesis[BESIDE_HIGH, j]


@_compiled
def _init_at_first_row(r: Floats, state: Floats, per_hypothesis: Floats) -> None:
    """Initialise the state at the measured first row of a segment."""
    for j in range(r.shape[1]):
        low, high, steep = r[LOW, j], r[HIGH, j], r[STEEPNESS, j]
        place = min(max((state[_READ, j] - r[OFFSET, j]) / steep, low), high)
        r[PLACE_OF_PART, j] = place
        state[_WANDERED, j] = state[_OF_BOTH, j] = state[_IS_GONE, j] = 0.0
        state[_OF_PLACE, j] = per_hypothesis[WHITE, j] * state[_NOISE, j] / steep**2
        state[_OF_READING, j] = per_hypothesis[WANDER, j]
        state[_LOW_BEFORE, j], state[_HIGH_BEFORE, j] = low, high
        state[_AT_LOW, j] = 1.0 if place <= low else 0.0
        state[_AT_HIGH, j] = 1.0 if place >= high else 0.0
        state[_PRODUCT, j] = 1.0


@_compiled
def _init_memories(
    programs: Programs, rows: RowsGiven, r: Floats, state: Floats, mode: Ints, hypotheses: int, first: int
) -> None:
    """Initialise memories at the first row, and delay lines with the earlier commands.

    Commands before the start of a run are unknown: the part is assumed at rest, but may move as long as commands are
    delayed.
    """
    for j in range(r.shape[1]):
        r[MOVED_ON, j] = rows.moving[first + j // hypotheses]
    evaluate(programs.begun, r, rows.in_mode, mode, 0)
    for j in range(r.shape[1]):
        segment = first + j // hypotheses
        for k in range(programs.lines.shape[0]):
            known = rows.earlier[programs.lines[k, 1], segment]
            if np.isnan(known[0]):
                state[_UNHEARD, j] = max(state[_UNHEARD, j], r[programs.lines[k, 2], j])
            for ago in range(min(len(known), LINE - 1)):
                if not np.isnan(known[ago]):
                    r[programs.lines[k, 0] + LINE - 1 - ago, j] = known[ago]


@_compiled
def _hold_at_ends(r: Floats, state: Floats, per_hypothesis: Floats) -> None:
    """Hold the part at its lower or upper end until a command releases it or the end disappears."""
    for j in range(r.shape[1]):
        low, high, v = r[LOW, j], r[HIGH, j], r[COMMAND, j]
        free = min(max(r[FREE, j], low), high)
        at_low = state[_AT_LOW, j] != 0.0 and v <= per_hypothesis[RELEASE_LOW, j] and low == state[_LOW_BEFORE, j]
        at_high = state[_AT_HIGH, j] != 0.0 and -v <= per_hypothesis[RELEASE_HIGH, j] and high == state[_HIGH_BEFORE, j]
        state[_LOW_BEFORE, j], state[_HIGH_BEFORE, j] = low, high
        state[_AT_LOW, j] = 1.0 if at_low or free <= low else 0.0
        state[_AT_HIGH, j] = 1.0 if at_high or free >= high else 0.0
        if at_high and per_hypothesis[RELEASE_HIGH, j] > 0.0:
            r[FREE, j], r[SLOPE, j] = high, 0.0
        elif at_low and per_hypothesis[RELEASE_LOW, j] > 0.0:
            r[FREE, j], r[SLOPE, j] = low, 0.0


@_compiled
def _move_part(
    r: Floats, state: Floats, per_hypothesis: Floats, is_bounded: bool, stays: float, held_variance: float
) -> None:
    """Move the part to its free position, clipped at the ends, with its variances."""
    for j in range(r.shape[1]):
        free, slope = r[FREE, j], min(max(r[SLOPE, j], -1.0), 1.0)
        if is_bounded:
            ended = min(max(free, r[LOW, j]), r[HIGH, j])
            slope = slope if ended == free else 0.0
            free = ended
        state[_OF_BOTH, j] *= slope * stays
        of_place = state[_OF_PLACE, j] * (slope * slope * (1.0 - held_variance) + held_variance)
        state[_OF_PLACE, j] = of_place + per_hypothesis[PROCESS, j] + per_hypothesis[MOTION, j] * state[_EFFORT, j]
        state[_OF_READING, j] = state[_OF_READING, j] * stays**2 + (1.0 - stays**2) * per_hypothesis[WANDER, j]
        state[_WANDERED, j] *= stays
        r[PLACE_OF_PART, j] = free


@_compiled
def _inflate_second_row(state: Floats, variance: Floats, first: int, hypotheses: int) -> None:
    """Inflate the variance of the second row of continued segments."""
    for j in range(state.shape[1]):
        state[_OF_PLACE, j] += variance[first + j // hypotheses]


@_compiled
def _compute_innovation(r: Floats, state: Floats, per_hypothesis: Floats) -> None:
    """Compute the innovation of a row and its variance."""
    for j in range(r.shape[1]):
        steep, of_both = r[STEEPNESS, j], state[_OF_BOTH, j]
        state[_ERROR, j] = state[_READ, j] - r[OFFSET, j] - steep * r[PLACE_OF_PART, j] - state[_WANDERED, j]
        to_place, to_reading = steep * state[_OF_PLACE, j] + of_both, steep * of_both + state[_OF_READING, j]
        state[_VARIANCE, j] = steep * to_place + to_reading + per_hypothesis[WHITE, j] * state[_NOISE, j]


@_compiled
def _correct_held_state(r: Floats, state: Floats, per_hypothesis: Floats, surely: float) -> None:
    """Correct the held state of parts measured away from a predicted end, or left behind at one.

    Noise decides whether a part arrived at an end and whether a command just left it. Later measurements correct the
    decision as soon as the error exceeds noise; otherwise one wrong decision would last for many rows.
    """
    for j in range(r.shape[1]):
        state[_IS_GONE, j] = 0.0
        steep, error, noise = r[STEEPNESS, j], state[_ERROR, j], surely * math.sqrt(state[_NOISE, j])
        for k in range(2):
            side, end, release = (1.0, r[LOW, j], per_hypothesis[RELEASE_LOW, j])
            if k == 1:
                side, end, release = (-1.0, r[HIGH, j], per_hypothesis[RELEASE_HIGH, j])
            if release > 0.0:
                is_at = state[_AT_LOW + k, j] != 0.0
                away = side * (r[PLACE_OF_PART, j] + error / steep - end)
                gone = is_at and side * error > min(release * steep, noise)
                caught = not is_at and side * error < -noise and away < noise
                if gone or caught:
                    state[_AT_LOW + k, j], state[_IS_GONE, j] = 1.0 if caught else 0.0, 1.0


@_compiled
def _update_state(r: Floats, state: Floats, per_hypothesis: Floats, is_bounded: bool, t: int) -> None:
    """Kalman update, robust against far measurements.

    In the first steps it also increases the state's variance, as Student's t filter does: the part may still respond to
    commands before the log, as long as commands are delayed.
    """
    for j in range(r.shape[1]):
        steep, error, variance = r[STEEPNESS, j], state[_ERROR, j], state[_VARIANCE, j]
        of_both, is_gone = state[_OF_BOTH, j], state[_IS_GONE, j] != 0.0
        to_place, to_reading = steep * state[_OF_PLACE, j] + of_both, steep * of_both + state[_OF_READING, j]
        freedom = per_hypothesis[FREEDOM, j]
        far = max((error * error / variance + freedom) / (freedom + 1.0), 1.0)
        weight = 1.0 / (far * variance)
        far = far if t <= state[_UNHEARD, j] else 1.0
        place = r[PLACE_OF_PART, j] + to_place * weight * error
        of_place = (state[_OF_PLACE, j] - to_place * weight * to_place) * far
        of_both = (of_both - to_place * weight * to_reading) * far
        state[_WANDERED, j] += to_reading * weight * error
        state[_OF_READING, j] = (state[_OF_READING, j] - to_reading * weight * to_reading) * far
        state[_OF_BOTH, j] = 0.0 if is_gone else of_both
        state[_OF_PLACE, j] = per_hypothesis[WHITE, j] * state[_NOISE, j] / steep**2 if is_gone else of_place
        place = (state[_READ, j] - r[OFFSET, j]) / steep if is_gone else place
        if is_bounded:
            place = min(max(place, r[LOW, j]), r[HIGH, j])
        r[PLACE_OF_PART, j] = place


@_compiled
def _reset_to_measurement(r: Floats, state: Floats, per_hypothesis: Floats, unseen: float) -> None:
    """Reset the state to the measurement, if there is one."""
    for j in range(r.shape[1]):
        if state[_NOISE, j] < unseen:
            r[PLACE_OF_PART, j] += (state[_ERROR, j] + state[_WANDERED, j]) / r[STEEPNESS, j]
            variance = per_hypothesis[WHITE, j] * state[_NOISE, j] + per_hypothesis[WANDER, j]
            state[_OF_PLACE, j] = variance / r[STEEPNESS, j] ** 2


@_compiled
def _compute_density(state: Floats, per_hypothesis: Floats, anywhere: float) -> None:
    """Density of a row: Student's t, with a half-integer power, or uniform over the range."""
    most = 0.0
    for j in range(state.shape[1]):
        most = max(most, per_hypothesis[FREEDOM, j])
        squared = state[_ERROR, j] * state[_ERROR, j]
        state[_POWER, j] = 1.0 + squared / (state[_VARIANCE, j] * per_hypothesis[FREEDOM, j])
        state[_DENSITY, j] = np.sqrt(state[_VARIANCE, j] * state[_POWER, j])
    bit = 1
    while 2 * bit <= most:
        for j in range(state.shape[1]):
            state[_DENSITY, j] *= state[_POWER, j] if (int(per_hypothesis[FREEDOM, j]) // 2) & bit else 1.0
            state[_POWER, j] *= state[_POWER, j]
        bit *= 2
    for j in range(state.shape[1]):
        state[_DENSITY, j] = per_hypothesis[PEAK, j] / state[_DENSITY, j] + anywhere


@_compiled
def _take_logarithm(state: Floats) -> None:
    """Add the logarithm of the accumulated product of densities."""
    for j in range(state.shape[1]):
        state[_TOTAL, j] += math.log(state[_PRODUCT, j])
        state[_PRODUCT, j] = 1.0


@_compiled
def _accumulate_density(number: Ints, state: Floats, hypotheses: int, first: int, t: int) -> None:
    """Accumulate the densities of a row by segment, taking the logarithm occasionally."""
    for i in range(state.shape[1] // hypotheses):
        if number[first + i, t] >= 0:
            for j in range(i * hypotheses, (i + 1) * hypotheses):
                state[_PRODUCT, j] *= state[_DENSITY, j]
    if t % _MULTIPLIED == 0:
        _take_logarithm(state)


@_compiled
def _sum_by_hypothesis(total: Floats, state: Floats) -> None:
    """Accumulate the log densities of all segments per hypothesis."""
    _take_logarithm(state)
    for j in range(state.shape[1]):
        total[j % total.shape[0]] += state[_TOTAL, j]


@_compiled
def _store_error(state: Floats, error: Floats, variance: Floats) -> None:
    """Store error and variance (lanes,) of a row."""
    for j in range(state.shape[1]):
        error[j], variance[j] = state[_ERROR, j], state[_VARIANCE, j]


@_compiled
def _scatter_rows(number: Ints, values: Floats, at: Ints, first: int, into: Floats) -> None:
    """Write values (T, lanes) of all rows of segments into (..., N)."""
    hypotheses = at.shape[0]
    for i in range(values.shape[1] // hypotheses):
        for j in range(hypotheses):
            if at[j] >= 0:
                for t in range(values.shape[0]):
                    n = number[first + i, t]
                    if n >= 0:
                        into[at[j], n] = values[t, i * hypotheses + j]


@_compiled
def _longest_segment(last: Ints, first: int, count: int) -> int:
    """Length of the longest of some segments."""
    longest = 0
    for s in range(first, first + count):
        longest = max(longest, last[s])
    return longest


@_compiled
def _in_all_segments(per_hypothesis: Floats, lanes: int) -> Floats:
    """(k, lanes) values of hypotheses (k, B), repeated for each segment."""
    own = np.empty((per_hypothesis.shape[0], lanes))
    for k in range(per_hypothesis.shape[0]):
        for j in range(lanes):
            own[k, j] = per_hypothesis[k, j % per_hypothesis.shape[1]]
    return own


@_compiled
def run_rows(
    programs: Programs,
    rows: RowsGiven,
    settings: Settings,
    values: Floats,
    per_hypothesis: Floats,
    at: Ints,
    error: Floats,
    variance: Floats,
) -> Floats:
    """Log density (B,) of all rows, if the rows are filtered, and some of their errors and variances (..., N), filled.

    Hypotheses go through the rows side by side, and so do some segments.

    Args:
        values: (k, B) of the parameters. per_hypothesis: (10, B) noise and ends: `WHITE` and so on.
        at: (B,) where each is in the results; -1: its errors are not wanted.
    """
    hypotheses, segments, total = at.shape[0], rows.z.shape[0], np.zeros(at.shape[0])
    together = max(1, min(_LANES // hypotheses, segments))
    for first in range(0, segments, together):
        count = min(together, segments - first)
        lanes, last = count * hypotheses, _longest_segment(rows.last, first, count)
        r, state, mode = np.zeros((programs.registers, lanes)), np.zeros((_STATES, lanes)), np.zeros(lanes, np.int64)
        errors, variances = np.zeros((last + 1, lanes)), np.ones((last + 1, lanes))
        own = _in_all_segments(per_hypothesis, lanes)
        _load(r, programs.constants, programs.parameters, values)
        evaluate(programs.once, r, rows.in_mode, mode, 0)
        _load_row(rows, r, state, mode, first, hypotheses, 0)
        _load_ends(rows.ends, rows.last, r, per_hypothesis, first, 0)
        evaluate(programs.ends, r, rows.in_mode, mode, 0)
        evaluate(programs.reading, r, rows.in_mode, mode, 0)
        _init_at_first_row(r, state, own)
        _init_memories(programs, rows, r, state, mode, hypotheses, first)
        for t in range(last):
            evaluate(programs.step, r, rows.in_mode, mode, t)
            if rows.ends.shape[2] > 1 or programs.ends.shape[0] > 1:
                _load_ends(rows.ends, rows.last, r, per_hypothesis, first, t)
                evaluate(programs.ends, r, rows.in_mode, mode, t)
            if settings.is_held:
                _hold_at_ends(r, state, own)
            _move_part(r, state, own, settings.is_bounded, settings.stays, settings.held_variance)
            if t == 0 and settings.kind == FILTER:
                _inflate_second_row(state, rows.goes_on, first, hypotheses)
            _load_row(rows, r, state, mode, first, hypotheses, t + 1)
            evaluate(programs.reading, r, rows.in_mode, mode, t + 1)
            _compute_innovation(r, state, own)
            _store_error(state, errors[t + 1], variances[t + 1])
            if settings.is_held and settings.kind != ROLLOUT:
                _correct_held_state(r, state, own, settings.surely)
            if settings.kind == FILTER:
                _compute_density(state, own, settings.anywhere)
                _accumulate_density(rows.number, state, hypotheses, first, t + 1)
                _update_state(r, state, own, settings.is_bounded, t)
            elif settings.kind == ONE_STEP:
                _reset_to_measurement(r, state, own, settings.unseen)
        _scatter_rows(rows.number, errors, at, first, error)
        _scatter_rows(rows.number, variances, at, first, variance)
        _sum_by_hypothesis(total, state)
    return total
