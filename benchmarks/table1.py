"""The paper's Table I in simulation, the paper's numbers beside ours, and the measured demonstrations.

    python -m benchmarks table1 [--demonstrations 20] [--simulated-only] [--verbose] [--json FILE]
                                [--object microwave] [--handling "no actions"] [--method act-champ] [--epsilon 0.05]

Six cases: a microwave and a drawer; with grasp, with periods of no actions, and without grasp. Every demonstration is
of another object, by another hand, seen by another tracker; `simulated_demonstrations` says how they are made and what
their truth is, `table1_scoring` when a result counts. Learning uses its defaults. Errors are mean ± std over results
whose structure is right; the paper's axis errors are 1 - |cos| of the angle, ours are the angle. "At best" says,
under correct (the paper's measure) and strict (the axis in rad), how many an ideal estimator would be expected to get
and, under structure, in how many demonstrations the data tell which rests are not stops (for CHAMP: the poses do);
in the others a method can be right by convention only.

Measured demonstrations are read from ../shared/data/demonstrations (or $MICAH_DATA/demonstrations) where present;
`--simulated-only` leaves them out.
"""

from __future__ import annotations

import argparse
import os
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from saving import add_json, save_json
from simulated_demonstrations import HANDLINGS, OBJECTS, Demonstration, Handling, Object, demonstration
from table1_scoring import EPSILON, Limits, Score, limits, score

from micah_plan.automaton.graph import Segment
from micah_plan.automaton.joint import radius
from micah_plan.learning.learn import METHODS, Method, learn_graph
from micah_plan.recording.read import read_recording

