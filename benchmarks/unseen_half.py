"""What a calibration on the first half of a log says of the second: full roll-outs, beside two numbers fitted by hand.

    python -m benchmarks unseen_half [FILE.csv ...]

Without files those of `executions` in ../shared/data (or $MICAH_DATA). Of a log with several runs each is left out in
turn: how far it ends beside what the controller believed, and beside its roll-out, before and after.

The model is one joint fitted to the poses of the whole log. The two numbers are those of c+ = c + k (place - c) + b
with the least roll-out error over the first half; place is the point of the joint next to the measured pose plus the
action.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from measured import DATA, described, model_of
from scipy.optimize import least_squares

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.kinematics import inverse
from micah_plan.automaton.tracks import tracks
from micah_plan.recording.read import read_recording
from micah_plan.recording.value import Recording
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.prediction import estimate_errors, predict_recording


def errors_of(automaton: HybridAutomaton, recording: Recording) -> tuple[float, float]:
    """Root mean squares of one step and of the roll-out [rad or m]."""
    (run,) = predict_recording(automaton, recording)
    one, rolled = (float(np.sqrt(np.mean(error.configuration**2))) for error in (run.one_step, run.rollout))
    return one, rolled


def two_numbers(automaton: HybridAutomaton, first: Recording, second: Recording) -> float:
    """Root mean square of the roll-out over the second recording, by k and b that suit the first best."""

    def places(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
        (track,) = tracks(automaton, recording)
        z = track.x[:, 0]
        joint = automaton.moving_joint(0)
        return z, inverse(joint, recording.position[:-1] + recording.action[:-1], near=z[:-1])

    def left(numbers: np.ndarray, z: np.ndarray, place: np.ndarray) -> np.ndarray:
        c, gone = z[0], []
        for to in place:
            c = c + numbers[0] * (to - c) + numbers[1]
            gone.append(c)
        return np.array(gone) - z[1:]

    seen, unseen = places(first), places(second)
    fits = [least_squares(left, [k, 0.0], args=seen, bounds=([0.0, -1.0], [1.9, 1.0])) for k in (0.02, 0.1, 0.5, 0.9)]
    best = min(fits, key=lambda fit: float(fit.cost))
    return float(np.sqrt(np.mean(left(best.x, *unseen) ** 2)))


def left_out(automaton: HybridAutomaton, recording: Recording) -> np.ndarray:
    """(4,) means of final errors [rad or m]: of beliefs before and after, of roll-outs before and after."""
    ends = []
    for run in recording.runs:
        improved = calibrate(automaton, recording.rows(recording.run != run)).automaton
        runs = [predict_recording(model, recording.select(run=run)) for model in (automaton, improved)]
        believed = [(estimate_errors(one) or (0.0, np.nan))[1] for one in runs]
        ends.append([*believed, *(abs(float(one[0].rollout.configuration[-1, 0])) for one in runs)])
    return np.asarray(np.mean(ends, axis=0))


def main() -> None:
    paths = [Path(name) for name in sys.argv[1:]] or sorted((DATA / "executions").rglob("*.csv"))
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
        found = calibrate(automaton, first)
        before, after = (errors_of(model, second) for model in (automaton, found.automaton))
        sizes = (before[0], after[0], before[1], after[1], two_numbers(automaton, first, second))
        said = "; ".join(described(one) for one in found.effects) or "nothing with a name"
        print(f"| {path.stem} | " + " | ".join(f"{size:.2g}" for size in sizes) + f" | {found.verdict} | {said} |")
    print("\n| log, a run left out | belief's final error before | after | roll-out's before | after |")
    print("| --- " * 5 + "|")
    for name, ends in several:
        print(f"| {name} | " + " | ".join(f"{end:.2g}" for end in ends) + " |")


if __name__ == "__main__":
    main()
