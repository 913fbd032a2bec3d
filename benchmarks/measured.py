"""Calibration on real motion: errors before and after on held-out rows, and what lies between actions and motion.

    python -m benchmarks measured [DATA]

DATA has the folders `executions` and `demonstrations`; without it ../shared/data (or $MICAH_DATA) is read. Executions
are compared with a joint fitted to their poses alone, demonstrations with the model that is learned from them: there
the effects say what the action column of the recording lacks.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np

from micah_plan.api import stages
from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.joint import prismatic, revolute
from micah_plan.automaton.kinematics import inverse
from micah_plan.learn.joints.final_fit import fit_joint
from micah_plan.learn.settings import LearnSettings
from micah_plan.recording.read import read_recording
from micah_plan.recording.value import Recording
from micah_plan.residual.calibrate import Calibration, FoundEffect, calibrate

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
    time, settings = np.arange(count, dtype=float), LearnSettings(draws=200)
    fitted = fit_joint(guess, place, None, time, np.ones(count), np.random.default_rng(0), settings)
    c = inverse(fitted.joint, place)
    wide = MARGIN * float(np.ptp(c))
    low, high = float(c.min()) - wide, float(c.max()) + wide
    segment = Segment(fitted.joint, 0, 0, count - 1, low, high, (low, high), fitted.position_std, 0.01, 0.0, 1.0)
    return build_automaton(KinematicGraph((KinematicEdge(BASE, "part", (segment,)),)))


def described(found: FoundEffect) -> str:
    values = ", ".join(f"{name} {value:.3g}" for name, value in found.effect.parameters)
    where = f" in {', '.join(found.effect.modes)}" if found.effect.modes else ""
    tied = f" (or {', '.join(found.tied)})" if found.tied else ""
    return f"`{found.effect.name}` {values}{where}{tied}" + ("" if found.is_added else ", not added")


def row(name: str, found: Calibration) -> str:
    sizes = (found.before.one_step, found.after.one_step, found.noise_floor, found.before.rollout, found.after.rollout)
    said = "; ".join(described(one) for one in found.effects) or "nothing with a name"
    modes = "".join(f"; {mode}" for one in found.traces for mode in one.missing_modes)
    sizes += (final_error(found, is_after=False), final_error(found, is_after=True))
    return f"| {name} | {found.verdict} | {said}{modes} | " + " | ".join(f"{size:.2g}" for size in sizes) + " |"


def final_error(found: Calibration, *, is_after: bool) -> float:
    """Mean size of the roll-out's error in the last row of each stretch, held out from the fit [rad or m]."""
    ends = []
    for one in found.traces:
        errors = one.search.errors(one.final if is_after else one.nominal, "rollout")
        last = one.data.counted.shape[1] - 1 - np.argmax(one.data.counted[:, ::-1], axis=1)
        ends.append(np.abs(errors[np.arange(len(last)), last]))
    return float(np.mean(np.concatenate(ends)))


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
        if recording.has_actions and (model := stages.learn(recording).automaton) is not None:
            print(row(path.stem, calibrate(model, recording)), flush=True)


if __name__ == "__main__":
    main()
