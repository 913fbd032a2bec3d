"""A picture of a terminal in which real commands ran: `python docs/picture_of_terminal.py terminal.svg`."""

from __future__ import annotations

import io
import os
import re
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

from rich.console import Console
from rich.terminal_theme import MONOKAI
from rich.text import Text

ROOT = Path(__file__).resolve().parents[1]
WIDTH = 104
SESSION = (
    "micah-plan learn examples/demonstrations/microwave.csv -o microwave.yaml",
    "micah-plan solve problems/microwave_close.yaml --model microwave.yaml -o plan.json --html plan.html",
    "micah-plan execute plan.json --plant mujoco --trials 5 -o runs.csv",
    "micah-plan check wrong.yaml",
)


def run_session(folder: Path) -> Text:
    """What a terminal shows of the commands, run in a folder that sees the shipped files."""
    for name in ("examples", "models", "problems"):
        (folder / name).symlink_to(ROOT / name)
    mistaken = (ROOT / "problems" / "drawer_open.yaml").read_text(encoding="utf-8").replace("tolerance", "tolerence")
    (folder / "wrong.yaml").write_text(mistaken.replace("../models", "models"), encoding="utf-8")
    environment = {**os.environ, "FORCE_COLOR": "1", "COLUMNS": str(WIDTH), "TERM": "xterm-256color"}
    shown = Text()
    for command in SESSION:
        arguments = [sys.executable, "-m", "micah_plan", *shlex.split(command)[1:]]
        done = subprocess.run(arguments, cwd=folder, env=environment, capture_output=True, check=False)  # noqa: S603
        errors = [line for line in done.stderr.decode().splitlines() if "error: " in line]  # not the bars, which vanish
        told = "\n".join([*done.stdout.decode().splitlines(), *errors]).rstrip()
        shown.append("$ ", style="bold green").append(command + "\n", style="bold")
        shown.append_text(Text.from_ansi(told)).append("\n\n")
    shown.rstrip()
    shown.append("\n")  # room below
    return shown


def picture(shown: Text, title: str) -> str:
    """The text as SVG, in the fonts of whoever looks at it: nothing is fetched."""
    console = Console(record=True, width=WIDTH, file=io.StringIO(), force_terminal=True)
    console.print(shown)
    drawn = console.export_svg(title=title, theme=MONOKAI, unique_id="terminal")
    return re.sub(r"@font-face \{.*?\}\s*", "", drawn, flags=re.DOTALL).replace("Fira Code, monospace", "monospace")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        Path(sys.argv[1]).write_text(picture(run_session(Path(place)), "micah-plan") + "\n", encoding="utf-8")
