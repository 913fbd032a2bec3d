"""Calibration against what people would use instead, on the same logs and splits: roll-outs, one step, and names.

    python -m benchmarks against_learners [--logs joint_1 backlash ...] [--seed 100]

Logs: the real ones of `executions` in ../shared/data with one run (fitted to the first half, judged on the second:
commands of the arm that repeat within a half do not reach over it), and plants of `unseen_plants.py` (fitted to one
recording, judged on another of the same plant). Errors are root mean squares of the configuration over all rows, whole
roll-outs without looking at a measurement.

    gain and bias   c+ = c + k v + b, k and b with the least roll-out error
    ARX             linear in four steps and commands before, least squares
    SINDy           polynomials of degree 3 and |v|, sequentially thresholded least squares (Brunton et al., PNAS 2016)
    boosting        300 trees of depth 3 (scikit-learn's gradient boosting)
    GP              a Gaussian process with one length per input (scikit-learn)
    sysid, told     mujoco.sysid: a servo of second order, its stiffness and damping
    sysid, freed    the same with friction, spring, rest position and armature as well

Of the command, a log says a displacement v = u and a place, v = place - c. Every method is fitted with both, and the
one with the smaller roll-out error over the last quarter of what it may see is taken, fitted again to all of that.
Methods that learn the next c learn c+ - c. Needs `pip install scikit-learn "mujoco[sysid]"`; a method whose
library is missing is left out. SINDy is written out here.
"""

from __future__ import annotations

import argparse
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from measured import DATA, model_of
from scipy.optimize import least_squares
from unseen_kinds import KINDS
from unseen_objects import recorded, scaled

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.tracks import tracks
from micah_plan.recording.read import read_recording
from micah_plan.recording.value import Recording
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.coordinate_data import coordinate_data_of
from micah_plan.residual.prediction import predict_recording

REAL = ("joint_1", "joint_4", "ikea_cabinet", "lab_cabinet")
PLANTED = ("gain, one run", "saturation", "backlash", "delay, two runs", "spring", "magnet half-way")
PLANTED += ("places, second order, late",)
LAGS = 3
_FAR = 1e3

Array = np.ndarray[Any, np.dtype[np.float64]]


@dataclass(frozen=True)
class Run:
    """Measured configurations (T,), displacements (T - 1,) that were commanded, and places (T - 1,) they lead to."""

    z: Array
    u: Array
    place: Array

    def rows(self, first: int, end: int) -> Run:
        steps = slice(first, end - 1)
        return Run(self.z[first:end], self.u[steps], self.place[steps])


def runs_of(automaton: HybridAutomaton, recording: Recording) -> list[Run]:
    (data,) = coordinate_data_of(automaton, tracks(automaton, recording))
    whole = data.whole or data
    found = []
    for k in range(len(whole.z)):
        rows = int(np.flatnonzero(whole.counted[k]).max()) + 1
        found.append(Run(whole.z[k, :rows], whole.u[k, : rows - 1], whole.place[k, : rows - 1]))
    return found


class Method(ABC):
    """What predicts configurations, with (T - 1,) errors: of every one, told from the rows before, and of a roll-out.

    `is_place` says whether v leads to a place or is a displacement.
    """

    def __init__(self, *, is_place: bool) -> None:
        self.is_place = is_place

    @abstractmethod
    def fit(self, runs: list[Run]) -> None: ...

    @abstractmethod
    def one_step(self, run: Run) -> Array: ...

    @abstractmethod
    def rollout(self, run: Run) -> Array: ...

    def _v(self, run: Run, k: int, c: float) -> float:
        return float(run.place[k] - c if self.is_place else run.u[k])


