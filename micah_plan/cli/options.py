"""Options that several commands have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

JsonFlag = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of all that is random; same seed, same bytes.")]
OutputPath = Annotated[Path, typer.Option("-o", "--output", help="File to write.")]
