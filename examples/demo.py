"""The whole road on one object, a stapler: learn -> solve -> execute -> page. `make demo` runs it, into demo_output/.

The same steps as `micah-plan demo`, on the files of this checkout.
"""

from __future__ import annotations

import sys
from pathlib import Path

from micah_plan.cli.demo import run_demo

ROOT = Path(__file__).resolve().parent.parent
OUTPUT = Path("demo_output")

if __name__ == "__main__":
    (ROOT / OUTPUT).mkdir(exist_ok=True)
    sys.exit(run_demo(ROOT, OUTPUT))
