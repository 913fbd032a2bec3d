"""The command line in this process, as a shell would see it."""

from __future__ import annotations

import sys

from micah_plan.cli.application import main


def exit_code(*words: str) -> int:
    """What ``micah-plan`` with these words ends with."""
    before, sys.argv = sys.argv, ["micah-plan", *words]
    try:
        main()
    except SystemExit as end:
        return int(end.code or 0)
    finally:
        sys.argv = before
    return 0
