"""Joints under position control in MuJoCo, calibrated from logs of where they were told to go.

    python -m benchmarks position_control [--seeds 2] [--kinds second ...] [--rates 5 20 100]

A motor pulls a hinge or a slide towards goals that jump now and then or move on, and the log has goals (as displacement
from the measured place) and encoder readings at 5, 20 or 100 Hz. Half of the runs are calibrated; of the others the
table has the root mean square error of whole roll-outs [rad or m]: as modelled, calibrated, and of what a student would
fit by least squares: two numbers (a share of the way to the goal, and an offset) and ARX(2), which has two rows of
readings and two of goals. The last columns say what was found.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.joint import prismatic, revolute
from micah_plan.automaton.kinematics import forward
from micah_plan.errors import InputError
from micah_plan.recording.value import Recording
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.prediction import predict_recording, rmse

Floats = NDArray[np.float64]
Run = tuple[Floats, Floats]  # readings (T,) and goals (T,)

_TICK_S = 0.001
_RUNS, _SECONDS, _MOST_ROWS = 8, 30.0, 300


@dataclass(frozen=True)
class Motor:
    """What pulls a joint of unit inertia towards a goal.

    Attributes:
        stiffness [1/s^2], damping [1/s]: of the pull.
        friction: [1/s^2] dry friction of the joint.
        dead: distance from the goal within which nothing pulls [rad or m].
        grid: of the encoder [rad or m].
        late: rows by which goals are stored late.
        slides: whether the joint is a slide.
    """

    stiffness: float
    damping: float
    friction: float = 0.0
    dead: float = 0.0
    grid: float = 0.0005
    late: int = 0
    slides: bool = False


KINDS = {
    "first order": Motor(60.0, 30.0),
    "second order": Motor(40.0, 5.0),
    "second, dead zone": Motor(60.0, 9.0, dead=0.04),
    "second, friction": Motor(60.0, 8.0, friction=1.5),
    "coarse encoder": Motor(50.0, 9.0, grid=0.01),
    "slide, first order": Motor(60.0, 40.0, slides=True),
    "slide, second, dead zone": Motor(80.0, 11.0, dead=0.015, slides=True),
    "slide, goals stored late": Motor(90.0, 25.0, late=1, slides=True),
    "hinge, goals stored late": Motor(40.0, 7.0, late=1),
}


def simulated(motor: Motor, rate: float, rng: np.random.Generator) -> Run:
    """One run at a rate [Hz]: goals jump to a new place, or move on at a constant speed."""
    spec = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="{_TICK_S}" gravity="0 0 0"/><worldbody><body>
        <joint name="j" type="{"slide" if motor.slides else "hinge"}" axis="0 0 1" damping="{motor.damping}"
               frictionloss="{motor.friction}"/>
        <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody>
        <actuator><motor joint="j"/></actuator></mujoco>"""
    )
    data, reach = mujoco.MjData(spec), 0.4 if motor.slides else 1.2
    rows = min(int(_SECONDS * rate), _MOST_ROWS)
    data.qpos[0] = goal = rng.uniform(0.2, 0.8) * reach
    speed = 0.0
    z, g = np.zeros(rows), np.zeros(rows)
    for row in range(rows):
        z[row] = np.round(data.qpos[0] / motor.grid) * motor.grid
        if rng.random() < 1.0 / (1.5 * rate):
            goal, speed = rng.uniform(0.05, 0.95) * reach, 0.0
        elif rng.random() < 1.0 / (2.0 * rate):
            speed = rng.uniform(-0.6, 0.6) * reach
        goal = float(np.clip(goal + speed / rate, 0.02 * reach, 0.98 * reach))
        g[row] = goal
        for _ in range(round(1.0 / (rate * _TICK_S))):
            away = goal - data.qpos[0]
            data.ctrl[0] = motor.stiffness * np.sign(away) * max(abs(away) - motor.dead, 0.0)
            mujoco.mj_step(spec, data)
    if motor.late:
        g = np.concatenate([np.repeat(g[:1], motor.late), g[: -motor.late]])
    return z, g


