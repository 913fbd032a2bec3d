"""The option --json that benchmarks share."""

from __future__ import annotations

import argparse
import json
from pathlib import Path


def add_json(parser: argparse.ArgumentParser) -> None:
    """The option; its value is a path or None."""
    parser.add_argument("--json", type=Path, help="also write the rows to this file")


def save_json(rows: object, file: Path | None) -> None:
    """Write rows of plain values if there is a file to write to."""
    if file is not None:
        file.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")
