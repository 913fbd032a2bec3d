"""Files, lines and the median file of every package, at an earlier commit and now.

    python -m benchmarks size REVISION [--kinds] [--constants PACKAGE]

With `--kinds`, what the lines are, without the packages that the restructuring left alone: code, docstrings, blank
lines, imports, heads of functions and comments. With `--constants`, the numbers that a package's modules name, with
values and comments, and how many there were.

Packages that the earlier commit called otherwise stand beside what became of them (`RENAMED`); folders within a package
count with it. Lines are all lines of Python files.
"""

from __future__ import annotations

import argparse
import ast
import subprocess
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = "micah_plan"
RENAMED = {"spec": "documents", "front": "api", "ros": "recording", "scene": "task"}
# Packages that the restructuring left alone.
APART = ("learning", "residual")


def git(*arguments: str) -> str:
    return subprocess.run(["git", "-C", str(ROOT), *arguments], check=True, capture_output=True, text=True).stdout  # noqa: S603, S607


def before(revision: str) -> dict[str, list[str]]:
    """Texts of the files of a commit, by package."""
    names = git("ls-tree", "-r", "--name-only", revision, PACKAGE).splitlines()
    return by_package({name: git("show", f"{revision}:{name}") for name in names if name.endswith(".py")})


def now() -> dict[str, list[str]]:
    """Texts of the files of the working tree, by package."""
    files = sorted((ROOT / PACKAGE).rglob("*.py"))
    return by_package({file.relative_to(ROOT).as_posix(): file.read_text("utf-8") for file in files})


def by_package(texts: Mapping[str, str]) -> dict[str, list[str]]:
    found = defaultdict(list)
    for name, text in texts.items():
        _, *inner = name.split("/")
        own = inner[0] if len(inner) > 1 else "(top)"
        found[RENAMED.get(own, own)].append(text)
    return found


def kinds(text: str) -> Counter[str]:
    """How many lines of a file are what."""
    lines = text.splitlines()
    kind = ["comments" if line.strip().startswith("#") else "code" if line.strip() else "blank" for line in lines]

    def mark(first: int, last: int, name: str) -> None:
        """Lines from a first to a last one, counted from 1."""
        for i in range(first - 1, last):
            kind[i] = name if kind[i] != "blank" or name == "docstrings" else "blank"

    for node in ast.walk(ast.parse(text)):
        match node:
            case ast.Expr(value=ast.Constant(value=str())):
                mark(node.lineno, node.end_lineno or node.lineno, "docstrings")
            case ast.Import() | ast.ImportFrom():
                mark(node.lineno, node.end_lineno or node.lineno, "imports")
            case ast.FunctionDef():
                mark(node.lineno, node.body[0].lineno - 1, "heads of functions")
    return Counter(kind)


def print_kinds(old: Mapping[str, Sequence[str]], new: Mapping[str, Sequence[str]]) -> None:
    then, today = (
        sum((kinds(text) for name, texts in own.items() if name not in APART for text in texts), Counter[str]())
        for own in (old, new)
    )
    print("| lines | before | now | change |")
    print("| --- | ---: | ---: | ---: |")
    for name, count in today.most_common():
        print(f"| {name} | {then[name]} | {count} | {100 * (count / then[name] - 1):+.0f} % |")


def constants(text: str) -> dict[str, tuple[str, str]]:
    """Values and comments of the numbers that a module names."""
    lines, found = text.splitlines(), {}
    for node in ast.parse(text).body:
        if not (isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)):
            continue
        name, value = node.targets[0].id, ast.unparse(node.value)
        numbers = any(
            isinstance(one, ast.Constant) and isinstance(one.value, int | float) for one in ast.walk(node.value)
        )
        if name.upper() == name and numbers:
            beside = lines[node.lineno - 1].partition("  # ")[2]
            above = lines[node.lineno - 2].removeprefix("# ") if lines[node.lineno - 2].startswith("# ") else ""
            found[name] = value, beside or above
    return found


def print_constants(old: Sequence[str], new: Mapping[str, str]) -> None:
    """Of one package: how many before and now, and each that there is."""
    then = sum(len(constants(text)) for text in old)
    today = {name: found for name, text in new.items() if (found := constants(text))}
    print(f"{then} named numbers before, {sum(map(len, today.values()))} now")
    print("| file | name | value | what it is |")
    print("| --- | --- | --- | --- |")
    for name, found in today.items():
        for constant, (value, meaning) in found.items():
            print(f"| {name} | `{constant}` | {value} | {meaning} |")


def row(name: str, old: Sequence[int], new: Sequence[int]) -> str:
    cells = [f"{len(own)} | {sum(own)} | {median(own):.0f}" if own else "| |" for own in (old, new)]
    change = f"{100 * (sum(new) / sum(old) - 1):+.0f} %" if old else "new"
    return f"| {name} | {' | '.join(cells)} | {change} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("revision", help="the commit to compare with")
    parser.add_argument("--kinds", action="store_true", help="what the lines are")
    parser.add_argument("--constants", metavar="PACKAGE", help="the named numbers of a package")
    options = parser.parse_args()
    texts = before(options.revision), now()
    if options.constants:
        here = ROOT / PACKAGE / options.constants
        files = {file.relative_to(here).as_posix(): file.read_text("utf-8") for file in sorted(here.rglob("*.py"))}
        print_constants(texts[0].get(options.constants, []), files)
        return
    if options.kinds:
        print_kinds(*texts)
        return
    old, new = ({name: [text.count("\n") for text in own] for name, own in side.items()} for side in texts)
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
