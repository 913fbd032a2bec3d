"""What each gate of `calibrate` decides: every answer without it, where it decided anything.

    python -m benchmarks gates [--first-seed 500] [--kinds bias ...] [--controls 12] [--gates longer ...] [--jobs 1]

Beside the density that ranks models, gates keep something out or give a verdict. First each case of `unseen_plants`,
and of the recordings in ../shared/data (or $MICAH_DATA), is answered with a watch on every gate: did it decide
otherwise than nothing in its place would have? Those cases are answered again with the gate off. A gate is worth its
lines if answers get worse without it: wrong kinds, unseen roll-outs that are longer (by more than 5 %), alarmed
controls. Gates that are constants cannot be watched and are tried on every case.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from measured import DATA, model_of
from unseen_kinds import KINDS
from unseen_plants import Answer, answered, rolled

from micah_plan.recording.read import read_recording
from micah_plan.residual import calibrate, competition, contenders, coordinate_data, responses, trace

Instead = Callable[..., Any]
"""What stands in the place of a gate: given the original and its arguments."""
CHANGED = 1.05
"""Roll-outs that are so many times as long as with the gate count."""


@dataclass(frozen=True)
class Gate:
    """A decision that can be left out.

    Attributes:
        owner, attribute: where it is looked up.
        instead: what is done without it; a function, or the value of a constant.
    """

    owner: Any
    attribute: str
    instead: Instead | float
    reason: str


def _always(value: Any) -> Instead:
    def decision(*arguments: Any, **named: Any) -> Any:
        del arguments, named
        return value

    return decision


def _only_in_sum(original: Instead, gains: Any, by_each: Any = ()) -> bool:
    del original, by_each
    return bool(gains.sum() > 0.0)


def _all_together(original: Instead, gains: Any, by_each: Any = ()) -> Any:
    del by_each
    return original(gains, ())


def _as_they_are(original: Instead, found: Any) -> tuple[Any, tuple[Any, ...]]:
    """The likeliest, whatever is as plain."""
    del original
    best = max(found, key=lambda one: one.evidence)
    return best, (best,)


def _all_clear(original: Instead, *arguments: Any) -> Any:
    return np.zeros_like(original(*arguments))


GATES: dict[str, Gate] = {
    "evidence": Gate(contenders, "_LEAST", 0.0, "an effect adds 6 nats, since two dozen compete"),
    "bounds": Gate(contenders, "_AT_BOUND", -1.0, "a parameter at its bound is something else"),
    "not one run": Gate(contenders, "is_confirmed", _only_in_sum, "held-out runs agree, without the best of them"),
    "each effect": Gate(contenders, "is_confirmed", _all_together, "held-out runs agree on each effect"),
    "regular": Gate(contenders, "regularity", _always(0.0), "what was meant is more regular than noise is in"),
    "beginnings": Gate(contenders, "_BEGINS", 0.0, "odds against an effect that began"),
    "reachable": Gate(responses, "_REACHABLE", 0.0, "places are where the part can get"),
    "unconfirmed": Gate(competition, "_UNCONFIRMED", np.inf, "what one run shows alone is told"),
    "ties": Gate(competition, "simplest", _as_they_are, "the plainest of those that are tied"),
    "contradicted": Gate(trace, "_is_contradicted", _always(False), "one of few runs does not contradict it"),
    "longer": Gate(trace, "_LONGER", np.inf, "roll-outs do not get longer"),
    "unclear commands": Gate(
        coordinate_data, "_depends_on_noise", _all_clear, "steps that noise decides about do not count"
    ),
    "single steps": Gate(trace, "_is_noisier", _always(False), "single steps do not get longer"),
    "single": Gate(trace, "_is_single", _always(False), "one run of few motions confirms nothing"),
    "changing": Gate(trace, "_is_changing", _always(False), "what changes twice may go on"),
    "now or earlier": Gate(trace, "may_remember", _always(False), "this command or earlier ones"),
    "modes": Gate(trace, "missing_modes", _always(()), "a mode of its own is missing"),
    "closest": Gate(trace, "UNEXPLAINED", np.inf, "effects that explain less than half are none"),
    "faulty runs": Gate(calibrate, "faulty_runs", _always(()), "runs unlike the others are set aside"),
}


@contextmanager
def without(name: str, decided: list[str] | None = None) -> Iterator[None]:
    """Without a gate; or with it, and its name is added to `decided` if it decided anything."""
    gate = GATES[name]
    original = getattr(gate.owner, gate.attribute)
    if callable(gate.instead):
        instead = gate.instead

        def stand_in(*arguments: Any, **named: Any) -> Any:
            other = instead(original, *arguments, **named)
            if decided is None:
                return other
            said = original(*arguments, **named)
            if repr(said) != repr(other) and name not in decided:
                decided.append(name)
            return said

        setattr(gate.owner, gate.attribute, stand_in)
    elif decided is None:
        setattr(gate.owner, gate.attribute, gate.instead)
    else:
        decided.append(name)
    try:
        yield
    finally:
        setattr(gate.owner, gate.attribute, original)


def answer_of(case: tuple[str, int]) -> Answer:
    """What calibration says of a case, planted or real."""
    return measured(case[0]) if case[0] in real_recordings() else answered(case)


def real_recordings() -> dict[str, Path]:
    return {path.stem: path for path in sorted((DATA / "executions").rglob("*.csv"))}


def measured(name: str) -> Answer:
    """Calibrated on the first half of a recording, or of its runs, and rolled out over the second."""
    recording = read_recording(real_recordings()[name])
    automaton, runs = model_of(name, recording), np.array(recording.runs)
    is_first = np.arange(len(recording)) < len(recording) // 2
    if len(runs) > 1:
        is_first = np.isin(recording.run, runs[: (len(runs) + 1) // 2])
    found = calibrate.calibrate(automaton, recording.rows(is_first))
    later = recording.rows(~is_first)
    before, after = (rolled(model, later) for model in (automaton, found.automaton))
    said = " + ".join(one.effect.name + ("" if one.is_added else " (not added)") for one in found.effects)
    return Answer(name, 0, found.verdict, said or "nothing", True, None, after / before, after)


def watched(case: tuple[str, int]) -> tuple[Answer, list[str]]:
    """The answer with all gates, and those that decided anything."""
    decided: list[str] = []
    with ExitStack() as stack:
        for name in GATES:
            stack.enter_context(without(name, decided))
        return answer_of(case), decided


def left_out(work: tuple[str, tuple[str, int]]) -> Answer:
    name, case = work
    with without(name):
        return answer_of(case)


def difference(before: Answer, after: Answer) -> str:
    """What is worse or better without a gate; empty if nothing that counts."""
    said = []
    if before.is_right != after.is_right:
        said.append("wrong" if before.is_right else "RIGHT")
    ratio = after.ratio / before.ratio
    if ratio > CHANGED or ratio < 1.0 / CHANGED:
        said.append(f"roll-out {before.ratio:.2f} -> {after.ratio:.2f}")
    if before.verdict != after.verdict:
        said.append(f"{before.verdict} -> {after.verdict}")
    return ", ".join(said)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first-seed", type=int, default=500)
    parser.add_argument("--kinds", nargs="*", default=list(KINDS))
    parser.add_argument("--controls", type=int, default=12)
    parser.add_argument("--gates", nargs="*", default=list(GATES), choices=list(GATES))
    parser.add_argument("--jobs", type=int, default=1)
    asked = parser.parse_args()
    work = [(name, asked.first_seed) for name in asked.kinds]
    work += [("control", asked.first_seed + k) for k in range(asked.controls)]
    work += [(name, 0) for name in real_recordings()]
    with ProcessPoolExecutor(asked.jobs) as pool:
        answers, decided = {}, {}
        for case, (answer, names) in zip(work, pool.map(watched, work), strict=True):
            answers[case], decided[case] = answer, names
        print("| gate | decides | worse without | better without | other verdicts | cases |")
        print("| --- " * 6 + "|")
        for name in asked.gates:
            cases = [case for case in work if name in decided[case]]
            again = pool.map(left_out, [(name, case) for case in cases])
            changes = [(case, answers[case], after) for case, after in zip(cases, again, strict=True)]
            print(row(name, changes), flush=True)


def row(name: str, changes: Sequence[tuple[tuple[str, int], Answer, Answer]]) -> str:
    worse = better = verdicts = 0
    told = []
    for (kind, seed), before, after in changes:
        ratio = after.ratio / before.ratio
        is_worse = (before.is_right and not after.is_right) or ratio > CHANGED
        is_better = (after.is_right and not before.is_right) or ratio < 1.0 / CHANGED
        worse, better = worse + is_worse, better + (is_better and not is_worse)
        verdicts += before.verdict != after.verdict and not is_worse and not is_better
        if said := difference(before, after):
            told.append(f"{kind} #{seed}: {said}")
    counts = f"{len(changes)} | {worse} | {better} | {verdicts}"
    return f"| {name}: {GATES[name].reason} | {counts} | {'; '.join(told) or 'none'} |"


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main()
