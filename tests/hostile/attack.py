"""Give files to the readers, in a process with bounded memory, and say what became of each.

`python tests/hostile/attack.py FILE...` prints one JSON object per file: its name, `refused` (the one line), `read` or
`crashed` (the exception), the CPU seconds and the process's largest memory so far [MiB].
"""

from __future__ import annotations

import json
import resource
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from micah_plan.checking import check_file
from micah_plan.errors import InputError
from micah_plan.exchange.urdf import load_urdf
from micah_plan.robot.load_arm import describe_robot, load_arm

MOST_SECONDS, MOST_MEMORY = 20, 3 * 1024**3


def _urdf_as_model(path: Path) -> None:
    load_urdf(path)


def _urdf_as_arm(path: Path) -> None:
    load_arm(describe_robot(path, tool="l1"))


def _checked(path: Path) -> None:
    found = check_file(path)
    if found.faults:
        raise found.faults[0]


def readers(path: Path) -> list[Callable[[Path], None]]:
    """Those that a file of this ending may come to."""
    return [_urdf_as_model, _urdf_as_arm] if path.suffix == ".urdf" else [_checked]


def attack(path: Path, reader: Callable[[Path], None]) -> dict[str, Any]:
    """What a reader does with a file."""
    begin = time.process_time()
    try:
        reader(path)
        outcome = {"read": True}
    except InputError as error:
        outcome = {"refused": str(error)}
    except BaseException as error:
        outcome = {"crashed": f"{type(error).__name__}: {error}"[:300]}
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {"file": path.name, "seconds": time.process_time() - begin, "peak_mib": peak, **outcome}


def _too_long(*_: object) -> None:
    raise TimeoutError("took too long")


if __name__ == "__main__":
    resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, MOST_MEMORY))
    signal.signal(signal.SIGALRM, _too_long)
    for name in sys.argv[1:]:
        for chosen in readers(Path(name)):
            signal.alarm(4 * MOST_SECONDS)
            print(json.dumps(attack(Path(name), chosen)), flush=True)