def model(slides: bool) -> HybridAutomaton:
    """Does as it is told."""
    if slides:
        joint = prismatic((0.0, 1.0, 0.0), (0.0, 0.0, 0.0))
    else:
        joint = revolute((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (0.3, 0.0, 0.0))
    end = 0.4 if slides else 1.2
    segment = Segment(joint, 0, 0, 9, 0.0, end, (0.0, end), 0.001, 0.003, 0.0, 1.0)
    return build_automaton(KinematicGraph((KinematicEdge(BASE, "part", (segment,)),)))


def recording_of(runs: list[Run], slides: bool, rate: float) -> Recording:
    """Poses at the readings, and actions that lead from them to the goals."""
    joint = model(slides).modes[0].joints[0]
    columns: dict[str, list[NDArray[np.float64]]] = {"time": [], "position": [], "action": []}
    for z, goal in runs:
        place = forward(joint, z).translation
        action = forward(joint, goal).translation - place
        action[-1] = np.nan
        for name, values in zip(columns, (np.arange(len(z)) / rate, place, action), strict=True):
            columns[name].append(values)
    run = np.concatenate([np.full(len(z), number) for number, (z, _) in enumerate(runs)])
    return Recording(**{name: np.concatenate(own) for name, own in columns.items()}, run=run, has_run=True)


def rolled(design: NDArray[np.float64], runs: list[Run], order: int) -> float:
    """Error of roll-outs of c+ = design @ (1, c, g[, c before, g before])."""
    errors = []
    for z, g in runs:
        c = list(z[:order])
        for k in range(order - 1, len(z) - 1):
            row = [1.0, *(v for lag in range(order) for v in (c[k - lag], g[k - lag]))]
            c.append(float(np.clip(design @ row, -10.0, 10.0)))
        errors.append(np.array(c)[1:] - z[1:])
    return rmse(errors)


def fitted(runs: list[Run], order: int) -> NDArray[np.float64]:
    """Least squares of one-step errors; of order 1 a share of the way and an offset alone."""
    rows, now = [], []
    for z, g in runs:
        lags = [v[order - 1 - lag : len(z) - 1 - lag] for lag in range(order) for v in (z, g)]
        rows.append(np.stack([np.ones(len(z) - order), *lags], axis=1))
        now.append(z[order:])
    design, target = np.concatenate(rows), np.concatenate(now)
    if order > 1:
        return np.asarray(np.linalg.lstsq(design, target, rcond=None)[0])
    away = np.stack([design[:, 0], design[:, 2] - design[:, 1]], axis=1)
    offset, share = np.linalg.lstsq(away, target - design[:, 1], rcond=None)[0]
    return np.array([offset, 1.0 - share, share])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--kinds", nargs="*", default=list(KINDS))
    parser.add_argument("--rates", nargs="*", type=float, default=[5.0, 20.0, 100.0])
    given = parser.parse_args()
    print(f"{'kind':26}{'Hz':>5}{'model':>9}{'calibr.':>9}{'two':>9}{'ARX(2)':>9}{'/ best':>8}  found")
    ratios = []
    for kind in given.kinds:
        motor = KINDS[kind]
        for rate in given.rates:
            for seed in range(given.seeds):
                rng = np.random.default_rng([seed, sum(map(ord, kind)), round(rate)])
                runs = [simulated(motor, rate, rng) for _ in range(_RUNS)]
                train, test = runs[: _RUNS // 2], runs[_RUNS // 2 :]
                told, fresh = (recording_of(own, motor.slides, rate) for own in (train, test))
                two, arx = (rolled(fitted(train, order), test, order) for order in (1, 2))
                try:
                    found = calibrate(model(motor.slides), told)
                    before, after = (
                        rmse([run.rollout.configuration for run in predict_recording(own, fresh)])
                        for own in (model(motor.slides), found.automaton)
                    )
                    effects = [f"{e.effect.name} {[round(v, 3) for v in e.effect.values]}" for e in found.effects]
                    said = f"{found.verdict}: {', '.join(effects)}"
                except InputError as error:
                    before, after, said = np.nan, np.nan, f"refused: {error}"[:90]
                ratios.append(after / min(two, arx))
                print(f"{kind:26}{rate:5.0f}{before:9.4f}{after:9.4f}{two:9.4f}{arx:9.4f}{ratios[-1]:8.2f}  {said}")
    known = np.array(ratios)[np.isfinite(ratios)]
    good = f"{np.sum(known <= 1.2)} of {len(ratios)}"
    print(f"at most 1.2 times the better of the two: {good}; median {np.median(known):.2f}")


if __name__ == "__main__":
    main()
