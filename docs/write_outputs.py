"""What commands print, in README and docs, made anew: `python docs/write_outputs.py`.

The commands of each page run one after the other in an empty folder that sees the shipped files. The outputs that stand
below `$ micah-plan` lines are replaced by what they print in 80 columns, unless only times differ; the pages that come
from definitions (files and command line) are written too. Where a command fails, nothing is written. MuJoCo is needed
(extra `sim`).
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from generate_reference import pages

ROOT = Path(__file__).resolve().parents[1]
SHIPPED = ("examples", "models", "problems")
FOLDERS = ("benchmarks/tables", "docs")
PAGES = (
    "README.md",
    *(str(page.relative_to(ROOT)) for folder in FOLDERS for page in sorted((ROOT / folder).rglob("*.md"))),
)
_TIME = re.compile(r"[\d.]+ s\b")
_BLOCK = re.compile(r"^```(bash|console)[^\n]*\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Command:
    """A `micah-plan` line of a page and what the page shows as its output; None if it shows none."""

    line: str
    output: str | None
    start: int
    """Where its output begins in the page's text."""


def commands(text: str) -> list[Command]:
    """The commands of a page's text, in their order."""
    of_page = []
    for block in _BLOCK.finditer(text):
        if block[1] == "bash":
            of_page += [Command(line, None, 0) for line in block[2].splitlines() if line.startswith("micah-plan ")]
            continue
        for match in re.finditer(r"^\$ (micah-plan .*)\n((?:(?!\$ ).*\n)*)", block[2], flags=re.MULTILINE):
            of_page.append(Command(match[1], match[2], block.start(2) + match.start(2)))
    return of_page


def printed(line: str, folder: Path) -> str:
    """What a command prints in a folder, in 80 columns; a `RuntimeError` if it fails."""
    arguments = [sys.executable, "-m", "micah_plan", *shlex.split(line)[1:]]
    environment = {**os.environ, "COLUMNS": "80"}
    done = subprocess.run(  # noqa: S603
        arguments, cwd=folder, env=environment, capture_output=True, encoding="utf-8", check=False
    )
    if done.returncode:
        raise RuntimeError(f"{line}\n{done.stderr}")
    return "".join(f"{row.rstrip()}\n" for row in done.stdout.splitlines())


def written_anew(text: str) -> str:
    """A page's text with the outputs that its commands print now."""
    with tempfile.TemporaryDirectory() as place:
        for name in SHIPPED:
            (Path(place) / name).symlink_to(ROOT / name)
        outputs = [(command, printed(command.line, Path(place))) for command in commands(text)]
    for command, output in reversed(outputs):
        if command.output and _TIME.sub("", command.output) != _TIME.sub("", output):
            text = text[: command.start] + output + text[command.start + len(command.output) :]
    return text


def main() -> None:
    texts = {page: (ROOT / page).read_text(encoding="utf-8") for page in PAGES}
    anew = {page: written_anew(text) for page, text in texts.items() if any(c.output for c in commands(text))}
    anew |= {f"docs/{place}": text for place, text in pages().items() if place.endswith(".md")}
    for page, text in anew.items():
        (ROOT / page).write_text(text, encoding="utf-8")
        if text != texts.get(page):
            print(page)


if __name__ == "__main__":
    main()
