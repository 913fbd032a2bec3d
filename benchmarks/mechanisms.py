"""What each mechanism of `learn` is worth: every answer without it.

    OMP_NUM_THREADS=1 python -m benchmarks mechanisms [--without NAME ...] [--seeds 2] [--first 500] [--json FILE]

Recordings of all kinds (`kinds_catalogue.py`), and the measured tracks and demonstrations in ../shared/data (or
$MICAH_DATA), are learned as they are, and again with one mechanism left out at a time. The table has how many answers
are right, how many of those said with 95 % or more are wrong, the Brier score of what is said, and which recordings are
lost and won. A mechanism that loses nothing here may have a purpose that these recordings do not have: look into the
tests before it goes.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from kinds_catalogue import KINDS, simulated
from kinds_scoring import SURE, judged, kind_of, probability
from measured import DATA
from saving import add_json, save_json

from micah_plan.learning import run
from micah_plan.learning.joints import final_fit
from micah_plan.learning.learn import learn_graph
from micah_plan.learning.segmenting import evidence, noise_fit, parameter_costs, report, segmentation
from micah_plan.recording.read import read_recording

Row = dict[str, Any]
TRACKS: Mapping[str, str | None] = {
    "cabinet_one": "revolute",
    "drawer_one": "prismatic",
    "iros_2010/drawer": "prismatic",
    "iros_2010/left_door": "revolute",
    "kitchen": None,
}
"""Kind of the one joint by folder; None: of any kind."""
DEMONSTRATIONS: Mapping[str, tuple[tuple[str, ...], range | None]] = {
    "microwave_with_grasp": (("revolute", "rigid"), range(80, 85)),
    "drawer_no_grasp": (("prismatic",), None),
    "stapler": (("revolute", "rigid"), range(86, 105)),
}
"""Kinds in their order, and the rows that the stop may be told at: where the motion ends, by eye on the displacement.

