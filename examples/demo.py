"""The whole road on one object: learn -> solve -> execute -> page. `make demo` runs it; results go to demo_output/.

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
        "A recorded demonstration of a microwave door becomes a hybrid automaton.",
        "learn examples/demonstrations/microwave.csv --parts models/parts/microwave.yaml -o {out}/microwave.yaml"
        " --figure {out}/segments.png --html {out}/recording.html",
    ),
    (
        "POMDP-HD plans in belief space how to shut the door until it latches.",
        "solve problems/microwave_close.yaml --model {out}/microwave.yaml -o {out}/plan.json --html {out}/plan.html",
    ),
    (
        "Independent physics (MuJoCo) executes the plan 5 times with tracker noise, filter and feedback.",
        "execute {out}/plan.json --plant mujoco --trials 5 -o {out}/runs.csv --figure {out}/belief.png",
    ),
    (
        "The executed runs are recordings: the learned model predicts them.",
        "predict {out}/microwave.yaml {out}/runs.csv",
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
