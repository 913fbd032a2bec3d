"""The command line. Exit codes: 0 done, 1 nothing found (no plan, no joint that fits), 2 bad input.

Results go to stdout (with --json exactly one JSON object), progress and errors to stderr. Wrong usage is bad input: one
line, before any work, and so are outputs of a wrong kind or that would overwrite an input or one another.
"""

import os

from micah_plan.cli.interrupted import end_interrupted, is_of_an_interruption, repeat_dropped_interruptions

__all__ = ["main"]


def main() -> None:
    """Entry point of `micah-plan`. Ctrl-C prints one line from here on, also during imports."""
    repeat_dropped_interruptions()
    # Plugins of pydantic are searched in the metadata of all installed packages, and none applies to these files.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    # Matrices are small here: threads of the linear algebra only wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        from micah_plan.cli.application import main as run
    except (KeyboardInterrupt, ImportError) as error:
        if not is_of_an_interruption(error):
            raise
        end_interrupted()
    run()
