"""Calibration on real motion: errors before and after on held-out rows, and of the half of each log that it never saw.

    python -m benchmarks measured [DATA]

DATA has the folders `executions` and `demonstrations`; without it ../shared/data (or $MICAH_DATA) is read. Executions
are compared with a joint fitted to their poses alone, demonstrations with the model that is learned from them: there
the effects say what the action column of the recording lacks.

The second table: calibrated on the first half of each log, rolled out over all of the second, beside two numbers fitted
by hand: those of c+ = c + k (place - c) + b with the least roll-out error over the first half; place is the point of
the joint next to the measured pose plus the action. The third: of a log with several runs each is left out in turn, how
far it ends beside what the controller believed, and beside its roll-out.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from micah_plan.api.learning import learn
from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.joint import prismatic, revolute
from micah_plan.automaton.kinematics import inverse
from micah_plan.automaton.tracks import tracks
from micah_plan.learning.joints.final_fit import fit_joint
from micah_plan.recording.read import read_recording
from micah_plan.recording.value import Recording
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.calibration import Calibration, FoundEffect
from micah_plan.residual.prediction import estimate_errors, predict_recording

DATA = Path(os.environ.get("MICAH_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
# What each folder's recordings are: slides, or hinges with an upright axis.
SLIDES = ("drawer",)
MARGIN = 0.5
"""Share of the visited range that the model's range is wider at both ends: nobody knows where those are."""


def model_of(name: str, recording: Recording) -> HybridAutomaton:
    """One joint fitted to all poses, with a range beyond what was visited."""
    place, count = recording.position, len(recording.time)
    along = place[-1] - place[0]
    middle = place[0] + np.cross((0.0, 0.0, 1.0), along)
    guess = prismatic(along, place[0]) if name in SLIDES else revolute((0.0, 0.0, 1.0), middle, place[0])
    time = np.arange(count, dtype=float)
    fitted = fit_joint(guess, place, None, time, np.ones(count))
    c = inverse(fitted.joint, place)
    wide = MARGIN * float(np.ptp(c))
    low, high = float(c.min()) - wide, float(c.max()) + wide
    segment = Segment(fitted.joint, 0, 0, count - 1, low, high, (low, high), fitted.position_std, 0.01, 0.0, 1.0)
    return build_automaton(KinematicGraph((KinematicEdge(BASE, "part", (segment,)),)))


def described(found: FoundEffect) -> str:
    values = ", ".join(f"{name} {value:.3g}" for name, value, *_ in found.rows)
    where = f" in {', '.join(found.effect.modes)}" if found.effect.modes else ""
    tied = f" (or {', '.join(found.tied)})" if found.tied else ""
    return f"`{found.effect.name}` {values}{where}{tied}" + ("" if found.is_added else ", not added")


def row(name: str, found: Calibration) -> str:
    sizes = (found.before.one_step, found.after.one_step, found.noise_floor, found.before.rollout, found.after.rollout)
    said = "; ".join(described(effect) for effect in found.effects) or "nothing with a name"
    modes = "".join(f"; {mode}" for trace in found.traces for mode in trace.missing_modes)
    sizes += (final_error(found, is_after=False), final_error(found, is_after=True))
    return f"| {name} | {found.verdict} | {said}{modes} | " + " | ".join(f"{size:.2g}" for size in sizes) + " |"


def final_error(found: Calibration, *, is_after: bool) -> float:
    """Mean size of the roll-out's error in the last row of each stretch, held out from the fit [rad or m]."""
    ends = []
    for trace in found.traces:
        errors = trace.held_out.errors(trace.final if is_after else trace.nominal, "rollout")
        last = trace.data.counted.shape[1] - 1 - np.argmax(trace.data.counted[:, ::-1], axis=1)
        ends.append(np.abs(errors[np.arange(len(last)), last]))
    return float(np.mean(np.concatenate(ends)))


def errors_of(automaton: HybridAutomaton, recording: Recording) -> tuple[float, float]:
    """Root mean squares of one step and of the roll-out [rad or m]."""
    (run,) = predict_recording(automaton, recording)
    stepped, rolled = (float(np.sqrt(np.mean(error.configuration**2))) for error in (run.one_step, run.rollout))
    return stepped, rolled


