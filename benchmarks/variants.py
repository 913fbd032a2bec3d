"""Variants of the shipped problems: is every answer right, and does every number in a remedy work?

    python -m benchmarks variants [--seed 0] [--trials 20] [--only WORD] [--remedies] [--json FILE]

The goal is moved by 5 to 15 cm each way, stacks and tables are higher or lower, corridors narrower, spreads wider, a
body stands in the way, a target lies beyond an end stop. An answer `solved` is right if executions of the plan (on the
nominal plant, `--trials` of them) succeed as often as predicted: a right one misses the bound once in two hundred. An
answer `no_plan` is right if a check of its own says that it is impossible: the file is refused because no mode allows
the goal; or the object, put at 4,000 places of the goal, meets a body at each; or, with an arm, none of 20 tries at 60
places of the goal is free. An answer `not_verified` is right if what is free of the goal is too narrow for what can be
known of the hand (`impossible`), which is a proof; else it counts as right if no plan of two more seeds is solved. With
`--remedies`, of a remedy that names a number the problem is solved once more with it.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import process_time
from typing import Any

from impossible import free_places, highest_share, highest_share_entering, is_out_of_reach
from saving import add_json, save_json
from scipy.stats import binom

from micah_plan.api.stages import execute, solve
from micah_plan.documents.problem import load_problem
from micah_plan.errors import InputError
from micah_plan.planning.findings import explain
from micah_plan.task.plan import Plan
from micah_plan.task.problem import Problem

ROOT = Path(__file__).resolve().parent.parent
Overrides = Mapping[str, Any]


@dataclass(frozen=True)
class Row:
    """A variant and its answer; `right`: None where nothing decided."""

    problem: str
    variant: str
    outcome: str
    predicted: float | None
    right: bool | None
    why: str
    remedy: str
    works: bool | None
    seconds: float


def variants() -> Iterator[tuple[str, str, Overrides]]:
    """(problem, what is changed, overrides)."""
    target = "goal.target.{}.value"
    for x in (0.35, 0.40, 0.48, 0.50, 0.55):
        yield "stapler_on_books", f"goal at x = {x}", {target.format("x"): x}
    for y in (-0.1, -0.05, 0.05, 0.1):
        yield "stapler_on_books", f"goal at y = {y}", {target.format("y"): y}
    for z in (0.21, 0.235, 0.285, 0.31):
        yield "stapler_on_books", f"goal at z = {z}", {target.format("z"): z}
    for z in (0.30, 0.35, 0.38):
        yield "stapler_on_books", f"shelf at {z}", {"scene.shelf.position": [0.475, 0.0, z]}
    for height in (-0.05, 0.02):
        yield "stapler_on_books", f"table higher by {height}", {"scene.table.position": [0.15, 0.12, -0.02 + height]}
    for std in (0.03, 0.2):
        yield "stapler_on_books", f"theta known to {std}", {"start.std.theta": std}
    for theta in (0.05, 0.4, 0.55):
        yield "stapler_on_books", f"theta at {theta}", {"start.mean.theta": theta}
    post = {"shapes": [{"kind": "box", "size": [0.04, 0.04, 0.5]}], "position": [0.2, -0.05, 0.25]}
    yield "stapler_on_books", "a post in the way", {"scene.post": post}
    for x in (0.40, 0.43, 0.47, 0.5):
        yield "box_under_bar", f"goal at x = {x}", {target.format("x"): x}
    for y in (-0.05, 0.05):
        yield "box_under_bar", f"goal at y = {y}", {target.format("y"): y}
    for z in (0.34, 0.42, 0.6):
        yield "box_under_bar", f"bar at {z}", {"scene.bar.position": [0.32, 0.0, z]}
    for z in (0.46, 0.56):
        yield "box_under_bar", f"shelf at {z}", {"scene.shelf.position": [-0.1, 0.0, z]}
    for x in (0.3, 0.4):
        yield "stapler_in_shaft", f"goal at x = {x}", {target.format("x"): x}
    for z in (0.2, 0.3, 0.35):
        yield "stapler_in_shaft", f"goal at z = {z}", {target.format("z"): z}
    for x in (0.36, 0.42):
        yield "stapler_in_shaft", f"right wall at {x}", {"scene.right.position": [x, 0.0, 0.15]}
    for x in (0.37, 0.47):
        yield "clamshell_into_sleeve", f"goal at x = {x}", {target.format("x"): x}
    for z in (0.3, 0.33, 0.4):
        yield "clamshell_into_sleeve", f"roof at {z}", {"scene.roof.position": [0.42, 0.0, z]}
    for value in (0.1, 0.15, 0.3, 0.35):
        yield "drawer_behind_door", f"drawer to {value}", {target.format("drawer"): value}
    for value in (0.2, 0.25):
        yield "drawer_open", f"drawer to {value}", {target.format("drawer"): value}
    for width in (0.005, 0.003):
        yield "slot_unsure", f"start known to {width}", {"start.std": {"x": width, "y": width}}
    for std in (0.03, 0.1):
        yield "microwave_close", f"start known to {std}", {"start.std.door": std}
    for value in (0.3, 0.55, 0.7):
        yield "regrasp_rod", f"rod to {value}", {target.format("rod"): value}
    for value in (0.6, 1.2):
        yield "from_hand_to_hand", f"rod to {value}", {target.format("rod"): value}
    for value in (1.0, 2.2):
        yield "childproof_cap", f"cap to {value}", {target.format("cap"): value}


def measure(name: str, variant: str, overrides: Overrides, asked: argparse.Namespace) -> Row:
    """The answer to a variant, and whether it is right."""
    seed, trials = asked.seed, asked.trials
    began = process_time()
    try:
        problem = load_problem(ROOT / "problems" / f"{name}.yaml", overrides)
    except InputError as error:  # the file is refused: no mode allows the goal
        said = f"{error.problem}; {error.remedy}"
        is_said = any(words in error.problem for words in ("can reach", "the object rests with", "beyond reach"))
        return Row(name, variant, "refused", None, is_said or None, said, "", None, process_time() - began)
    plan = solve(problem, seed=seed, advise=asked.remedies)
    seconds = process_time() - began
    right, why = judged(problem, plan, seed, trials)
    remedy, works = ("", None) if plan.outcome == "solved" or not asked.remedies else followed(problem, plan, seed)
    return Row(name, variant, plan.outcome, plan.success_probability, right, why, remedy, works, seconds)


def judged(problem: Problem, plan: Plan, seed: int, trials: int) -> tuple[bool | None, str]:
    """Whether an answer is right, and by what."""
    if plan.outcome == "solved" and plan.success_probability is not None:
        done = execute(problem, plan, trials=trials, seed=seed + 1).successes
        least = binom.ppf(0.005, trials, min(plan.success_probability, 0.999))
        return bool(done >= least), f"{done} of {trials} executions"
    if problem.hold is not None and not any(cut in plan.reason for cut in ("time limit", "max_knots")):
        places = free_places(problem, seed)
        if not len(places):
            return True, "the goal is not free"
        if plan.outcome == "no_plan":
            return None, plan.reason[:100]
        if (most := highest_share(problem, places)) < problem.settings.confidence:
            return True, f"no plan ends there with more than {most:.2f}"
    if problem.hold is None and is_out_of_reach(problem):
        return True, "nothing moves it that far"
    if (most := highest_share_entering(problem)) < problem.settings.confidence:
        return True, f"no plan enters the goal with more than {most:.2f}"
    others = [solve(problem, seed=seed + more, advise=False) for more in (1, 2)]
    found = [other.outcome for other in others]
    right = False if "solved" in found else None if plan.outcome == "no_plan" else True
    return right, f"{plan.reason[:100]}: {found}"


def followed(problem: Problem, plan: Plan, seed: int) -> tuple[str, bool | None]:
    """The first remedy that names a number, and whether the problem is solved with it."""
    for finding in explain(problem, plan).findings:
        remedy = finding.remedy
        if found := re.search(r"lower `confidence` to ([0-9.]+[0-9])", remedy):
            changed = _with_confidence(problem, float(found[1]))
        elif found := re.search(r"widen the tolerance of '(\w+)' to ([0-9.]+[0-9])", remedy):
            changed = _with_tolerance(problem, found[1], float(found[2]))
        elif found := re.search(r"raise revisits to (\d+)", remedy):
            changed = _with_settings(problem, revisits=int(found[1]))
        else:
            continue
        return found[0], solve(changed, seed=seed, advise=False).outcome == "solved"
    return "", None


def _with_confidence(problem: Problem, value: float) -> Problem:
    return _with_settings(problem, confidence=value)


def _with_settings(problem: Problem, **changed: Any) -> Problem:
    return replace(problem, settings=replace(problem.settings, **changed))


def _with_tolerance(problem: Problem, name: str, value: float) -> Problem:
    index = [c.name for c in problem.automaton.coordinates].index(name)
    target = tuple((i, v, value if i == index else t) for i, v, t in problem.goal.target)
    return replace(problem, goal=replace(problem.goal, target=target))


def line(row: Row) -> str:
    predicted = "-" if row.predicted is None else f"{row.predicted:.3f}"
    verdict = {True: "right", False: "WRONG", None: "open"}[row.right]
    works = {True: "works", False: "FAILS", None: ""}[row.works]
    text = f"{row.problem:22} {row.variant:24} {row.outcome:13} {predicted:>6} {row.seconds:6.1f} {verdict:6} {row.why}"
    return f"{text} | {row.remedy}: {works}" if row.remedy else text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--trials", type=int, default=20, help="executions of each plan")
    parser.add_argument("--only", default="", help="problems whose name has this in it")
    parser.add_argument("--remedies", action="store_true", help="follow the numbers of remedies, which takes long")
    add_json(parser)
    asked = parser.parse_args()
    rows = []
    for name, variant, overrides in variants():
        if asked.only in name:
            rows.append(measure(name, variant, overrides, asked))
            print(line(rows[-1]), flush=True)
    counts = [sum(row.right is value for row in rows) for value in (True, False, None)]
    tried = [row for row in rows if row.works is not None]
    print(f"{counts[0]} of {len(rows)} right, {counts[1]} wrong, {counts[2]} open; ", end="")
    print(f"{sum(bool(row.works) for row in tried)} of {len(tried)} remedies with a number work")
    save_json([asdict(row) for row in rows], asked.json)


if __name__ == "__main__":
    main()
