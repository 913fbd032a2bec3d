"""Effects in plants that the code under test does not know, and controls without any: what calibration says of them.

    python -m benchmarks unseen_plants [--seeds 2] [--first-seed 0] [--kinds bias ...] [--controls 25] [--list]

A kind is right if every effect of the plant is named (by itself, or as what would do as well), or, where the plant has
something that no effect of the library is, if the verdict is `partly` or `unexplained`. `false` counts the answers that
are `explained` and not right. The roll-out is that of a later recording of the same plant, over whole runs: its root
mean square error with the new model over that with the old one (median over seeds, and the worst). Controls are right
if nothing is found. The kinds are in `unseen_kinds.py`, the plants in `unseen_objects.py`.
"""

from __future__ import annotations

import argparse
import warnings
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np
from unseen_kinds import KINDS, control
from unseen_objects import recorded, scaled

from micah_plan.errors import InputError
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.judgement import judge
from micah_plan.residual.prediction import predict_recording

# A roll-out that is so many times as long as before is longer.
_LONGER = 1.02


@dataclass(frozen=True)
class Answer:
    """What was said of one case: `noise` is what `predict` says, `ratio` the roll-out of another recording."""

    kind: str
    seed: int
    verdict: str
    said: str
    is_right: bool
    noise: bool | None
    ratio: float
    rms: float


def answered(work: tuple[str, int]) -> Answer:
    name, seed = work
    case = control(seed) if name == "control" else KINDS[name](np.random.default_rng([seed, sum(map(ord, name))]))
    case = scaled(case, seed)
    recording, later = recorded(case, seed), recorded(case, seed + 1_000_000, case.hand.runs)
    model = case.thing.model(case.hand.noise)
    label = f"control: {case.kind}" if name == "control" else name
    try:
        noise = judge(model, recording, predict_recording(model, recording)).is_noise
        found = calibrate(model, recording)
        before, after = (rolled(one, later) for one in (model, found.automaton))
    except (InputError, ValueError, FloatingPointError) as problem:
        return Answer(label, seed, "refused", str(problem)[:90], False, None, np.nan, np.nan)
    effects = found.effects
    names = [one.effect.name for one in effects]
    if case.truth:
        said = [{one.effect.name, *one.tied} for one in effects]
        # Where a demonstration saw half of the range, the end of the other half may be told as well.
        most = len(case.truth) + (case.thing.told is not None)
        is_right = all(any(own & one for own in said) for one in case.truth) and len(case.truth) <= len(names) <= most
    else:
        # The end of a half that the model was not told is no false alarm.
        is_end = case.thing.told is not None and bool(names) and set(names) <= {"guard_shift", "limit"}
        is_right = found.verdict == "none" or is_end if case.is_known else found.verdict in ("partly", "unexplained")
    if not case.truth and not case.is_known and noise:
        is_right = False
    modes = [str(mode) for one in found.traces for mode in one.missing_modes]
    parts = [
        one.effect.name + ("" if one.is_added else " (not added)") + "".join(f"/{tied}" for tied in one.tied)
        for one in effects
    ]
    text = " + ".join(parts) or "; ".join(modes) or "nothing"
    return Answer(label, seed, found.verdict, text, is_right, noise, after / before, after)


def rolled(model: object, recording: object) -> float:
    """Root mean square position error of whole roll-outs [m]."""
    runs = predict_recording(model, recording)
    return float(np.sqrt(np.mean(np.concatenate([run.rollout.position.ravel() ** 2 for run in runs])))) + 1e-12


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--kinds", nargs="*", default=list(KINDS))
    parser.add_argument("--controls", type=int, default=25)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--list", action="store_true", help="one line per case")
    asked = parser.parse_args()
    seeds = range(asked.first_seed, asked.first_seed + asked.seeds)
    work = [(name, seed) for name in asked.kinds for seed in seeds]
    work += [("control", seed) for seed in range(asked.first_seed, asked.first_seed + asked.controls)]
    answers = []
    with ProcessPoolExecutor(asked.jobs) as pool:
        for one in pool.map(answered, work):
            answers.append(one)
            if asked.list:
                mark = "ok   " if one.is_right else "FALSE" if one.verdict == "explained" else "wrong"
                told = f"{one.verdict}: {one.said}; noise to predict: {one.noise}; roll-out {one.ratio:.2f}"
                print(f"{mark} {one.kind} #{one.seed}: {told}", flush=True)
    print("| kind | right | said | roll-out after / before | worst |")
    print("| --- " * 5 + "|")
    for kind in dict.fromkeys(one.kind for one in answers if not one.kind.startswith("control")):
        print(row(kind, [one for one in answers if one.kind == kind]))
    controls = [one for one in answers if one.kind.startswith("control")]
    planted = [one for one in answers if one not in controls]
    if controls:
        print(row("controls", controls))
    false = sum(one.verdict == "explained" and not one.is_right for one in planted)
    ratios = [one.ratio for one in planted if np.isfinite(one.ratio)]
    told_noise = sum(one.noise is True and one.verdict != "none" for one in answers)
    right, alarmed = sum(one.is_right for one in planted), sum(not one.is_right for one in controls)
    longer = sum(ratio > _LONGER for ratio in ratios)
    print(f"right {right} of {len(planted)}, explained and not right {false}")
    print(f"roll-out of unseen runs {np.median(ratios):.2f} (median), longer in {longer}")
    print(f"controls alarmed {alarmed} of {len(controls)}; noise to predict, not to calibrate {told_noise}")


def row(kind: str, answers: list[Answer]) -> str:
    verdicts = [one.verdict for one in answers]
    counts = ", ".join(f"{verdicts.count(v)} {v}" for v in dict.fromkeys(verdicts))
    ratios = [one.ratio for one in answers]
    right, ratio, worst = sum(one.is_right for one in answers), np.nanmedian(ratios), np.nanmax(ratios)
    return f"| {kind} | {right}/{len(answers)} | {counts} | {ratio:.2f} | {worst:.2f} |"


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main()
