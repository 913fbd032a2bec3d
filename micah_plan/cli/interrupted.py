"""Ctrl-C before there is anything that could handle it: while the libraries of the command line are loaded."""

from __future__ import annotations

import json
import sys
from typing import NoReturn

INTERRUPTED = 130
SENTENCE = "interrupted; no file was left half-written"


def end_interrupted() -> NoReturn:
    """End this process as every interrupted command ends: with one line and the exit code."""
    if "--json" in sys.argv:
        print(json.dumps({"error": SENTENCE}))
    print(f"error: {SENTENCE}", file=sys.stderr)
    sys.exit(INTERRUPTED)


def is_of_an_interruption(error: BaseException | None) -> bool:
    """Whether an error comes from Ctrl-C: a compiled module that was being loaded then only says that it failed."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__
    return error is not None
