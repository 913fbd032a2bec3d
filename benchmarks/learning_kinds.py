"""Learning on kinds of motion, not on files: how often it is right, and how often it is right when it says so.

    python -m benchmarks learning_kinds [--kinds NAME ...] [--seeds 20] [--first 0] [--json FILE]
    python -m benchmarks learning_kinds --turned 24 --seeds 2 [--recordings DIR]
    python -m benchmarks learning_kinds --perturbed --seeds 5 [--recordings DIR]

A kind (`kinds_catalogue.py`) is a motion drawn at random by seed: joints, axes, base frames, noise, lengths, hand. The
first table counts, per kind, the recordings whose kinds of joint are right in their order (and whose tree is), those
whose changepoints are also within tolerance (3 rows or 3 %, and the rows that the part needs to leave the noise), the
95 % intervals that hold the truth, and the mean processor time. Then: how often was wrong what was said with a
probability; `sure` is the lowest of the segments of an answer, as `learn` prints it.

`--turned N` learns each recording in N turned base frames and counts those with the answer of the recorded frame (the
same kinds, the same tree), those with the most frequent answer, and of these the ones whose changepoints are within 3
rows or 3 % of their medians. `--perturbed`
counts the recordings that keep their answer if time is mirrored (then the answer is, too), a tenth is cut off at
either end (without the segments that are gone), every second row is left out, or 1 mm of white noise is added; behind
the stroke those that were right as well. With `--recordings` the same is done with all recordings (.csv) below a
folder.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from kinds_catalogue import KINDS, simulated
from kinds_changed import CHANGES, answer_of, turned
from kinds_of_one_part import Simulated
from kinds_scoring import FAMILIES, judged, reliability
from saving import add_json, save_json
from scipy.spatial.transform import Rotation

from micah_plan.automaton.graph import KinematicGraph
from micah_plan.learn.learn import learn_graph
from micah_plan.recording.read import read_recording
from micah_plan.recording.value import Recording

Row = dict[str, Any]


def learned(recording: Recording) -> tuple[KinematicGraph, float]:
    """The graph and the seconds of processor time that it took; a graph without edges where numbers ran out of range.

    That is told, and counts as a wrong answer: one crash must not hide what becomes of all the other recordings.
    """
    begin = process_time()
    try:
        graph = learn_graph(recording)
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        print(f"crashed: {error!r}", file=sys.stderr)
        graph = KinematicGraph(())
    return graph, process_time() - begin


def print_kinds(names: list[str], seeds: range) -> list[Row]:
    """The first table, and how reliable the probabilities are."""
    width = max(map(len, names))
    print(f"{'':{width}}    of kinds  rows | starts | " + " ".join(f"{name:>7}" for name in FAMILIES) + " | CPU s")
    rows: list[Row] = []
    for name in names:
        own: list[Row] = []
        for seed in seeds:
            truth = simulated(name, seed)
            graph, seconds = learned(truth.recording)
            one = judged(graph, truth)
            own.append({"kind": name, "seed": seed, "seconds": seconds, **asdict(one)})
        print(_line(name, own, width), flush=True)
        rows += own
    print(_line("all", rows, width))
    for question, said in _stated(rows).items():
        for line in reliability(question, said):
            print(line)
    return rows


def _line(name: str, rows: list[Row], width: int) -> str:
    starts = [held for row in rows for held in row["starts"]]
    parameters = [held for row in rows for held in row["covered"]]
    families = [[held for family, held in parameters if family == one] for one in FAMILIES]
    held = " ".join(f"{_share(one):>7}" for one in families)
    kinds, changepoints = (sum(row[key] for row in rows) for key in ("kinds", "changepoints"))
    return (
        f"{name:{width}} {len(rows):5} {kinds:5} {changepoints:5} | {_share(starts):>6} | {held} | "
        f"{np.mean([row['seconds'] for row in rows]):5.2f}"
    )


def _share(held: list[bool]) -> str:
    return f"{sum(held)}/{len(held)}" if held else ""


def _stated(rows: list[Row]) -> dict[str, list[tuple[float, bool]]]:
    """What was said with which probability, and whether it was right."""
    counted = [row for row in rows if row["count"] is not None]
    said = {"sure (kinds in their order, tree)": [(row["sure"], row["kinds"]) for row in rows]}
    if counted:
        said["number of changepoints"] = [(row["count"], row["counted"]) for row in counted]
        said["both, multiplied (kinds in their order)"] = [
            (row["sure"] * row["count"], row["kinds"]) for row in counted
        ]
    return said


def sources(
    names: list[str], seeds: range, folder: Path | None
) -> Iterator[tuple[str, list[tuple[Recording, Simulated | None]]]]:
    """Named groups of recordings, with their truth if it is known."""
    for name in names:
        truths = [simulated(name, seed) for seed in seeds]
        yield name, [(one.recording, one) for one in truths]
    for path in sorted(folder.rglob("*.csv")) if folder is not None else []:
        yield str(path.relative_to(folder).with_suffix("")), [(read_recording(path), None)]


def print_turned(names: list[str], seeds: range, folder: Path | None, frames: int) -> list[Row]:
    """The same answer in turned base frames."""
    rotations = Rotation.random(frames, rng=np.random.default_rng(24))
    print(f"{'':32} frames recorded  most   rows   answers in turned frames (times), unless all are as recorded")
    rows: list[Row] = []
    for name, recordings in sources(names, seeds, folder):
        row: Row = {"name": name, "frames": 0, "recorded": 0, "most": 0, "rows": 0, "said": []}
        for recording, _ in recordings:
            as_recorded = answer_of(learned(recording)[0])
            graphs = [learned(turned(recording, one))[0] for one in rotations]
            counts = Counter(answer_of(graph) for graph in graphs)
            most, times = counts.most_common(1)[0]
            row["frames"] += frames
            row["recorded"] += counts[as_recorded]
            row["most"] += times
            row["rows"] += _near([graph for graph in graphs if answer_of(graph) == most], len(recording))
            if counts[as_recorded] < frames:
                row["said"].append("; ".join(f"{_words(answer)} ({n})" for answer, n in counts.most_common()))
        print(_turned_line(row), flush=True)
        rows.append(row)
    total: Row = {key: sum(row[key] for row in rows) for key in ("frames", "recorded", "most", "rows")}
    shares = ", ".join(f"{total[key] / total['frames']:.1%}" for key in ("recorded", "most", "rows"))
    print(_turned_line({"name": "all", **total, "said": [shares]}))
    return rows


def _turned_line(row: Row) -> str:
    counts = f"{row['frames']:6} {row['recorded']:8} {row['most']:5} {row['rows']:6}"
    return f"{row['name']:32} {counts}   {' | '.join(row['said'])}".rstrip()


def _near(graphs: list[KinematicGraph], count: int) -> int:
    """How many of the graphs have all their changepoints near the medians."""
    found = np.array(
        [[row for edge in sorted(g.edges, key=lambda e: e.child) for row in edge.changepoints] for g in graphs]
    )
    missed = np.abs(found - np.median(found, axis=0))
    return int((missed <= max(3.0, 0.03 * count)).all(axis=1).sum())


def _words(answer: tuple[tuple[str, str, int, tuple[str, ...]], ...]) -> str:
    if not answer:
        return "crashed"
    several = len({child for child, *_ in answer}) > 1
    return " / ".join((f"{parent}>{child} " if several else "") + ",".join(kinds) for child, parent, _, kinds in answer)


def print_perturbed(names: list[str], seeds: range, folder: Path | None) -> list[Row]:
    """Who keeps the answer, and who is right, if the recording is changed."""
    print(f"{'':32}   of right " + " ".join(f"{name:>14}" for name in CHANGES))
    rows: list[Row] = []
    for name, recordings in sources(names, seeds, folder):
        row: Row = {"name": name, "of": len(recordings), "known": 0, "right": 0}
        row |= {change: [0, 0] for change in CHANGES}
        for recording, truth in recordings:
            graph = learned(recording)[0]
            right = truth is not None and judged(graph, truth).kinds
            row["right"] += right
            row["known"] += truth is not None
            for change, (changed, expected) in CHANGES.items():
                same = answer_of(learned(changed(recording))[0]) in expected(recording, graph)
                row[change][0] += same
                row[change][1] += same and right
        print(_perturbed_line(row), flush=True)
        rows.append(row)
    for known, name in ((True, "all kinds"), (False, "all recordings")):
        chosen = [row for row in rows if bool(row["known"]) == known]
        if chosen:
            total: Row = {key: sum(row[key] for row in chosen) for key in ("of", "known", "right")}
            total |= {change: np.sum([row[change] for row in chosen], axis=0).tolist() for change in CHANGES}
            print(_perturbed_line({"name": name, **total}))
    return rows


def _perturbed_line(row: Row) -> str:
    cells = [f"{same}/{right}" if row["known"] else f"{same}" for same, right in (row[change] for change in CHANGES)]
    right = row["right"] if row["known"] else ""
    return f"{row['name']:32} {row['of']:4} {right:>5} " + " ".join(f"{cell:>14}" for cell in cells)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--kinds", nargs="*", choices=list(KINDS), default=list(KINDS), metavar="NAME", help=f"of {', '.join(KINDS)}"
    )
    parser.add_argument("--seeds", type=int, default=20, help="recordings per kind")
    parser.add_argument("--first", type=int, default=0, help="the first of the seeds")
    parser.add_argument("--turned", type=int, metavar="FRAMES", help="learn in so many turned base frames")
    parser.add_argument("--perturbed", action="store_true", help="learn from changed recordings")
    parser.add_argument("--recordings", type=Path, metavar="DIR", help="also all .csv below, turned or perturbed")
    add_json(parser)
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.seeds)
    if options.turned:
        rows = print_turned(options.kinds, seeds, options.recordings, options.turned)
    elif options.perturbed:
        rows = print_perturbed(options.kinds, seeds, options.recordings)
    else:
        rows = print_kinds(options.kinds, seeds)
    save_json(rows, options.json)


if __name__ == "__main__":
    main()
