"""Whether plans have the number of steps that their cost asks for: what plans of fewer and of more steps cost.

    OMP_NUM_THREADS=1 python -m benchmarks knots [PROBLEM ...]

Every shipped problem is solved with its steps times the factors of the table. Each cost is in that of the plan as it is
solved; the number of steps stands beside it, and the predicted success. Search, candidates and verification are the
usual ones, so a plan of fewer steps may take another way.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from unittest.mock import patch

from micah_plan.api.stages import solve
from micah_plan.documents.problem import load_problem
from micah_plan.errors import InputError
from micah_plan.planning import pomdp_hd

PROBLEMS = Path(__file__).resolve().parents[1] / "problems"
FACTORS = (0.6, 0.8, 1.0, 1.25, 1.6)


def costs(path: Path) -> list[tuple[float, int, float]] | None:
    """Cost, steps and predicted success of the plan by each factor; None: no problem, or no plan at all."""
    plans = []
    for factor in FACTORS:
        with patch.object(pomdp_hd, "_STRETCHES", (factor, 2 * factor, 4 * factor)):
            try:
                plan = solve(load_problem(path), advise=False)
            except InputError:
                return None
        steps = 0 if plan.trajectory is None else len(plan.trajectory.inputs)
        plans.append((plan.cost or float("inf"), steps, plan.success_probability or 0.0))
    return plans if plans[FACTORS.index(1.0)][1] else None


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("problems", type=Path, nargs="*")
    options = parser.parse_args()
    print(f"{'problem':<24}" + "".join(f"{factor:>18g}" for factor in FACTORS))
    cheapest = count = 0
    for path in options.problems or sorted(PROBLEMS.glob("*.yaml")):
        plans = costs(path)
        if plans is None:
            continue
        usual = plans[FACTORS.index(1.0)][0]
        row = "".join(f"{f'{cost / usual:.2f} ({steps}) {share:.3f}':>18}" for cost, steps, share in plans)
        print(f"{path.stem:<24}{row}", flush=True)
        count += 1
        cheapest += usual <= 1.02 * min(cost for cost, *_ in plans)
    print(f"{cheapest} of {count} plans are the cheapest, or cost at most 2 % more")


if __name__ == "__main__":
    main()
