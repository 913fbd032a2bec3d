"""Files, lines and the median file of every package, at an earlier commit and now.

    python benchmarks/size.py REVISION

Packages that the earlier commit called otherwise stand beside what became of them (`RENAMED`); folders within a package
count with it. Lines are all lines of Python files.
"""

from __future__ import annotations

import argparse
import subprocess
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = "micah_plan"
RENAMED = {"spec": "documents"}
# Packages that the restructuring left alone.
APART = ("learn", "residual")


def git(*arguments: str) -> str:
    return subprocess.run(["git", "-C", str(ROOT), *arguments], check=True, capture_output=True, text=True).stdout  # noqa: S603, S607


def before(revision: str) -> dict[str, list[int]]:
    """Lines of each file of a commit, by package."""
    names = git("ls-tree", "-r", "--name-only", revision, PACKAGE).splitlines()
    return by_package({name: git("show", f"{revision}:{name}").count("\n") for name in names if name.endswith(".py")})


def now() -> dict[str, list[int]]:
    """Lines of each file of the working tree, by package."""
    files = sorted((ROOT / PACKAGE).rglob("*.py"))
    return by_package({file.relative_to(ROOT).as_posix(): file.read_text("utf-8").count("\n") for file in files})


def by_package(lines: Mapping[str, int]) -> dict[str, list[int]]:
    found = defaultdict(list)
    for name, count in lines.items():
        _, *inner = name.split("/")
        own = inner[0] if len(inner) > 1 else "(top)"
        found[RENAMED.get(own, own)].append(count)
    return found


def row(name: str, old: Sequence[int], new: Sequence[int]) -> str:
    cells = [f"{len(own)} | {sum(own)} | {median(own):.0f}" if own else "| |" for own in (old, new)]
    change = f"{100 * (sum(new) / sum(old) - 1):+.0f} %" if old else "new"
    return f"| {name} | {' | '.join(cells)} | {change} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("revision", help="the commit to compare with")
    options = parser.parse_args()
    old, new = before(options.revision), now()
    print("| package | files | lines | median | files now | lines now | median now | change |")
    print("| --- |" + " ---: |" * 7)
    for name in sorted({*old, *new}):
        print(row(name, old.get(name, []), new.get(name, [])))
    whole = [[count for counts in own.values() for count in counts] for own in (old, new)]
    rest = [[count for name, counts in own.items() if name not in APART for count in counts] for own in (old, new)]
    print(row(f"without {' and '.join(APART)}", *rest))
    print(row("all", *whole))


if __name__ == "__main__":
    main()