class Stepwise(Method):
    """What predicts c+ - c from (B, 2 + 2 LAGS) rows: v now and before, how c moved before, latest first, then c."""

    @abstractmethod
    def moved(self, x: Array) -> Array: ...

    def _row(self, run: Run, k: int, c: Array) -> Array:
        """Features at row k of configurations c (at least k + 1 of them)."""
        ago = [k - i for i in range(LAGS + 1)]
        commands = [self._v(run, i, c[i]) if i >= 0 else 0.0 for i in ago]
        moves = [c[i] - c[i - 1] if i >= 1 else 0.0 for i in ago[:-1]]
        return np.array([*commands, *moves, c[k]])

    def rows(self, run: Run) -> Array:
        return np.stack([self._row(run, k, run.z) for k in range(len(run.u))])

    def one_step(self, run: Run) -> Array:
        return run.z[:-1] + self.moved(self.rows(run)) - run.z[1:]

    def rollout(self, run: Run) -> Array:
        c = np.full(len(run.z), run.z[0])
        for k in range(len(run.u)):
            c[k + 1] = np.clip(c[k] + self.moved(self._row(run, k, c)[None])[0], -_FAR, _FAR)
        return c[1:] - run.z[1:]


class Regression(Stepwise):
    def fit(self, runs: list[Run]) -> None:
        self.learn(np.concatenate([*map(self.rows, runs)]), np.concatenate([np.diff(run.z) for run in runs]))

    @abstractmethod
    def learn(self, x: Array, y: Array) -> None: ...


class GainBias(Stepwise):
    def fit(self, runs: list[Run]) -> None:
        def missed(numbers: Array) -> Array:
            self._numbers = numbers
            return np.clip(np.concatenate([self.rollout(run) for run in runs]), -_FAR, _FAR)

        fits = [least_squares(missed, [k, 0.0], bounds=([0.0, -1.0], [1.9, 1.0])) for k in (0.05, 0.3, 0.9)]
        self._numbers = min(fits, key=lambda fit: float(fit.cost)).x

    def moved(self, x: Array) -> Array:
        return np.asarray(self._numbers[0] * x[:, 0] + self._numbers[1])


class Arx(Regression):
    def learn(self, x: Array, y: Array) -> None:
        self._beta = np.linalg.lstsq(self._design(x), y, rcond=1e-8)[0]

    def moved(self, x: Array) -> Array:
        return np.asarray(self._design(x) @ self._beta)

    def _design(self, x: Array) -> Array:
        return np.hstack([np.ones((len(x), 1)), x])


class Sindy(Arx):
    """The threshold is the one that predicts the last quarter of the rows best."""

    def learn(self, x: Array, y: Array) -> None:
        design, cut = self._design(x), 3 * len(y) // 4
        self._scale = np.maximum(np.sqrt(np.mean(design**2, axis=0)), 1e-12)
        tried = []
        for threshold in (0.003, 0.01, 0.03, 0.1, 0.3):
            beta = self._sparse(design[:cut], y[:cut], threshold * float(np.std(y)))
            tried.append((float(np.mean((y[cut:] - design[cut:] @ beta) ** 2)), threshold))
        self._beta = self._sparse(design, y, min(tried)[1] * float(np.std(y)))

    def _design(self, x: Array) -> Array:
        v, c, moved = x[:, 0], x[:, -1], x[:, LAGS + 1]
        terms = [v**i * c**j for i in range(4) for j in range(4 - i)]
        return np.stack([*terms, np.abs(v), v * np.abs(v), np.sin(c), np.cos(c), moved], axis=1)

    def _sparse(self, design: Array, y: Array, threshold: float) -> Array:
        scaled_design, kept = design / self._scale, np.ones(design.shape[1], dtype=bool)
        beta = np.zeros(design.shape[1])
        for _ in range(10):
            beta = np.zeros(design.shape[1])
            beta[kept] = np.linalg.lstsq(scaled_design[:, kept], y, rcond=1e-8)[0]
            kept = np.abs(beta) > threshold
            if not kept.any():
                break
        return np.asarray(np.where(kept, beta, 0.0) / self._scale)


class Boosting(Regression):
    def learn(self, x: Array, y: Array) -> None:
        from sklearn.ensemble import GradientBoostingRegressor

        self._model = GradientBoostingRegressor(n_estimators=300, max_depth=3, learning_rate=0.05, random_state=0)
        self._model.fit(x, y)

    def moved(self, x: Array) -> Array:
        return np.asarray(self._model.predict(x))


