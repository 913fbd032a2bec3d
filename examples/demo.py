"""The whole road on one object, a stapler: learn -> solve -> execute -> page. `make demo` runs it, into demo_output/.

Each step is a command that you can type yourself; it is printed before it runs.
"""

from __future__ import annotations

import shlex
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
OUTPUT = Path("demo_output")

STEPS = (
    (
        "A recorded demonstration of a desk stapler becomes a hybrid automaton: a hinge that latches.",
        "learn examples/demonstrations/stapler.csv --parts models/parts/stapler.yaml -o {out}/stapler.yaml"
        " --figure {out}/segments.png --html {out}/recording.html",
    ),
    (
        "POMDP-HD finds how an arm gets it onto the books: pressed shut on the table first. Only the place is given.",
        "solve problems/stapler_on_books.yaml --model {out}/stapler.yaml -o {out}/plan.json --html {out}/plan.html"
        " --figure {out}/plan.png",
    ),
    (
        "The model itself executes the plan 3 times, with filter and feedback.",
        "execute {out}/plan.json --plant nominal --trials 3 -o {out}/nominal.csv",
    ),
    (
        "Physics (MuJoCo) executes it 3 times: an arm under position control, contact, a latch, loose books.",
        "execute {out}/plan.json --plant mujoco --trials 3 -o {out}/runs.csv --figure {out}/belief.png",
    ),
)


def main() -> int:
    """Run all steps and say what to open; stops at the first that fails and returns its exit code."""
    output = ROOT / OUTPUT
    output.mkdir(exist_ok=True)
    begin = time.monotonic()
    for number, (sentence, command) in enumerate(STEPS, start=1):
        arguments = command.format(out=OUTPUT)
        print(f"\n[{number}/{len(STEPS)}] {sentence}\n$ micah-plan {arguments}", flush=True)
        done = subprocess.run([sys.executable, "-m", "micah_plan", *shlex.split(arguments)], cwd=ROOT, check=False)
        if done.returncode:
            print(f"this step ended with exit code {done.returncode}", file=sys.stderr)
            return done.returncode
    print(
        f"\nDone in {time.monotonic() - begin:.0f} s. Open {OUTPUT}/plan.html in a browser, then {OUTPUT}/belief.png."
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