The stapler is pressed from row 86 on and creeps, by less than its tracker errs, until it latches at about 102.
"""


@dataclass(frozen=True)
class Mechanism:
    """What is left out.

    Attributes:
        owner, attribute: where it is looked up.
        instead: made of what is there, stands in its place.
    """

    owner: Any
    attribute: str
    instead: Callable[[Any], Any]


def _returns(value: Any) -> Callable[[Any], Any]:
    return lambda _original: lambda *_arguments, **_named: value


def _independent(original: Any) -> Any:
    """Channels without correlation, with tails as they were assumed first."""
    del original
    return lambda scaled, _free: (np.tile(np.eye(scaled.shape[2]), (len(scaled), 1, 1)), np.full(len(scaled), 8.0))


def _without_endings(original: Any) -> Any:
    return lambda density, ending: original(density, np.zeros_like(ending))


def _fit_to_inliers(original: Any) -> Any:
    """All rows that count, whatever the mixture says."""
    return lambda joint, stds, rows, used, _trusting: original(joint, stds, rows, used, True)


MECHANISMS: Mapping[str, Mechanism] = {
    "outliers of the last fit": Mechanism(final_fit, "_fit_to_inliers", _fit_to_inliers),
    "strays": Mechanism(final_fit, "_is_off_unweighted_axis", _returns(False)),
    "hinge or screw by all poses": Mechanism(final_fit, "_hinge_or_screw", _returns(None)),
    "the fast wander": Mechanism(noise_fit, "_FAST_SHARES", lambda _: np.array([0.0])),
    "correlated channels": Mechanism(noise_fit, "correlated", _independent),
    "the coarse noise as a start": Mechanism(
        segmentation, "_from_two_noises", lambda original: lambda *given: original(*given)[:1]
    ),
    "the fine noise as a start": Mechanism(
        segmentation, "_from_two_noises", lambda original: lambda *given: original(*given)[-1:]
    ),
    "rests at once": Mechanism(segmentation, "with_rests", _returns(None)),
    "rivals beside the answer": Mechanism(segmentation, "_with_rivals", lambda _: lambda answer, _settings: answer),
    "rests on the path are cheap": Mechanism(evidence, "held_costs", lambda _: lambda cost, *_others: cost.copy()),
    "joints that move nothing": Mechanism(
        parameter_costs, "_implausible_kind_cost", lambda _: lambda pool, _noise: np.zeros(len(pool.hypotheses.used))
    ),
    "last steps that are cut short": Mechanism(evidence, "segment_sums", _without_endings),
    "rests in the end": Mechanism(
        report,
        "final_rests",
        lambda _: lambda _table, _moves, track, *_others: np.full((1, len(track), len(track)), -1e6),
    ),
    "free motion and paths": Mechanism(run, "assess_joints", _returns(None)),
    "answers beside the answer": Mechanism(
        run, "segment_track", lambda original: lambda *given, **named: replace(original(*given, **named), others=())
    ),
}
"""By what it does."""


def rows_of(seeds: range) -> Iterator[Row]:
    """Every recording: whether its answer is right, how sure it is, and the answer."""
    for kind in KINDS:
        for seed in seeds:
            truth = simulated(kind, seed)
            one = judged(learn_graph(truth.recording), truth)
            yield {"name": f"{kind} {seed}", "right": bool(one.kinds), "sure": float(one.sure), "answer": one.answer}
    for folder, joint in TRACKS.items():
        for path in sorted((DATA / "tracks" / folder).glob("*.csv")):
            kinds, sure, _ = _learned(path, "champ")
            moving = [kind for kind in kinds if kind != "rigid"]
            right = moving == [joint] if joint else len(moving) == 1 and moving[0] not in ("none", "path")
            yield {"name": f"{folder}/{path.stem}", "right": right, "sure": sure, "answer": " ".join(kinds)}
    for name, (expected, at) in DEMONSTRATIONS.items():
        path = DATA / "demonstrations" / f"{name}.csv"
        for method in ("champ", "act-champ") if path.is_file() else ():
            kinds, sure, starts = _learned(path, method)
            right = kinds == list(expected) and (at is None or starts[0] in at)
            yield {"name": f"{name} {method}", "right": right, "sure": sure, "answer": " ".join(kinds)}


def _learned(path: Path, method: Any) -> tuple[list[str], float, tuple[int, ...]]:
    """Kinds of the segments, the lowest of their probabilities, and where they begin."""
    edge = learn_graph(read_recording(path), method=method).edges[0]
    sure = min(probability(segment) for segment in edge.segments)
    return [kind_of(segment) for segment in edge.segments], sure, edge.changepoints


def line(name: str, rows: list[Row], before: list[Row]) -> str:
    """A row of the table; before: with everything."""
    surely = [row for row in rows if row["sure"] >= SURE]
    brier = np.mean([(row["sure"] - row["right"]) ** 2 for row in rows])
    was = {row["name"]: row["right"] for row in before}
    lost = [row["name"] for row in rows if was[row["name"]] and not row["right"]]
    won = [row["name"] for row in rows if row["right"] and not was[row["name"]]]
    return (
        f"{name:32} {sum(row['right'] for row in rows):4} of {len(rows)} | surely wrong "
        f"{sum(not row['right'] for row in surely)} of {len(surely)} | Brier {brier:.4f} | "
        f"lost {len(lost)}: {', '.join(lost)} | won {len(won)}: {', '.join(won)}"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--without", nargs="*", choices=list(MECHANISMS), default=list(MECHANISMS), metavar="NAME")
    parser.add_argument("--seeds", type=int, default=2, help="recordings per kind")
    parser.add_argument("--first", type=int, default=500, help="the first of the seeds")
    add_json(parser)
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.seeds)
    everything = list(rows_of(seeds))
    print(line("nothing is left out", everything, everything), flush=True)
    answers = {"nothing": everything}
    for name in options.without:
        left_out = MECHANISMS[name]
        there = getattr(left_out.owner, left_out.attribute)
        with patch.object(left_out.owner, left_out.attribute, left_out.instead(there)):
            answers[name] = list(rows_of(seeds))
        print(line(name, answers[name], everything), flush=True)
    save_json([{"without": name, **row} for name, rows in answers.items() for row in rows], options.json)


if __name__ == "__main__":
    main()