def two_numbers(automaton: HybridAutomaton, first: Recording, second: Recording) -> float:
    """Root mean square of the roll-out over the second recording, by k and b that suit the first best."""

    def places(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
        (track,) = tracks(automaton, recording)
        z = track.x[:, 0]
        joint = automaton.moving_joint(0)
        return z, inverse(joint, recording.position[:-1] + recording.action[:-1], near=z[:-1])

    def misses(numbers: np.ndarray, z: np.ndarray, place: np.ndarray) -> np.ndarray:
        c, gone = z[0], []
        for to in place:
            c = c + numbers[0] * (to - c) + numbers[1]
            gone.append(c)
        return np.array(gone) - z[1:]

    fitted, unseen = places(first), places(second)
    bounds = [0.0, -1.0], [1.9, 1.0]
    fits = [least_squares(misses, [k, 0.0], args=fitted, bounds=bounds) for k in (0.02, 0.1, 0.5, 0.9)]
    best = min(fits, key=lambda fit: float(fit.cost))
    return float(np.sqrt(np.mean(misses(best.x, *unseen) ** 2)))


def left_out(automaton: HybridAutomaton, recording: Recording) -> np.ndarray:
    """(4,) means of final errors [rad or m]: of beliefs before and after, of roll-outs before and after."""
    ends = []
    for run in recording.runs:
        improved = calibrate(automaton, recording.rows(recording.run != run)).automaton
        runs = [predict_recording(model, recording.select(run=run)) for model in (automaton, improved)]
        believed = [(estimate_errors(predictions) or (0.0, np.nan))[1] for predictions in runs]
        ends.append([*believed, *(abs(float(predictions[0].rollout.configuration[-1, 0])) for predictions in runs)])
    return np.asarray(np.mean(ends, axis=0))


def print_halves(paths: list[Path]) -> None:
    """The second and the third table."""
    several: list[tuple[str, np.ndarray]] = []
    print("| log | one step before | after | roll-out before | after | two numbers | verdict | what was found |")
    print("| --- " * 8 + "|")
    for path in paths:
        recording = read_recording(path)
        automaton, half = model_of(path.stem, recording), len(recording.time) // 2
        if len(recording.runs) > 1:
            several.append((path.stem, left_out(automaton, recording)))
            continue
        first, second = recording.rows(slice(None, half)), recording.rows(slice(half, None))
        calibration = calibrate(automaton, first)
        before, after = (errors_of(model, second) for model in (automaton, calibration.automaton))
        sizes = (before[0], after[0], before[1], after[1], two_numbers(automaton, first, second))
        said = "; ".join(described(effect) for effect in calibration.effects) or "nothing with a name"
        errors = " | ".join(f"{size:.2g}" for size in sizes)
        print(f"| {path.stem} | {errors} | {calibration.verdict} | {said} |")
    print("\n| log, a run left out | belief's final error before | after | roll-out's before | after |")
    print("| --- " * 5 + "|")
    for name, ends in several:
        print(f"| {name} | " + " | ".join(f"{end:.2g}" for end in ends) + " |")


def main() -> None:
    data = Path(sys.argv[1]) if len(sys.argv) > 1 else DATA
    head = "recording | verdict | what was found | one step before | after | floor | roll-out before | after"
    print(f"| {head} | final before | after |")
    print("| --- " * 10 + "|")
    for path in sorted((data / "executions").rglob("*.csv")):
        recording = read_recording(path)
        print(row(path.stem, calibrate(model_of(path.stem, recording), recording)), flush=True)
    for path in sorted((data / "demonstrations").glob("*.csv")):
        recording = read_recording(path)
        if recording.has_actions and (model := learn(recording).automaton) is not None:
            print(row(path.stem, calibrate(model, recording)), flush=True)
    print()
    print_halves(sorted((data / "executions").rglob("*.csv")))


if __name__ == "__main__":
    main()