DATA = Path(os.environ.get("MICAH_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
# Table I of the paper: correct of 20; changepoint error; errors of axis (1 - |cos|), centre [m] and radius [m].
PAPER: dict[tuple[Object, Handling, Method], tuple[int, str, str, str, str]] = {
    ("microwave", "with grasp", "champ"): (20, "0.001 ± 0.001", "0.02 ± 0.01", "0.046 ± 0.024", "0.027 ± 0.024"),
    ("microwave", "with grasp", "act-champ"): (20, "0.001 ± 0.001", "0.03 ± 0.02", "0.066 ± 0.034", "0.013 ± 0.059"),
    ("drawer", "with grasp", "champ"): (20, "", "0.04 ± 0.01", "", ""),
    ("drawer", "with grasp", "act-champ"): (20, "", "0.04 ± 0.01", "", ""),
    ("microwave", "no actions", "champ"): (11, "0.001 ± 0.001", "0.01 ± 0.01", "0.015 ± 0.006", "0.011 ± 0.006"),
    ("microwave", "no actions", "act-champ"): (14, "0.001 ± 0.001", "0.01 ± 0.01", "0.019 ± 0.009", "0.002 ± 0.014"),
    ("drawer", "no actions", "champ"): (4, "", "0.03 ± 0.01", "", ""),
    ("drawer", "no actions", "act-champ"): (12, "", "0.03 ± 0.01", "", ""),
    ("microwave", "without grasp", "champ"): (1, "0.001", "0.42", "0.51", "0.056"),
    ("microwave", "without grasp", "act-champ"): (6, "0.001 ± 0.001", "0.58 ± 0.20", "0.328 ± 0.125", "0.164 ± 0.103"),
    ("drawer", "without grasp", "champ"): (9, "", "0.18 ± 0.01", "", ""),
    ("drawer", "without grasp", "act-champ"): (15, "", "0.14 ± 0.04", "", ""),
}

ROW = "{:<24}{:<10}{:<8}{:>9}{:>8}{:>8}{:>17}{:>11}{:>15}{:>16}{:>16}{:>9}"


@dataclass(frozen=True)
class Trial:
    """One demonstration, learned: its seed, the verdict, what could be known, and the seconds of processor time."""

    seed: int
    score: Score
    limits: Limits
    seconds: float


@dataclass(frozen=True)
class Case:
    """All demonstrations of an object and a way of handling it, with one method."""

    name: Object
    handling: Handling
    method: Method
    trials: tuple[Trial, ...]


def run_case(
    name: Object, handling: Handling, methods: Sequence[Method], count: int, epsilon: float, verbose: bool
) -> list[Case]:
    """Learn the first `count` demonstrations of a case with each method."""
    trials: dict[Method, list[Trial]] = {method: [] for method in methods}
    for seed in range(count):
        truth = demonstration(name, handling, seed)
        best = limits(truth, epsilon, np.random.default_rng(seed))
        for method in methods:
            begin = time.process_time()
            graph = learn_graph(truth.recording, method=method)
            seconds = time.process_time() - begin
            trial = Trial(seed, score(graph.edges[0], truth, epsilon), best, seconds)
            trials[method].append(trial)
            if verbose:
                print(described(trial, truth, method), flush=True)
    return [Case(name, handling, method, tuple(found)) for method, found in trials.items()]


def described(trial: Trial, truth: Demonstration, method: Method) -> str:
    """One trial in a line."""
    found, best = trial.score, trial.limits
    verdict = "strict" if found.strict else "correct" if found.correct else "structure" if found.structure else "wrong"
    told = best.actions_tell if method == "act-champ" else best.poses_tell
    errors = found.errors
    numbers = "" if errors is None else f"axis {errors.axis:.3f} centre {errors.center:.3f} radius {errors.radius:.3f}"
    return (
        f"  {method:10} seed {trial.seed:<3d} {verdict:10} {' > '.join(found.kinds)} at {list(found.changepoints)}, "
        f"truth {list(truth.changepoints)}; {numbers} at best {best.expected_correct:.2f}, {best.expected_strict:.2f}"
        f"{'' if told else ', rests untold'}"
    )


def spread(values: Sequence[float | None], digits: int = 3) -> str:
    """Mean and standard deviation of what is known."""
    numbers = np.array([value for value in values if value is not None])
    return f"{numbers.mean():.{digits}f} ± {numbers.std():.{digits}f}" if len(numbers) else ""


def lines(case: Case) -> list[str]:
    """The paper's line, ours, and the limits."""
    count = len(case.trials)
    right, cp, axis, center, radius = PAPER[case.name, case.handling, case.method]
    scores = [trial.score for trial in case.trials]
    errors = [one.errors for one in scores if one.errors is not None]
    turns = case.name == "microwave"
    title = f"{case.name} {case.handling}"
    tells = sum(t.limits.actions_tell if case.method == "act-champ" else t.limits.poses_tell for t in case.trials)
    ideal = sum(trial.limits.expected_correct for trial in case.trials)
    ideal_strict = sum(trial.limits.expected_strict for trial in case.trials)
    counts = [f"{sum(getattr(one, what) for one in scores)}/{count}" for what in ("structure", "correct", "strict")]
    seconds = float(np.median([trial.seconds for trial in case.trials]))
    ours = ROW.format(
        *("", "", "ours", *counts),
        spread([one.configuration for one in scores]),
        spread([one.rows for one in scores], 1),
        spread([one.axis for one in errors]),
        spread([one.center for one in errors]) if turns else "",
        spread([one.radius for one in errors]) if turns else "",
        f"{seconds:.2f}",
    )
    paper = ROW.format(title, case.method, "paper", "", f"{right}/20", "", cp, "", axis, center, radius, "")
    best = ROW.format("", "", "at best", f"told {tells}", f"{ideal:.1f}", f"{ideal_strict:.1f}", *[""] * 6)
    wrong = Counter(" > ".join(one.kinds) for one in scores if not one.structure)
    note = "; ".join(f"{kinds or 'nothing'} ({times})" for kinds, times in wrong.most_common())
    return [paper, ours, best, *([f"{'':34}instead: {note}"] if note else [])]


def header() -> str:
    names = ("case", "method", "", "structure", "correct", "strict", "changept. [rad]", "[rows]", "axis [rad]")
    return ROW.format(*names, "centre [m]", "radius [m]", "seconds")


def joint_in_words(segment: Segment) -> str:
    """One segment in a few words: its joint and where its axis is."""
    joint = segment.joint
    if joint.kind == "rigid":
        return f"rigid at {joint.fixed_at:.3f}"
    text = f"{joint.kind} axis ({', '.join(f'{v:+.2f}' for v in joint.axis)})"
    return text if joint.kind == "prismatic" else f"{text} radius {radius(joint):.3f} m"


def print_measured(files: list[Path]) -> None:
    """A row per measured demonstration and method."""
    print(f"{'file':<28}{'method':<11}{'kinds':<44}{'changepoints':<16}joints")
    for path in files:
        recording = read_recording(path)
        for method in METHODS:
            if method == "act-champ" and not recording.has_actions:
                continue
            segments = learn_graph(recording, method=method).edges[0].segments
            kinds = " > ".join(segment.joint.kind for segment in segments)
            rows = str([segment.start for segment in segments[1:]])
            joints = "; ".join(map(joint_in_words, segments))
            print(f"{path.stem:<28}{method:<11}{kinds:<44}{rows:<16}{joints}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--demonstrations", type=int, default=20, help="per case")
    parser.add_argument("--object", choices=OBJECTS, action="append", help="only this one")
    parser.add_argument("--handling", choices=HANDLINGS, action="append", help="only this one")
    parser.add_argument("--method", choices=METHODS, action="append", help="only this one")
    parser.add_argument("--simulated-only", action="store_true", help="leave the measured demonstrations out")
    parser.add_argument("--epsilon", type=float, default=EPSILON, help="largest error of what is correct [rad and m]")
    add_json(parser)
    parser.add_argument("--verbose", action="store_true", help="a line per trial")
    options = parser.parse_args()
    cases: list[Case] = []
    if options.demonstrations > 0:
        print(header(), flush=True)
    for handling in options.handling or HANDLINGS if options.demonstrations > 0 else ():
        for name in options.object or OBJECTS:
            methods = options.method or METHODS
            found = run_case(name, handling, methods, options.demonstrations, options.epsilon, options.verbose)
            for case in found:
                print("\n".join(lines(case)), flush=True)
            cases += found
    save_json([asdict(case) for case in cases], options.json)
    files = sorted((DATA / "demonstrations").glob("*.csv"))
    if files and not options.simulated_only:
        print("\nmeasured demonstrations")
        print_measured(files)
    elif not options.simulated_only:
        print(f"\nmeasured demonstrations are not at {DATA}; set MICAH_DATA to where they are")


if __name__ == "__main__":
    main()