class Gaussian(Regression):
    def learn(self, x: Array, y: Array) -> None:
        from sklearn.gaussian_process import GaussianProcessRegressor
        from sklearn.gaussian_process.kernels import RBF, ConstantKernel, DotProduct, WhiteKernel

        self._scale = np.maximum(np.std(x, axis=0), 1e-9)
        kernel = ConstantKernel() * RBF(np.ones(x.shape[1])) + DotProduct() + WhiteKernel()
        self._model = GaussianProcessRegressor(kernel, normalize_y=True, random_state=0)
        few = np.unique(np.linspace(0, len(x) - 1, 300).astype(int))
        self._model.fit(x[few] / self._scale, y[few])

    def moved(self, x: Array) -> Array:
        return np.asarray(self._model.predict(x / self._scale))


_SERVO = """<mujoco><compiler autolimits="true"/><option timestep="0.01" gravity="0 0 0" integrator="implicit"/>
<worldbody><body name="part"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
<joint name="c" type="slide" axis="1 0 0" damping="20" stiffness="0" frictionloss="0" armature="0"/></body></worldbody>
<actuator><position name="servo" joint="c" kp="60"/></actuator>
<sensor><jointpos name="position" joint="c"/></sensor></mujoco>"""
_STEP, _STEPS = 0.01, 5  # of the simulation [s], and how many make a row


class Sysid(Method):
    """A servo told a place, or the sum of all displacements. One step begins at rest where the part was measured."""

    names: tuple[str, ...] = ("kp", "damping")

    def fit(self, runs: list[Run]) -> None:
        import mujoco
        from mujoco import sysid

        self._spec = mujoco.MjSpec.from_string(_SERVO)
        params = sysid.ParameterDict()
        bounds = {
            "kp": (60.0, 0.5, 3000.0),
            "damping": (20.0, 0.1, 500.0),
            "frictionloss": (0.1, 0.0, 20.0),
            "stiffness": (0.1, 0.0, 300.0),
            "rest": (0.0, -3.0, 3.0),
            "armature": (0.1, 0.0, 50.0),
        }
        for name in self.names:
            start, low, high = bounds[name]
            params.add(sysid.Parameter(name, start, low, high, modifier=_setter(name)))
        model = self._spec.compile()
        sequences = []
        for number, run in enumerate(runs):
            state = sysid.create_initial_state(model, np.array([run.z[0]]), np.zeros(1), np.zeros(0))
            time = _STEP * np.arange(_STEPS * (len(run.z) - 1) + 1)
            held = np.repeat(self._places(run), _STEPS)
            control = sysid.TimeSeries(time, np.append(held, held[-1])[:, None])
            between = np.interp(time, _STEP * _STEPS * np.arange(len(run.z)), run.z)
            sensed = sysid.TimeSeries.from_names(time[1:], between[1:, None], model)
            sequences.append(sysid.ModelSequences("servo", self._spec, str(number), state, control, sensed))
        with redirect_stdout(StringIO()):
            found, _ = sysid.optimize(
                initial_params=params,
                residual_fn=sysid.build_residual_fn(models_sequences=sequences),
                optimizer="mujoco",
                verbose=False,
            )
        for name in self.names:
            _setter(name)(self._spec, found[name])
        self._model = self._spec.compile()

    def _places(self, run: Run) -> Array:
        return run.place if self.is_place else run.z[0] + np.cumsum(run.u)

    def _simulated(self, start: float, places: Array, speed: float = 0.0) -> Array:
        import mujoco

        data = mujoco.MjData(self._model)
        data.qpos[0], data.qvel[0], found = start, speed, []
        for place in places:
            data.ctrl[0] = place
            mujoco.mj_step(self._model, data, _STEPS)
            found.append(float(data.qpos[0]))
        return np.array(found)

    def rollout(self, run: Run) -> Array:
        return np.clip(self._simulated(float(run.z[0]), self._places(run)), -_FAR, _FAR) - run.z[1:]

    def one_step(self, run: Run) -> Array:
        aims = run.place if self.is_place else run.z[:-1] + run.u
        speed = np.concatenate([[0.0], np.diff(run.z)[:-1]]) / (_STEP * _STEPS)
        ahead = [
            self._simulated(float(c), np.array([aim]), float(v))[0]
            for c, aim, v in zip(run.z, aims, speed, strict=False)
        ]
        return np.array(ahead) - run.z[1:]


class FreedSysid(Sysid):
    names = ("kp", "damping", "frictionloss", "stiffness", "rest", "armature")


