"""Problems that are refused: is the reason true, and does the remedy help when it is applied?

    OMP_NUM_THREADS=1 python -m benchmarks refusals [NAME ...] [--list]

Forty problems that nobody can solve as they are asked: shipped ones made too tight, too short, too noisy or closed, and
those of `tests/planning` that must be refused. What a remedy names is applied: a number as it is written, and where
none is to be written (`lower the noise`) twice and eight times as much. `helps`: planning then succeeds; `by hand`:
only a person can do it (move what is there, add a transition).
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests" / "planning")]

import test_executed_inputs as people  # noqa: E402
import test_fields_of_boxes as fields  # noqa: E402
import test_remedies as remedies  # noqa: E402

from micah_plan.planning.limits import limits_of  # noqa: E402
from micah_plan.planning.solver import solve  # noqa: E402
from micah_plan.task.plan import Finding  # noqa: E402
from micah_plan.task.problem import Problem  # noqa: E402
from micah_plan.task.settings import PlannerSettings  # noqa: E402

Made = Callable[[Path], Problem]


def settings(problem: Problem, change: Callable[[PlannerSettings], dict[str, object]]) -> Problem:
    return replace(problem, settings=replace(problem.settings, **change(problem.settings)))  # type: ignore[arg-type]


def noisier(problem: Problem, factor: float) -> Problem:
    noise = problem.automaton.noise
    stds = {name: tuple(factor * s for s in getattr(noise, name)) for name in ("process_std", "observation_std")}
    return replace(problem, automaton=replace(problem.automaton, noise=replace(noise, **stds)))


def wider_start(problem: Problem, factor: float) -> Problem:
    return replace(problem, start=replace(problem.start, std=tuple(factor * s for s in problem.start.std)))


def tolerances(problem: Problem, factor: float) -> Problem:
    return remedies.with_tolerances(problem, factor)


def faster(problem: Problem, factor: float) -> Problem:
    largest = tuple((factor * limits_of(problem).max_step).tolist())
    return settings(problem, lambda _: {"max_step": largest})


def without_edges(problem: Problem, source: str, target: str) -> Problem:
    edges = tuple(e for e in problem.automaton.edges if (e.source, e.target) != (source, target))
    return replace(problem, automaton=replace(problem.automaton, edges=edges))


def shipped(name: str, change: Callable[[Problem], Problem]) -> Made:
    return lambda _: change(remedies.of_file(name))


def _knots(count: int) -> Callable[[Problem], Problem]:
    return lambda problem: settings(problem, lambda _: {"max_knots": count})


def _revisits(count: int) -> Callable[[Problem], Problem]:
    return lambda problem: settings(problem, lambda _: {"revisits": count})


REFUSED: dict[str, Made] = {
    **{f"people: {why}": (lambda folder, why=why: _asked(folder, why)) for why in people.REFUSED},
    **{
        f"boxes: {name}": (lambda folder, name=name: fields._field(folder, fields.WALLS[name])) for name in fields.WALLS
    },
    **{name: (lambda _, made=made: made()) for name, made in remedies.FAILING.items()},
    "slot narrower than the belief": shipped("slot_unsure", lambda p: p),
    "rod in 12 knots": shipped("regrasp_rod", _knots(12)),
    "rod without a second hold": shipped("regrasp_rod", _revisits(0)),
    "door in 5 knots": shipped("microwave_close", _knots(5)),
    "drawer behind a door in 12 knots": shipped("drawer_behind_door", _knots(12)),
    "drawer behind a door that never opens": shipped("drawer_behind_door", lambda p: without_edges(p, "shut", "ajar")),
    "walls without a way back": shipped("walled_domain", _revisits(0)),
    "light with a tenth of the tolerance": shipped("light_dark", lambda p: tolerances(p, 0.1)),
    "drawer with a hundredth of the tolerance": shipped("drawer_open", lambda p: tolerances(p, 0.02)),
    "door twenty times as noisy": shipped("microwave_open", lambda p: noisier(p, 20.0)),
    "drawer twenty times as noisy": shipped("drawer_close", lambda p: noisier(p, 20.0)),
    "cabinet with a hand that hardly moves": shipped("cabinet_open", lambda p: faster(p, 0.05)),
    "key by touch in one visit": shipped("key_by_touch", _revisits(0)),
    "hole by fences ten times as noisy": shipped("hole_by_two_fences", lambda p: noisier(p, 10.0)),
    "rule unfolded in 8 knots": shipped("folding_rule", _knots(8)),
    "cap with a weak hand": shipped("childproof_cap", lambda p: faster(p, 0.1)),
    "walls and a start ten times as wide": shipped("walled_domain", lambda p: wider_start(p, 10.0)),
    "tray in 6 knots": shipped("carry_tray", _knots(6)),
    "sill twenty times as noisy": shipped("over_a_sill", lambda p: noisier(p, 20.0)),
}


def _asked(folder: Path, why: str) -> Problem:
    texts, *changes = people.REFUSED[why]
    return people._problem(folder, texts, *changes)


# What remedies ask for without a number, and what may be tried for it.
_TIMES = (2.0, 8.0)
_GENERAL: dict[str, Callable[[Problem, float], Problem]] = {
    "raise max_knots": lambda p, k: settings(p, lambda s: {"max_knots": int(k * s.max_knots)}),
    "max_step": faster,
    "samples_per_mode": lambda p, k: settings(p, lambda s: {"samples_per_mode": int(k * s.samples_per_mode)}),
    "search_limit": lambda p, k: settings(p, lambda s: {"search_limit": int(5 * k * s.search_limit)}),
    "candidates": lambda p, k: settings(p, lambda s: {"candidates": int(k * s.candidates)}),
    "lower the start's std": lambda p, k: wider_start(p, 1.0 / k),
    "the noise": lambda p, k: noisier(p, 1.0 / k),
    "widen the tolerance": lambda p, k: tolerances(p, k),
    "widen the goal's tolerance": lambda p, k: tolerances(p, k),
    "raise `confidence`": lambda p, k: settings(p, lambda s: {"confidence": 1.0 - (1.0 - s.confidence) / (5.0 * k)}),
}


def applied(problem: Problem, finding: Finding) -> Iterator[tuple[str, list[Problem]]]:
    """What a remedy names, and the problems with it."""
    remedy, _, _ = finding.remedy.partition(" (tried in vain")
    for other in remedies.taken(problem, finding):
        yield "its number", [other]
    for text in re.findall(r"raise `?revisits`? to (\d+)", remedy):
        yield f"revisits {text}", [_revisits(int(text))(problem)]
    for words, change in _GENERAL.items():
        if re.search(rf"{re.escape(words)}(?! of '\w+' to \d)", remedy):
            yield words, [change(problem, k) for k in _TIMES]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--list", action="store_true")
    asked = parser.parse_args()
    names = asked.names or list(REFUSED)
    if asked.list:
        print("\n".join(names))
        return
    counts = {"helps": 0, "does not help": 0, "by hand": 0}
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            problem = REFUSED[name](Path(folder))
            plan = solve(problem)
        print(f"{name}: {plan.outcome}", flush=True)
        if plan.outcome == "solved":
            print(f"    is no refusal: {np.round(plan.success_probability or 0.0, 3)}")
            continue
        for finding in plan.findings[:1] or ():
            print(f"    {finding.sentence}\n    remedy: {finding.remedy}")
            tried = list(applied(problem, finding))
            if not tried:
                counts["by hand"] += 1
                print("      by hand")
            for words, problems in tried:
                outcomes = [solve(other, advise=False).outcome for other in problems]
                which = "helps" if "solved" in outcomes else "does not help"
                counts[which] += 1
                print(f"      {words}: {which}", flush=True)
    print("; ".join(f"{which}: {count}" for which, count in counts.items()))


if __name__ == "__main__":
    main()
