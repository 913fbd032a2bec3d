"""Processor time of learning: recordings as a whole, growth with their rows and sweeps, and online per row.

Usage: python -m benchmarks learn_speed [FILE_OR_FOLDER ...] [--most ROWS]

Times are of one process (set OMP_NUM_THREADS=1 for one core), after a first run that is not counted: the median of
five, and the least of them, for a busy machine slows all. A sweep is once there and back. Memory is the peak that
Python's allocations add (tracemalloc, in a run of its own, which is slower). Recordings are those of the arguments, or
of ../shared/data/demonstrations (or $MICAH_DATA/demonstrations); left out where there are none.
"""

from __future__ import annotations

import argparse
import time
import tracemalloc
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
from learn_demonstrations import DATA
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.automaton.joint import revolute
from micah_plan.automaton.kinematics import forward
from micah_plan.learn.learn import learn_graph
from micah_plan.learn.online import OnlineLearner
from micah_plan.learn.run import learn_run
from micah_plan.learn.settings import LearnSettings
from micah_plan.learn.track import part_track
from micah_plan.recording.read import read_recording
from micah_plan.recording.value import Recording

DOOR = revolute((0.0, 0.0, 1.0), (0.2, 0.3, 0.1), (0.6, 0.3, 0.4))
OPEN = 0.9  # rad
POSITION_STD, ROTATION_STD = 0.001, 0.006  # m, rad
RATE = 20.0  # Hz
REPEATS = 5


def measured(c: np.ndarray, seed: int, *, acted: bool) -> Recording:
    """A door at configurations (n,), seen by a tracker; with actions, it is pushed on where it is held."""
    rng = np.random.default_rng(seed)
    poses: RigidTransform = forward(DOOR, c)
    n = len(c)
    action = None
    if acted:
        push = np.append(np.diff(c), 0.0)
        push[np.abs(push) < 1e-9] = float(np.abs(push).max())
        action = forward(DOOR, c + push).translation - poses.translation
    return Recording(
        time=np.arange(n) / RATE,
        position=poses.translation + POSITION_STD * rng.standard_normal((n, 3)),
        quaternion=(Rotation.from_rotvec(ROTATION_STD * rng.standard_normal((n, 3))) * poses.rotation).as_quat(),
        action=action,
    )


def shut(rows: int) -> np.ndarray:
    """A door that moves for two thirds of the rows and is then held."""
    moving = 2 * rows // 3
    return np.concatenate([np.linspace(0, OPEN, moving), np.full(rows - moving, OPEN)])


def swung(rows: int, sweep: int) -> np.ndarray:
    """A door that opens and closes in so many rows, again and again."""
    return OPEN * 0.5 * (1 - np.cos(2 * np.pi * np.arange(rows) / sweep))


def seconds(job: Callable[[], object]) -> tuple[float, float]:
    """Median and least processor time after a first call."""
    job()
    taken = []
    for _ in range(REPEATS):
        begin = time.process_time()
        job()
        taken.append(time.process_time() - begin)
    return float(np.median(taken)), min(taken)


def whole_recordings(paths: list[Path]) -> None:
    print("Whole recordings, learn_graph, all models fitted")
    print(f"{'recording':<44}{'method':<11}{'rows':>6}{'seconds':>9}{'least':>7}")
    files = [file for path in paths for file in (sorted(path.rglob("*.csv")) if path.is_dir() else [path])]
    if not files:
        print(f"(no recordings in {', '.join(map(str, paths))})")
    measured_ones = [(file.stem, read_recording(file)) for file in files]
    cases = [(name, one, ("champ", "act-champ")[: 1 + one.has_actions]) for name, one in measured_ones]
    cases += [
        ("150 rows, poses and actions", measured(shut(150), 1, acted=True), ("champ", "act-champ")),
        ("2400 rows, one motion", measured(shut(2400), 1, acted=False), ("champ",)),
        ("2400 rows, one motion, actions", measured(shut(2400), 1, acted=True), ("act-champ",)),
        ("2400 rows, 4 sweeps", measured(swung(2400, 600), 1, acted=False), ("champ",)),
        ("2400 rows, 12 sweeps", measured(swung(2400, 200), 1, acted=False), ("champ",)),
        ("2400 rows, 48 sweeps", measured(swung(2400, 50), 1, acted=False), ("champ",)),
    ]
    for name, recording, methods in cases:
        for method in methods:
            taken, least = seconds(lambda r=recording, m=method: learn_graph(r, method=m))  # type: ignore[misc]
            print(f"{name:<44}{method:<11}{len(recording):>6}{taken:>9.2f}{least:>7.2f}", flush=True)


def growth_of_exact() -> None:
    """The exponent is that of the time between two lines: 1 is linear."""
    for title, tracks in (
        ("Exact mode, rows of one motion", [(n, shut(n)) for n in (150, 600, 2400, 9600, 38400)]),
        ("Exact mode, sweeps of 60 rows", [(n, swung(60 * n, 60)) for n in (1, 2, 4)]),
    ):
        print(f"\n{title}\n{'size':>8}{'seconds':>9}{'exponent':>9}")
        found = []
        for size, c in tracks:
            track = part_track(measured(c, 1, acted=False), 0, "part")
            job = lambda t=track: learn_run(t, LearnSettings(), np.random.default_rng(0))  # noqa: E731
            found.append((size, seconds(job)[0]))
        exponents = ["", *(f"{np.log(b[1] / a[1]) / np.log(b[0] / a[0]):.2f}" for a, b in pairwise(found))]
        for (size, taken), exponent in zip(found, exponents, strict=True):
            print(f"{size:>8}{taken:>9.2f}{exponent:>9}", flush=True)


def online(most: int) -> None:
    print("\nOnline, a door opened and closed every 100 rows, pushed in chunks of 100 rows")
    print(f"{'rows':>8}{'seconds':>9}{'ms per row':>12}{'ms per row, last half':>23}{'peak MB':>9}{'segments':>10}")
    for rows in (size for size in (1_000, 10_000, 100_000) if size <= most):
        recording = measured(swung(rows, 100), 2, acted=False)
        learner, spent = _pushed(recording)
        tracemalloc.start()
        _pushed(recording)
        peak = tracemalloc.get_traced_memory()[1] / 1e6
        tracemalloc.stop()
        half = float(np.sum(spent[len(spent) // 2 :])) / (rows / 2)
        total = float(np.sum(spent))
        count = len(learner.segments())
        print(
            f"{rows:>8}{total:>9.1f}{1e3 * total / rows:>12.3f}{1e3 * half:>23.3f}{peak:>9.1f}{count:>10}", flush=True
        )


def _pushed(recording: Recording) -> tuple[OnlineLearner, list[float]]:
    """A learner that all rows were pushed to, and the time of every push."""
    learner = OnlineLearner(method="champ")
    spent = []
    for start in range(0, len(recording), 100):
        chunk = slice(start, start + 100)
        begin = time.process_time()
        quaternion = None if recording.quaternion is None else recording.quaternion[chunk]
        learner.push(recording.time[chunk], recording.position[chunk], quaternion)
        spent.append(time.process_time() - begin)
    return learner, spent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", nargs="*", type=Path, default=[DATA / "demonstrations"])
    parser.add_argument("--most", type=int, default=100_000, help="rows of the longest stream")
    options = parser.parse_args()
    whole_recordings(options.paths)
    growth_of_exact()
    online(options.most)


if __name__ == "__main__":
    main()