def _setter(name: str) -> Callable[[Any, Any], None]:
    def change(spec: Any, parameter: Any) -> None:
        value = float(np.ravel(parameter.value)[0])
        if name == "kp":
            gain, bias = spec.actuator("servo").gainprm.copy(), spec.actuator("servo").biasprm.copy()
            gain[0], bias[1] = value, -value
            spec.actuator("servo").gainprm, spec.actuator("servo").biasprm = gain, bias
        elif name == "rest":
            spec.joint("c").springref = value
        else:
            # Damping and stiffness may be polynomials of the speed and the place.
            before = getattr(spec.joint("c"), name)
            setattr(spec.joint("c"), name, value if np.ndim(before) == 0 else [[value], *[[0.0]] * (len(before) - 1)])

    return change


METHODS: dict[str, type[Method]] = {
    "gain and bias": GainBias,
    "ARX": Arx,
    "SINDy": Sindy,
    "boosting": Boosting,
    "GP": Gaussian,
    "sysid, told": Sysid,
    "sysid, freed": FreedSysid,
}


def rms(errors: list[Array]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


def judged(make: type[Method], seen: list[Run], unseen: list[Run]) -> tuple[float, float]:
    """Root mean squares of one step and roll-out over unseen runs, with the meaning of commands that suits best."""
    last = max(len(seen) // 4, 1)
    if len(seen) > 1:
        early, late = seen[:-last], seen[-last:]
    else:
        rows = len(seen[0].z)
        early, late = [seen[0].rows(0, 3 * rows // 4)], [seen[0].rows(3 * rows // 4, rows)]
    tried = []
    for is_place in (False, True):
        method = make(is_place=is_place)
        method.fit(early)
        tried.append((rms([method.rollout(run) for run in late]), is_place))
    method = make(is_place=min(tried)[1])
    method.fit(seen)
    return rms([method.one_step(run) for run in unseen]), rms([method.rollout(run) for run in unseen])


def log(name: str, seed: int) -> tuple[HybridAutomaton, Recording, Recording]:
    """Model, what may be seen, and what is judged."""
    if name in KINDS:
        case = scaled(KINDS[name](np.random.default_rng([seed, sum(map(ord, name))])), seed)
        return case.thing.model(case.hand.noise), recorded(case, seed), recorded(case, seed + 1_000_000)
    path = next(path for path in (DATA / "executions").rglob("*.csv") if path.stem == name)
    recording = read_recording(Path(path))
    half = len(recording.time) // 2
    return model_of(name, recording), recording.rows(slice(None, half)), recording.rows(slice(half, None))


def calibrated(model: HybridAutomaton, seen: Recording, unseen: Recording) -> tuple[tuple[float, float], str]:
    found = calibrate(model, seen)
    runs = predict_recording(found.automaton, unseen)
    one = rms([run.one_step.configuration.ravel() for run in runs])
    rolled = rms([run.rollout.configuration.ravel() for run in runs])
    names = " + ".join(effect.effect.name for effect in found.effects) or "nothing"
    return (one, rolled), f"{found.verdict}: {names}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", nargs="*", default=[*REAL, *PLANTED])
    parser.add_argument("--seed", type=int, default=100)
    asked = parser.parse_args()
    print("roll-out (one step) [rad or m]")
    print("| log | before | calibrate | " + " | ".join(METHODS) + " | calibrate says |")
    print("| --- " * (len(METHODS) + 4) + "|")
    for name in asked.logs:
        model, seen, unseen = log(name, asked.seed)
        runs = predict_recording(model, unseen)
        before = rms([run.rollout.configuration.ravel() for run in runs])
        own, said = calibrated(model, seen, unseen)
        cells = [f"{before:.2g}", f"{own[1]:.2g} ({own[0]:.2g})"]
        for make in METHODS.values():
            try:
                one, rolled = judged(make, runs_of(model, seen), runs_of(model, unseen))
                cells.append(f"{rolled:.2g} ({one:.2g})")
            except (ImportError, AttributeError):  # without its own dependencies mujoco.sysid is empty
                cells.append("not installed")
            except ValueError:
                cells.append("failed")
        print(f"| {name} | " + " | ".join(cells) + f" | {said} |", flush=True)


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main()
