"""Learning on kinds of motion, not on files: how often it is right, and how often it is right when it says so.

    python -m benchmarks learning_kinds [--kinds NAME ...] [--seeds 20] [--first 0] [--json FILE]

A kind (`kinds_catalogue.py`) is a motion drawn at random by seed: joints, axes, base frames, noise, lengths, hand. The
first table counts, per kind, the recordings whose kinds of joint are right in their order (and whose tree is), those
whose changepoints are also within tolerance (3 rows or 3 %, and the rows that the part needs to leave the noise), the
95 % intervals that hold the truth, and the mean processor time. Then: how often was wrong what was said with a
probability; `sure` is the lowest of the segments of an answer, as `learn` prints it.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict
from time import process_time
from typing import Any

import numpy as np
from kinds_catalogue import KINDS, simulated
from kinds_scoring import FAMILIES, judged, reliability
from saving import add_json, save_json

from micah_plan.automaton.graph import KinematicGraph
from micah_plan.learning.learn import learn_graph
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


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--kinds", nargs="*", choices=list(KINDS), default=list(KINDS), metavar="NAME", help=f"of {', '.join(KINDS)}"
    )
    parser.add_argument("--seeds", type=int, default=20, help="recordings per kind")
    parser.add_argument("--first", type=int, default=0, help="the first of the seeds")
    add_json(parser)
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.seeds)
    rows = print_kinds(options.kinds, seeds)
    save_json(rows, options.json)


if __name__ == "__main__":
    main()
