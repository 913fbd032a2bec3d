"""Ctrl-C during startup, while the libraries of the command line are being imported."""

from __future__ import annotations

import _thread
import json
import sys
import threading
from typing import NoReturn

INTERRUPTED = 130
SENTENCE = "interrupted; no file was left half-written"
# Long enough for the callback or finaliser that was interrupted to be over [s].
_AGAIN_AFTER = 0.01


def asks_for_json() -> bool:
    """Whether the command line has `--json`: known before it is parsed, and where it cannot be."""
    return "--json" in sys.argv


def end_interrupted() -> NoReturn:
    """End this process like every interrupted command: one line and the exit code."""
    if asks_for_json():
        print(json.dumps({"error": SENTENCE}))
    print(f"error: {SENTENCE}", file=sys.stderr)
    sys.exit(INTERRUPTED)


def repeat_dropped_interruptions() -> None:
    """Repeat a Ctrl-C that Python drops, as it does with exceptions in finalisers and callbacks of weak references.

    Imports take their locks away in such callbacks, so that a command that loads its libraries could miss Ctrl-C.
    """
    before = sys.unraisablehook

    def repeated(dropped: sys.UnraisableHookArgs) -> None:
        if not issubclass(dropped.exc_type, KeyboardInterrupt):
            before(dropped)
        elif not sys.is_finalizing():
            again = threading.Timer(_AGAIN_AFTER, _thread.interrupt_main)
            again.daemon = True
            again.start()

    sys.unraisablehook = repeated


def is_of_an_interruption(error: BaseException | None) -> bool:
    """Whether an error is caused by Ctrl-C: an interrupted import of a compiled module only reports a failure."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__
    return error is not None
