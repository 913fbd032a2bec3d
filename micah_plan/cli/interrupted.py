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
