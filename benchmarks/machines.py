"""Machines that labs have and the other benchmarks lack: limits, hydraulics, encoders, digits, velocity commands.

    python -m benchmarks machines [--seeds 2] [--kinds "speed limit" ...] [--guess]

Each machine is simulated at 2 kHz, read by an encoder and logged at its own rate. Half of the runs are calibrated; of
the others the table has the root mean square error of whole roll-outs [rad or m]: as modelled, calibrated, and of what
a student would fit by least squares (two numbers, ARX(2), and a place with a largest speed and a delay). ``written`` is
the error of the written model on its own recording over what `calibrate` reported for it. What commands mean is said,
unless --guess is given.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from position_control import Run, fitted, model, recording_of, rolled
from scipy.optimize import least_squares

from micah_plan.errors import InputError
from micah_plan.recording.commands import CommandKind, with_commands
from micah_plan.recording.value import Recording
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.prediction import predict_recording, rmse

Floats = NDArray[np.float64]

_TICK_S, _RUNS = 0.0005, 8


@dataclass(frozen=True)
class Machine:
    """What moves a joint, and how it is logged.

    Attributes:
        law: (position, velocity, command, s) -> acceleration, or -> velocity where `is_first_order`.
        rate: rows per second. rows: of a run.
        grid: of the reading [rad or m]. slides: whether the joint is a slide.
        kind: what commands are. late: rows by which they are stored late; negative: early.
        frozen: share of the rows in stretches of ten that repeat the reading before them.
        most: largest velocity [rad/s or m/s].
        delay_s: by how much later a command acts.
    """

    law: Callable[[float, float, float], float]
    rate: float = 50.0
    rows: int = 150
    grid: float = 0.0005
    slides: bool = False
    is_first_order: bool = False
    kind: CommandKind = "position"
    late: int = 0
    frozen: float = 0.0
    most: float = np.inf
    delay_s: float = 0.0

    @property
    def reach(self) -> float:
        """End of the range, which begins at 0 [rad or m]."""
        return 0.4 if self.slides else 1.2


def servo(stiffness: float, damping: float) -> Callable[[float, float, float], float]:
    """A spring and a damper to the goal [1/s^2, 1/s]."""
    return lambda x, v, goal: stiffness * (goal - x) - damping * v


def first_order(rate: float) -> Callable[[float, float, float], float]:
    """A velocity proportional to what is left of the way [1/s]."""
    return lambda x, _, goal: rate * (goal - x)


def limited_torque(stiffness: float, damping: float, most: float) -> Callable[[float, float, float], float]:
    """A spring of limited pull and a damper [1/s^2, 1/s, rad/s^2]."""
    return lambda x, v, goal: float(np.clip(stiffness * (goal - x), -most, most)) - damping * v


def profile(most: float, acceleration: float) -> Callable[[float, float, float], float]:
    """Speeds up and brakes evenly, to a stop at the goal [rad/s, rad/s^2]."""

    def law(x: float, v: float, goal: float) -> float:
        wanted = np.sign(goal - x) * min(np.sqrt(2.0 * acceleration * abs(goal - x)), most)
        return float(np.clip((wanted - v) / _TICK_S, -acceleration, acceleration))

    return law


def ramped(x: float, v: float, command: float) -> float:
    """A motor that gets to the commanded velocity by 1.5 rad/s² at most."""
    del x
    return float(np.clip((command - v) / _TICK_S, -1.5, 1.5))


def slow(x: float, v: float, command: float) -> float:
    """Nine tenths of the commanded velocity."""
    del x, v
    return 0.9 * command


def slow_one_way(x: float, v: float, command: float) -> float:
    """The commanded velocity, less of it downwards."""
    del x, v
    return (0.7 if command < 0.0 else 1.0) * command


def beyond(command: float, dead: float) -> float:
    """What a command has beyond a dead zone."""
    return float(np.sign(command)) * max(abs(command) - dead, 0.0)


def valve(gain: float, lag_s: float, neutral: float, dead: float) -> Callable[[float, float, float], float]:
    """A hydraulic cylinder: the flow follows the command beyond a dead zone about a neutral that is off, with a lag."""

    def law(x: float, v: float, command: float) -> float:
        del x
        return (gain * beyond(command - neutral, dead) - v) / lag_s

    return law


def curved_valve(x: float, v: float, command: float) -> float:
    """A cylinder whose flow is small for small commands beyond a dead zone."""
    del x
    left = beyond(command, 0.02)
    return (left * (0.4 + 4.0 * abs(left)) - v) / 0.1


def saturated(x: float, v: float, command: float) -> float:
    """A pump that has no more to give."""
    del x
    return (float(np.clip(beyond(command, 0.02), -0.12, 0.12)) - v) / 0.08


def rooted(x: float, v: float, command: float) -> float:
    """A valve whose flow grows like a root."""
    del x
    left = beyond(command, 0.02)
    return (float(np.sign(left) * np.sqrt(0.15 * abs(left))) - v) / 0.08


def one_way_slower(x: float, v: float, command: float) -> float:
    """A cylinder with a rod on one side, and a neutral that is off."""
    del x
    left = beyond(command - 0.01, 0.03)
    return ((1.0 if left > 0.0 else 0.6) * left - v) / 0.1


def leaking(x: float, v: float, command: float) -> float:
    """A cylinder that sinks, whatever is commanded."""
    del x
    return (beyond(command, 0.02) - 0.006 - v) / 0.1


def _bits(number: int) -> float:
    """Grid of an encoder of so many bits a turn [rad]."""
    return 2.0 * np.pi / 2**number


KINDS: dict[str, Machine] = {
    "speed limit": Machine(first_order(12.0), 10.0, is_first_order=True, most=0.9),
    "speed limit, 100 Hz": Machine(first_order(12.0), 100.0, is_first_order=True, most=0.9),
    "speed limit, late, 20 Hz": Machine(first_order(400.0), 20.0, is_first_order=True, most=1.2, delay_s=0.09),
    "speed limit, late, 60 Hz": Machine(first_order(400.0), 60.0, is_first_order=True, most=1.2, delay_s=0.09),
    "second order, speed limit": Machine(servo(150.0, 24.0), 30.0, most=0.9, delay_s=0.05),
    "limited torque": Machine(limited_torque(120.0, 14.0, 6.0)),
    "profile of speeds, 20 Hz": Machine(profile(0.7, 2.0), 20.0),
    "profile of speeds, 50 Hz": Machine(profile(0.8, 3.0)),
    "encoder of 6 bits": Machine(servo(60.0, 12.0), 20.0, grid=_bits(6)),
    "encoder of 8 bits, 10 Hz": Machine(servo(60.0, 12.0), 10.0, grid=_bits(8)),
    "encoder of 12 bits, 200 Hz": Machine(servo(60.0, 9.0), 200.0, 400, grid=_bits(12)),
    "encoder of 16 bits, 1 kHz": Machine(servo(60.0, 9.0), 1000.0, 1000, grid=_bits(16)),
    "digits of 0.1 mm": Machine(servo(80.0, 12.0), grid=1e-4, slides=True),
    "digits of 1 mm": Machine(servo(80.0, 12.0), grid=1e-3, slides=True),
    "digits of 10 mm": Machine(servo(80.0, 12.0), grid=1e-2, slides=True),
    "hydraulics": Machine(valve(1.0, 0.15, 0.0, 0.02), 10.0, slides=True, kind="velocity"),
    "hydraulics, neutral off": Machine(valve(0.8, 0.1, 0.015, 0.03), 10.0, slides=True, kind="velocity"),
    "velocity motor with lag": Machine(valve(1.0, 0.08, 0.0, 0.0), kind="velocity"),
    "velocity motor, slow one way": Machine(slow_one_way, is_first_order=True, kind="velocity"),
    "velocity motor, late": Machine(slow, 20.0, is_first_order=True, kind="velocity", delay_s=0.02),
    "velocity motor, ramped": Machine(ramped, 20.0, kind="velocity"),
    "hydraulics, curved": Machine(curved_valve, 20.0, slides=True, kind="velocity"),
    "hydraulics, saturated": Machine(saturated, 20.0, slides=True, kind="velocity"),
    "hydraulics, like a root": Machine(rooted, 20.0, slides=True, kind="velocity"),
    "hydraulics, one way slower, late": Machine(one_way_slower, 20.0, slides=True, kind="velocity", delay_s=0.13),
    "hydraulics, leaking": Machine(leaking, 20.0, slides=True, kind="velocity"),
    "hydraulics, 100 Hz": Machine(valve(1.0, 0.1, 0.0, 0.03), 100.0, 500, slides=True, kind="velocity"),
    "hydraulics, digits of 2 mm": Machine(valve(1.0, 0.1, 0.0, 0.03), 20.0, slides=True, kind="velocity", grid=0.002),
    "servo, late by 15 rows": Machine(servo(60.0, 12.0), 100.0, 300, delay_s=0.15),
    "goals stored early": Machine(servo(60.0, 12.0), 20.0, late=-1),
    "goals stored late": Machine(servo(60.0, 12.0), 20.0, late=1),
    "frozen tracker": Machine(servo(60.0, 12.0), 20.0, grid=0.002, frozen=0.15),
    "offset and gain of the goal": Machine(lambda x, v, goal: 40.0 * (0.9 * goal + 0.05 - x) - 9.0 * v, 20.0),
}


def simulated(machine: Machine, rng: np.random.Generator) -> Run:
    """One run: readings (T,), and goals [rad or m] or velocities [rad/s or m/s] (T,)."""
    reach, x, v = machine.reach, rng.uniform(0.2, 0.8) * machine.reach, 0.0
    is_velocity, goal, speed = machine.kind == "velocity", x, 0.0
    rest = 0.0 if is_velocity else x
    z, command = np.zeros(machine.rows), np.zeros(machine.rows)
    for row in range(machine.rows):
        z[row] = np.round(x / machine.grid) * machine.grid
        if rng.random() < 1.0 / (1.2 * machine.rate):
            goal = rng.uniform(0.1, 0.9) * reach
            speed = rng.uniform(0.1, 0.8) * reach
        command[row] = np.clip(3.0 * (goal - x), -speed, speed) if is_velocity else goal
        for tick in range(round(1.0 / (machine.rate * _TICK_S))):
            acts = row + math.floor(((tick + 0.5) * _TICK_S - machine.delay_s) * machine.rate)
            told = machine.law(x, v, command[acts] if acts >= 0 else rest)
            v = told if machine.is_first_order else v + _TICK_S * told
            v = float(np.clip(v, -machine.most, machine.most))
            x = float(np.clip(x + _TICK_S * v, 0.0, reach))
    for row in range(1, machine.rows):
        start = (row // 10) * 10
        if machine.frozen and start and np.random.default_rng([start, int(1e6 * z[0])]).random() < machine.frozen:
            z[row] = z[start - 1]
    if machine.late > 0:
        command = np.concatenate([np.repeat(command[:1], machine.late), command[: -machine.late]])
    if machine.late < 0:
        command = np.concatenate([command[-machine.late :], np.repeat(command[-1:], -machine.late)])
    return z, command


def logged(machine: Machine, runs: list[Run], *, is_said: bool) -> Recording:
    """The recording of runs, whose commands may be said to be what they are."""
    is_velocity = machine.kind == "velocity"
    recording = recording_of([(z, z + u / machine.rate) if is_velocity else (z, u) for z, u in runs], *_units(machine))
    if not is_said:
        return recording
    told = replace(recording, action=recording.action * machine.rate) if is_velocity else recording
    return with_commands(told, machine.kind)


def _units(machine: Machine) -> tuple[bool, float]:
    return machine.slides, machine.rate


def as_places(machine: Machine, runs: list[Run]) -> list[Run]:
    """Runs whose commands are places, as the rivals take them: velocities lead on from where the part is told to be."""
    if machine.kind != "velocity":
        return runs
    return [(z, u / machine.rate) for z, u in runs]


def rivals(machine: Machine, train: list[Run], test: list[Run]) -> list[float]:
    """Roll-out errors of two numbers, of ARX(2), and of a place with a largest speed (of places alone)."""
    train, test = as_places(machine, train), as_places(machine, test)
    if machine.kind == "velocity":
        return [_rolled_displacements(_displacements(train, order), test, order) for order in (1, 2)]
    return [*(rolled(fitted(train, order), test, order) for order in (1, 2)), _speed_limited(train, test)]


def _displacements(runs: list[Run], order: int) -> Floats:
    """Least squares of steps by the last commands and, of order 2, by the step before."""
    rows, now = [], []
    for z, u in runs:
        steps = np.diff(z)
        columns = [np.ones(len(steps) - 1), u[1:-1], *([u[:-2], steps[:-1]] if order == 2 else [])]
        rows.append(np.stack(columns, axis=1))
        now.append(steps[1:])
    return np.asarray(np.linalg.lstsq(np.concatenate(rows), np.concatenate(now), rcond=None)[0])


def _rolled_displacements(design: Floats, runs: list[Run], order: int) -> float:
    errors = []
    for z, u in runs:
        c, step = z[1], z[1] - z[0]
        found = [c]
        for k in range(1, len(z) - 1):
            row = [1.0, u[k], *([u[k - 1], step] if order == 2 else [])]
            step = float(design @ row)
            found.append(found[-1] + step)
        errors.append(np.array(found) - z[1:])
    return rmse(errors)


def _speed_limited(train: list[Run], test: list[Run]) -> float:
    """A share of the way to a goal that is late, at most so much in a row; by least squares of roll-outs."""

    def errors(p: Floats, runs: list[Run]) -> Floats:
        found = []
        for z, g in runs:
            late = np.interp(np.arange(len(g)) - abs(p[1]), np.arange(len(g)), g)
            c, path = z[0], [z[0]]
            for k in range(len(z) - 1):
                c += np.clip(p[0] * (late[k] - c), -abs(p[2]), abs(p[2]))
                path.append(c)
            found.append(np.array(path)[1:] - z[1:])
        return np.concatenate(found)

    largest = max(float(np.abs(np.diff(z)).max()) for z, _ in train)
    starts = ([share, late, largest] for share in (0.1, 0.5) for late in (0.3, 1.5))
    best = min((least_squares(errors, start, args=(train,), max_nfev=60) for start in starts), key=lambda fit: fit.cost)
    return float(np.sqrt(np.mean(errors(best.x, test) ** 2)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--kinds", nargs="*", default=list(KINDS))
    parser.add_argument("--guess", action="store_true", help="do not say what commands mean")
    given = parser.parse_args()
    print(
        f"{'machine':33}{'model':>9}{'calibr.':>9}{'two':>9}{'ARX(2)':>9}{'speed':>9}{'/ best':>8}{'written':>9}  found"
    )
    ratios = []
    for kind in given.kinds:
        machine = KINDS[kind]
        for seed in range(given.seeds):
            rng = np.random.default_rng([seed, sum(map(ord, kind))])
            runs = [simulated(machine, rng) for _ in range(_RUNS)]
            train, test = runs[: _RUNS // 2], runs[_RUNS // 2 :]
            told, fresh = (logged(machine, own, is_said=not given.guess) for own in (train, test))
            peers = rivals(machine, train, test)
            try:
                found = calibrate(model(machine.slides), told)
                before, after = (
                    rmse([run.rollout.configuration for run in predict_recording(own, fresh)])
                    for own in (model(machine.slides), found.automaton)
                )
                own = rmse([run.rollout.configuration for run in predict_recording(found.automaton, told)])
                written = own / max(found.written[0].rollout, 1e-12) if found.written else np.nan
                effects = [f"{e.effect.name} {[round(v, 3) for v in e.effect.values]}" for e in found.effects]
                said = f"{found.verdict}: {', '.join(effects)}"
            except InputError as error:
                before, after, written, said = np.nan, np.nan, np.nan, f"refused: {error}"[:90]
            ratios.append(after / min(peers))
            shown = "".join(f"{peer:9.4f}" for peer in [*peers, np.nan][:3])
            print(f"{kind:33}{before:9.4f}{after:9.4f}{shown}{ratios[-1]:8.2f}{written:9.3f}  {said}", flush=True)
    known = np.array(ratios)[np.isfinite(ratios)]
    print(f"at most 1.2 times the best: {np.sum(known <= 1.2)} of {len(ratios)}; median {np.median(known):.2f}")


if __name__ == "__main__":
    main()
