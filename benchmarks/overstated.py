"""How much evidence of learning is overstated: the numbers by which stated probabilities are corrected, each varied.

    OMP_NUM_THREADS=1 python -m benchmarks overstated [--numbers NAME ...] [--kinds NAME ...] [--seeds 1] [--first 0]

Joints and noise are fitted to the rows that they are judged by, and no simulated or real error is quite what the model
says, so evidence for one kind over another is too large. `learning/segmenting/posterior.py` divides it by one number,
says how much likelier a stop in the end is than its recursion has it where actions do not tell, and how many of the
parts that leave their joint further than usual are on another mechanism. Here each is varied alone, over recordings
whose truth is known (`kinds_catalogue.py`): mean log scores of what was said of kinds and of numbers of changepoints,
and how many of those said with 95 % or more are wrong. The best value has the best log score; flat scores say that the
number hardly matters.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from types import ModuleType
from unittest.mock import patch

import numpy as np
from kinds_catalogue import KINDS, simulated
from kinds_scoring import SURE, judged
from learning_kinds import learned

from micah_plan.learning.parts import tree
from micah_plan.learning.segmenting import report

NUMBERS: Mapping[str, tuple[tuple[ModuleType, ...], tuple[float, ...]]] = {
    "LOG_ODDS_OVERSTATED": ((report, tree), (1.0, 2.0, 3.0, 4.5, 6.0, 9.0, 14.0)),
    "_ENDS_AT_REST": ((report,), (0.0, 1.4, 2.7, 5.4)),
    "OTHER_MECHANISM": ((report,), (0.0, 0.05, 0.1, 0.2, 0.4)),
}
"""By name: the modules that look it up, and the values that are tried."""
LEAST = 1e-4
"""What was said to be impossible, and is so, counts as one in ten thousand."""


def scored(said: Sequence[tuple[float, bool]]) -> str:
    """Mean log score [nats], and of those said surely how many are wrong, and how many there are."""
    sure, right = np.array([each for each, _ in said]), np.array([is_right for _, is_right in said])
    of_truth = np.where(right, sure, 1.0 - sure)
    surely = sure >= SURE
    score = float(np.mean(np.log(np.maximum(of_truth, LEAST))))
    return f"{score:.3f} | {int(np.sum(surely & ~right))} of {int(surely.sum())}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--numbers", nargs="*", choices=list(NUMBERS), default=list(NUMBERS), metavar="NAME")
    parser.add_argument("--kinds", nargs="*", choices=list(KINDS), default=list(KINDS), metavar="NAME")
    parser.add_argument("--seeds", type=int, default=1, help="recordings per kind")
    parser.add_argument("--first", type=int, default=0, help="the first of the seeds")
    asked = parser.parse_args()
    truths = [simulated(name, asked.first + seed) for name in asked.kinds for seed in range(asked.seeds)]
    print(f"{len(truths)} recordings\n")
    print("| number | value | kinds: log score | sure and wrong | changepoints: log score | sure and wrong |")
    print("| --- | --- | --- | --- | --- | --- |")
    for name in asked.numbers:
        owners, values = NUMBERS[name]
        now = getattr(owners[0], name)
        for value in sorted({*values, now}):
            with ExitStack() as stack:
                for owner in owners:
                    stack.enter_context(patch.object(owner, name, value))
                answers = [judged(learned(truth.recording)[0], truth) for truth in truths]
            kinds = scored([(one.sure, one.kinds) for one in answers])
            counts = scored([(one.count, one.counted) for one in answers if one.count is not None])
            mark = " (now)" if value == now else ""
            print(f"| `{name}` | {value:g}{mark} | {kinds} | {counts} |", flush=True)


if __name__ == "__main__":
    main()
