"""One-step and roll-out prediction of recorded runs by a model, mode changes included."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.arrays import Floats, Ints
from micah_plan.automaton.drawn_thresholds import threshold_stds
from micah_plan.automaton.effects.commanded_places import as_commanded
from micah_plan.automaton.effects.registry import form
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.input_memory import InputChannel, towards
from micah_plan.automaton.kinematics import forward
from micah_plan.automaton.link_motion import link_motions
from micah_plan.automaton.tracks import Track, configurations
from micah_plan.automaton.transition import TransitionBatch
from micah_plan.belief.filter import initial_belief, predict_each, update_each
from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.errors import InputError
from micah_plan.quantities import interval, quantity
from micah_plan.recording.value import Recording
from micah_plan.residual.compared_runs import Place, at_measurements, white_noise_of
from micah_plan.residual.geometry import off_joint_error
from micah_plan.residual.onsets import model_per_run
from micah_plan.residual.range_exceeded import ranges_exceeded, with_extended_range
from micah_plan.summaries import Progress

_Path = tuple[Floats, tuple[str, ...]]
"""(K, n) configurations, and the modes of the K steps."""


@dataclass(frozen=True, eq=False)
class PredictionError:
    """Predicted minus measured over the steps of one run (K steps, l links, n states).

    Attributes:
        offset: (K, l, 3) of the positions [m], in the frame of the predicted part, where a motion keeps its direction.
        turn: (K, l, 3) rotation vectors from the measured to the predicted orientation [rad], likewise; None where
            orientation was not measured.
        configuration: (K, n) difference [rad or m].
        modes: (K,) the mode that the prediction of each step ended in.
        poses: (K, l, 7) predicted, in the frames of the parents: position [m] and quaternion (x, y, z, w).
    """

    offset: Floats
    turn: Floats | None
    configuration: Floats
    modes: tuple[str, ...]
    poses: Floats

    @property
    def position(self) -> Floats:
        """(K, l) distances [m]."""
        return np.asarray(np.linalg.norm(self.offset, axis=2))

    @property
    def rotation(self) -> Floats | None:
        """(K, l) angles [rad]."""
        return None if self.turn is None else np.asarray(np.linalg.norm(self.turn, axis=2))


@dataclass(frozen=True, eq=False)
class RunPrediction:
    """Both predictions of one run, at its measured rows.

    Attributes:
        time: (K + 1,) of its rows since its first [s]; x: (K + 1, n) measured configuration.
        v: (K, n) commanded displacement of each coordinate from each row to the next, in the modes that move it.
        believed: (K + 1, n) the controller's belief minus the measurement, NaN where it was not recorded; None if it
            never was. Effects of sensors are removed, see `tracks`.
        off_joint_error: (K + 1, l, 6) deviation of measured poses from the model's joints, see `geometry`.
        poses: (K + 1, l, 7) measured poses like the predicted ones; without rotation where orientation was not
            measured.
    """

    run: int
    time: Floats
    x: Floats
    v: Floats
    believed: Floats | None
    off_joint_error: Floats
    poses: Floats
    one_step: PredictionError
    rollout: PredictionError


def predict_recording(
    automaton: HybridAutomaton,
    recording: Recording,
    progress: Progress | None = None,
    runs: Collection[int] | None = None,
) -> tuple[RunPrediction, ...]:
    """Predict every run of a recording with at least two rows.

    One step: from the measured pose of a row and its action to the next row, Δ̂_(t+1) = f(f^-1(y_t) + J^-1 a_t) (MICAH,
    equation 2) through guards and resets, in the most likely mode of the belief filter and from within its range.
    Roll-out: from the first measured pose with all actions of the run, without further measurements. Where commands are
    places (`follow`), each is the measured pose plus the action, independent of the roll-out. A run with gaps in its
    times is predicted in consecutive parts, as is one with the onset of an effect (see `compared_runs`), and joints are
    extended where the recording exceeds a range that no mode ends (`range_exceeded`). Predictions continue over rows
    that are not measurements to the next one that is.

    Args:
        automaton: the model.
        recording: with actions.
        progress: called with a message and the fraction done.
        runs: numbers of the runs to predict, as a part of the recording; None: all.

    Raises:
        InputError: if the recording has no actions, parts that the model does not know, no run of two rows, or a run
            that starts where no mode of the model allows.
    """
    if not recording.has_actions:
        raise InputError(
            "expected actions, found no columns ax, ay, az",
            remedy="record the commanded displacements to predict motion",
        )
    automaton = as_commanded(automaton, recording)
    predicted = list[tuple[Place, RunPrediction]]()
    for reaching, every in _usable(automaton, recording):
        parts = [(place, track) for place, track in every if runs is None or track.run in runs]
        made = _predicted(reaching, [track for _, track in parts], progress or (lambda *_: None)) if parts else []
        predicted += zip([place for place, _ in parts], made, strict=True)
    if not predicted:
        raise InputError("expected a run of at least 2 rows, found none", remedy="record a longer run")
    return tuple(run for _, run in sorted(predicted, key=lambda pair: pair[0]))


def refused(automaton: HybridAutomaton, recording: Recording) -> str:
    """Why `predict_recording` refuses a recording with actions: a run starts in no mode; empty if usable."""
    for reaching, parts in _usable(as_commanded(automaton, recording), recording):
        for _, track in parts:
            try:
                first_belief(reaching, track)
            except InputError as error:
                return error.problem
    return ""


def _usable(
    automaton: HybridAutomaton, recording: Recording
) -> list[tuple[HybridAutomaton, list[tuple[Place, Track]]]]:
    """(model of each part of a recording, with its ranges extended as needed; these parts)."""
    return [
        (with_extended_range(model, ranges_exceeded(model, [at_measurements(track).x for _, track in parts])), parts)
        for model, parts in model_per_run(automaton, recording)
    ]


def rmse(errors: list[Floats]) -> float:
    """Root of the mean square over all entries of all arrays; 0 for none."""
    values = np.concatenate([np.ravel(error) for error in errors]) if errors else np.zeros(0)
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0


def rmse_of_coordinates(errors: Sequence[PredictionError]) -> tuple[float, ...]:
    """(n,) root mean square errors of the coordinates, each in its unit."""
    return tuple(np.sqrt(np.mean(np.concatenate([error.configuration for error in errors]) ** 2, axis=0)).tolist())


def estimate_errors(runs: Sequence[RunPrediction]) -> tuple[float, float] | None:
    """(root mean square of estimated minus measured, mean size at the end of each run).

    In the coordinates' unit; None if no run has a recorded belief.
    """
    errors = [run.believed[np.isfinite(run.believed).all(axis=1)] for run in runs if run.believed is not None]
    errors = [error for error in errors if len(error)]
    return (rmse(errors), float(np.mean([np.abs(error[-1]) for error in errors]))) if errors else None


def _predicted(automaton: HybridAutomaton, tracks: Sequence[Track], progress: Progress) -> list[RunPrediction]:
    """Predictions of all runs in parallel, since the overhead is per call."""
    moving = [next((m for m in automaton.modes if m.driven[i]), None) for i in range(automaton.n)]
    rows = [np.zeros(automaton.m) if mode is None else mode.B[i] for i, mode in enumerate(moving)]
    beliefs = [first_belief(automaton, track) for track in tracks]
    ahead = _Ahead(automaton, tracks)
    steps = ahead.one_step(beliefs, lambda share: progress("predict step by step", 0.7 * share))
    rolls = ahead.rollout(beliefs)
    predictions = []
    for number, (track, one_step, rollout) in enumerate(zip(tracks, steps, rolls, strict=True)):
        progress(f"compare part {number + 1} of {len(tracks)}", 0.7 + 0.3 * number / len(tracks))
        measured = at_measurements(track)
        predictions.append(
            RunPrediction(
                run=track.run,
                time=measured.time - track.time[0],
                x=measured.x,
                v=inputs_of(measured) @ np.stack(rows, axis=1),
                believed=None if measured.believed is None else measured.believed - measured.x,
                off_joint_error=np.stack(
                    [off_joint_error(automaton, measured, k) for k in range(len(automaton.links))], axis=1
                ),
                poses=_measured_poses(measured),
                one_step=_error(automaton, measured, *one_step),
                rollout=_error(automaton, measured, *rollout),
            )
        )
    return predictions


class _Ahead:
    """Parallel predictions of R runs of different lengths.

    Attributes:
        x: (R, T + 1, n) measured configurations, origin: where actions were given, u: (R, T, m) inputs; 0 after the end
            of a run. is_measured: (R, T + 1); steps: (R,) of each run.
    """

    def __init__(self, automaton: HybridAutomaton, tracks: Sequence[Track]) -> None:
        self.automaton = automaton
        self.steps = np.array([len(inputs_of(track)) for track in tracks])
        count, most = len(tracks), int(self.steps.max())
        self.x, self.origin = (np.zeros((count, most + 1, automaton.n)) for _ in range(2))
        self.u, self.is_measured = np.zeros((count, most, automaton.m)), np.zeros((count, most + 1), dtype=bool)
        for r, track in enumerate(tracks):
            self.x[r, : len(track.x)], self.origin[r, : len(track.origin)] = track.x, track.origin
            self.u[r, : len(inputs_of(track))] = inputs_of(track)
            self.is_measured[r, : len(track.is_measured)] = track.is_measured
        self.transitions = TransitionBatch(automaton, np.zeros((count, len(threshold_stds(automaton)))))

    def one_step(self, beliefs: Sequence[HybridBelief], progress: Callable[[float], None]) -> list[_Path]:
        """Predict each measured row from the previous one, in the most likely mode of the belief."""
        automaton, channel, held = self.automaton, InputChannel(self.automaton), list(beliefs)
        modes = np.array([belief.most_likely for belief in held])
        x, collected = self.x[:, 0].copy(), _Collected(automaton, len(held))
        for k in range(self.u.shape[1]):
            progress(k / self.u.shape[1])
            is_measured = self.is_measured[:, k] | (k == 0)
            x[is_measured] = self.x[is_measured, k]
            modes[is_measured] = [held[r].most_likely for r in np.flatnonzero(is_measured)]
            passed = channel.pass_on(towards(automaton, self.origin[:, k], x, self.u[:, k]), modes, x)
            modes, x = self._stepped(modes, self._clipped_to_modes(modes, x), passed)
            going = np.flatnonzero(self.steps > k)
            after = predict_each(automaton, [held[r] for r in going], passed[going])
            arrived = self.is_measured[going, k + 1]
            z = np.where(arrived[:, None], self.x[going, k + 1], np.nan)
            for r, belief in zip(going.tolist(), update_each(automaton, after, z), strict=True):
                held[r] = belief
            collected.add(going[arrived], modes, x)
        return collected.runs()

    def rollout(self, beliefs: Sequence[HybridBelief]) -> list[_Path]:
        """Predict each measured row from the first one."""
        automaton, channel = self.automaton, InputChannel(self.automaton)
        modes = np.array([belief.most_likely for belief in beliefs])
        x, collected = self._clipped_to_modes(modes, self.x[:, 0]), _Collected(automaton, len(beliefs))
        for k in range(self.u.shape[1]):
            commanded = channel.pass_on(towards(automaton, self.origin[:, k], x, self.u[:, k]), modes, x)
            modes, x = self._stepped(modes, x, commanded)
            collected.add(np.flatnonzero((self.steps > k) & self.is_measured[:, k + 1]), modes, x)
        return collected.runs()

    def _stepped(self, modes: Ints, x: Floats, u: Floats) -> tuple[Ints, Floats]:
        """(modes (t,), states (t, n)) after one step without noise."""
        return self.transitions.step(modes, x, u, np.zeros_like(x))

    def _clipped_to_modes(self, modes: Ints, x: Floats) -> Floats:
        """Measured configurations (R, n) clipped to the ranges of their modes.

        Beyond an end a step would begin with the end's reset, which stops the part: the whole command would be lost.
        """
        ends = np.array([[mode.interval(i) for i in range(self.automaton.n)] for mode in self.automaton.modes])
        return np.clip(x, ends[modes, :, 0], ends[modes, :, 1])


class _Collected:
    """Predicted configurations and modes of each run."""

    def __init__(self, automaton: HybridAutomaton, count: int) -> None:
        self.automaton = automaton
        self.x: list[list[Floats]] = [[] for _ in range(count)]
        self.modes: list[list[str]] = [[] for _ in range(count)]

    def add(self, chosen: Ints, modes: Ints, x: Floats) -> None:
        """Append one step of some runs."""
        for r in chosen.tolist():
            self.x[r].append(x[r].copy())
            self.modes[r].append(self.automaton.mode_names[modes[r]])

    def runs(self) -> list[_Path]:
        """The collected paths, by run."""
        n = self.automaton.n
        return [(np.reshape(x, (-1, n)), tuple(modes)) for x, modes in zip(self.x, self.modes, strict=True)]


def first_belief(automaton: HybridAutomaton, track: Track) -> HybridBelief:
    """The belief after the first measurement of a run, with the larger of the model's and the run's noise."""
    std, x = np.array(automaton.noise.observation_std), track.x[0]
    stds = np.array([automaton.sensing(mode).std_at(x) for mode in automaton.modes])
    stds = np.maximum(std, np.where(np.isfinite(stds), stds, 0.0))
    for spread in (std, np.maximum(std, white_noise_of(track.x)), stds.max(axis=0)):
        try:
            mode = initial_belief(automaton, x, spread).most_likely
        except InputError:
            continue
        return initial_belief(automaton, x, np.maximum(spread, stds[mode]), automaton.modes[mode].name)
    measured, allowed = [], []
    for index, (coordinate, value) in enumerate(zip(automaton.coordinates, track.x[0], strict=True)):
        ranges = automaton.ranges(index)
        measured.append(f"{coordinate.name} = {quantity(value, coordinate.unit)}")
        allowed.append(
            f"{coordinate.name} " + " or ".join(interval(low, high, coordinate.unit) for low, high in ranges)
        )
    raise InputError(
        f"run {track.run} does not fit the model: it starts at {', '.join(measured)}, the model allows "
        + ", ".join(allowed),
        remedy="take the model that was learned from this object",
    )


def inputs_of(track: Track) -> Floats:
    """(T-1, m) inputs of a run; an InputError if it has none."""
    if track.u is None:  # predict_recording has checked
        raise InputError("expected actions, found none")
    return track.u


def _error(automaton: HybridAutomaton, track: Track, x: Floats, modes: tuple[str, ...]) -> PredictionError:
    offset, poses = (np.zeros((len(x), len(automaton.links), k)) for k in (3, 7))
    turn = None if track.quaternion is None else np.zeros_like(offset)
    shown, of_mode = _as_measured(automaton, track, x), np.array(modes)
    for mode in dict.fromkeys(modes):
        for number, link in enumerate(automaton.links):
            joint, rows = automaton.mode(mode).joints[number], np.flatnonzero(of_mode == mode)
            is_shown = (shown[rows, link.coordinate] != x[rows, link.coordinate]) & (not joint.moves)
            for rows_of_kind, is_path in ((rows[is_shown], True), (rows[~is_shown], False)):
                if not len(rows_of_kind):
                    continue
                c = shown[rows_of_kind, link.coordinate]
                pose = link_motions(automaton)[number].poses(c) if is_path else forward(joint, c)
                frame, measured = pose.rotation.inv(), rows_of_kind + 1
                poses[rows_of_kind, number] = np.hstack([pose.translation, pose.rotation.as_quat()])
                offset[rows_of_kind, number] = frame.apply(pose.translation - track.position[measured, number])
                if turn is not None and track.quaternion is not None:
                    back = Rotation.from_quat(track.quaternion[measured, number]).inv()
                    turn[rows_of_kind, number] = frame.apply((pose.rotation * back).as_rotvec())
    return PredictionError(offset, turn, x - track.x[1:], modes, poses)


def _measured_poses(track: Track) -> Floats:
    """(T, l, 7) positions [m] and quaternions."""
    unturned = np.broadcast_to([0.0, 0.0, 0.0, 1.0], (*track.position.shape[:2], 4))
    return np.concatenate([track.position, unturned if track.quaternion is None else track.quaternion], axis=2)


def trajectory_errors(runs: Sequence[RunPrediction]) -> tuple[float, float] | None:
    """APE and RPE of roll-outs as defined by evo [m], over all runs and parts; None without evo.

    Root mean squares of translations: without alignment, and from one row to the next.
    """
    try:
        from evo.core import metrics
        from evo.core.trajectory import PoseTrajectory3D
    except ImportError:
        return None
    kinds = metrics.APE, partial(metrics.RPE, delta=1, delta_unit=metrics.Unit.frames)
    squares: tuple[list[float], list[float]] = [], []
    for run in runs:
        for number in range(run.poses.shape[1]):
            pair = tuple(
                PoseTrajectory3D(poses[:, :3], np.roll(poses[:, 3:], 1, axis=1), run.time)
                for poses in (run.poses[:, number], np.vstack([run.poses[:1, number], run.rollout.poses[:, number]]))
            )
            for kind, of_kind in zip(kinds, squares, strict=True):
                metric = kind(metrics.PoseRelation.translation_part)
                metric.process_data(pair)
                of_kind += (np.asarray(metric.error) ** 2).tolist()
    absolute, relative = (float(np.sqrt(np.mean(of_kind))) for of_kind in squares)
    return absolute, relative


def _as_measured(automaton: HybridAutomaton, track: Track, x: Floats) -> Floats:
    """(K, n) predicted configurations as read by the sensor that measured the poses."""
    sensors = [effect for effect in automaton.effects if form(effect.name).layer == "sensor"]
    if track.is_outside or not sensors:
        return x
    slope = np.ones(automaton.n)
    for effect in sensors:
        effect_form, i = form(effect.name), automaton.index(effect.coordinate)
        slope[i] *= effect_form.measured(np, 1.0, 0.0, effect.values) - effect_form.measured(
            np, 0.0, 0.0, effect.values
        )
    return np.asarray(configurations(automaton, track.position, track.quaternion)[1:] + slope * (x - track.x[1:]))
