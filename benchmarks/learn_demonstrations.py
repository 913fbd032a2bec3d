"""What `learn` finds in recorded demonstrations: a row per file and method, over several seeds, with the time taken.

Usage: python -m benchmarks learn_demonstrations [FILE_OR_FOLDER ...] [--seeds N]

Without arguments it reads ../shared/data/demonstrations (or $MICAH_DATA/demonstrations).
"""

from __future__ import annotations

import argparse
import os
import time
from collections import Counter
from pathlib import Path

import numpy as np

from micah_plan.automaton.graph import Segment
from micah_plan.automaton.joint import radius
from micah_plan.learn.learn import METHODS, Method, learn_graph
from micah_plan.recording.read import read_recording
from micah_plan.recording.value import Recording

DATA = Path(os.environ.get("MICAH_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))


def described(segment: Segment) -> str:
    """One segment in a few words: its joint and where its axis is."""
    joint = segment.joint
    if joint.kind == "rigid":
        return f"rigid at {joint.fixed_at:.3f}"
    text = f"{joint.kind} axis ({', '.join(f'{v:+.2f}' for v in joint.axis)})"
    return text if joint.kind == "prismatic" else f"{text} radius {radius(joint):.3f} m"


def trial(recording: Recording, method: Method, seed: int) -> tuple[tuple[Segment, ...], float]:
    """Segments of the first part and the seconds of processor time they took."""
    begin = time.process_time()
    graph = learn_graph(recording, method=method, seed=seed)
    return graph.edges[0].segments, time.process_time() - begin


def table(files: list[Path], seeds: int) -> None:
    print(f"{'file':<28}{'method':<11}{'kinds (how often)':<44}{'changepoints':<16}{'seconds':<9}first seed")
    for path in files:
        recording = read_recording(path)
        for method in METHODS:
            if method == "act-champ" and not recording.has_actions:
                continue
            results = [trial(recording, method, seed) for seed in range(seeds)]
            kinds = Counter(" > ".join(s.joint.kind for s in segments) for segments, _ in results)
            rows = Counter(tuple(s.start for s in segments[1:]) for segments, _ in results)
            found = ", ".join(f"{name} ({count}/{seeds})" for name, count in kinds.most_common())
            where = ", ".join(str(list(key)) for key, _ in rows.most_common(2))
            seconds = float(np.median([taken for _, taken in results]))
            joints = "; ".join(described(segment) for segment in results[0][0])
            print(f"{path.stem:<28}{method:<11}{found:<44}{where:<16}{seconds:<9.2f}{joints}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", nargs="*", type=Path, default=[DATA / "demonstrations"])
    parser.add_argument("--seeds", type=int, default=5)
    options = parser.parse_args()
    files: list[Path] = []
    for path in options.paths:
        files += sorted(path.rglob("*.csv")) if path.is_dir() else [path]
    if not files:
        raise SystemExit(f"no recordings found in {', '.join(str(p) for p in options.paths)}")
    table(files, options.seeds)


if __name__ == "__main__":
    main()
