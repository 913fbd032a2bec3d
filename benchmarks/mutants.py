"""How many small mistakes in the source the tests notice: random mutants, each run against the nearest tests.

    python -m benchmarks mutants [--mutants N] [--seed S] [--revision COMMIT] [--jobs J]

A mutant is the package with one comparison turned around, one number changed by 10 % (a whole one by 1) or one term of
a sum dropped. It is killed if a test fails or its tests take longer than ten minutes. The nearest tests are the
files of tests that import the mutated module, then the other quick ones of its package's folder.

First the tests run on a copy without a mutant: where they fail, nothing that follows would mean anything.

The same seed and commit give the same mutants. Survivors are printed with their lines: each wants a test, or its line
says nothing and can go. Docstrings, type hints, messages and `__all__` are not mutated.
"""

from __future__ import annotations

import argparse
import ast
import os
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("automaton", "belief", "planning", "learning", "residual")
TURNED = {ast.Lt: ">", ast.LtE: ">", ast.Gt: "<", ast.GtE: "<", ast.Eq: "!=", ast.NotEq: "=="}
LONGEST_S = 600
"""Of one run of tests: a mutant that loops for ever is noticed."""


@dataclass(frozen=True)
class Mutant:
    """One change of one line: `before` at columns [column, end) of a line (from 1) becomes `after`."""

    file: str
    line: int
    column: int
    end: int
    before: str
    after: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.before} -> {self.after}"


def _passed_over(tree: ast.Module) -> set[int]:
    """Identities of nodes that only people and type checkers read: annotations, raises, formatted strings."""
    skipped: list[ast.AST] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Raise | ast.JoinedStr | ast.Assert):
            skipped.append(node)
        elif isinstance(node, ast.AnnAssign | ast.arg) and node.annotation is not None:
            skipped.append(node.annotation)
        elif isinstance(node, ast.FunctionDef) and node.returns is not None:
            skipped.append(node.returns)
    return {id(inner) for node in skipped for inner in ast.walk(node)}


def mutants_of(file: str, text: str) -> Iterator[Mutant]:
    """All mutants of a file whose change lies within one line."""
    tree = ast.parse(text)
    skipped, lines = _passed_over(tree), text.splitlines()
    for node in ast.walk(tree):
        if id(node) in skipped or not isinstance(node, ast.expr) or node.lineno != node.end_lineno:
            continue
        after = _changed(node)
        if after is not None and lines[node.lineno - 1].isascii():
            before = lines[node.lineno - 1][node.col_offset : node.end_col_offset]
            yield Mutant(file, node.lineno, node.col_offset, node.end_col_offset or 0, before, after)


def _changed(node: ast.expr) -> str | None:
    """The text of a changed expression; None if it is of no kind that is changed."""
    if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in TURNED:
        sign = TURNED[type(node.ops[0])]
        return f"{ast.unparse(node.left)} {sign} {ast.unparse(node.comparators[0])}"
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub):
        return f"({ast.unparse(node.left)})"
    if isinstance(node, ast.Constant) and type(node.value) in (int, float) and node.value:
        return repr(node.value + 1) if isinstance(node.value, int) else repr(node.value * 1.1)
    return None


def nearest_tests(module: str, tests: Path) -> list[list[str]]:
    """Files of tests that import a module, fewest imports first; then the folder of its package."""
    importing = []
    for file in sorted(tests.rglob("test_*.py")):
        text = file.read_text(encoding="utf-8")
        if f"from {module} import" in text:
            importing.append((text.count("from micah_plan"), str(file)))
    folder = tests / module.split(".")[1]
    return [[name] for _, name in sorted(importing)[:4]] + ([[str(folder)]] if folder.is_dir() else [])


def copy_checkout(tree: Path, place: str) -> tuple[Path, dict[str, str]]:
    """A copy of a checkout below a folder, and the environment in which its package is the one that is imported."""
    copy = Path(place) / "checkout"
    shutil.copytree(tree, copy, ignore=shutil.ignore_patterns(".git", ".venv", "__pycache__"))
    return copy, {**os.environ, "PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}


def failures_without_a_mutant(tree: Path) -> str:
    """The control: what fails of the tests of all packages on a copy of the checkout as it is; empty: nothing."""
    with tempfile.TemporaryDirectory() as place:
        copy, environment = copy_checkout(tree, place)
        folders = [str(copy / "tests" / package) for package in PACKAGES]
        command = [sys.executable, "-m", "pytest", "-qx", "-n", "auto", "-p", "no:cacheprovider", *folders]
        done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, encoding="utf-8")  # noqa: S603
        return "\n".join(done.stdout.splitlines()[-30:]) if done.returncode else ""


def is_killed(mutant: Mutant, tree: Path) -> bool:
    """Whether the nearest tests fail on a copy of the checkout with the mutant in it."""
    with tempfile.TemporaryDirectory() as place:
        copy, environment = copy_checkout(tree, place)
        path = copy / mutant.file
        lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
        line = lines[mutant.line - 1]
        lines[mutant.line - 1] = line[: mutant.column] + mutant.after + line[mutant.end :]
        path.write_text("".join(lines), encoding="utf-8")
        module = mutant.file.removesuffix(".py").replace("/", ".").removesuffix(".__init__")
        for files in nearest_tests(module, copy / "tests"):
            command = [sys.executable, "-m", "pytest", "-qx", "-p", "no:cacheprovider", *files]
            try:
                done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, timeout=LONGEST_S)  # noqa: S603
            except subprocess.TimeoutExpired:
                return True
            if done.returncode not in (0, 5):  # 5: no test was collected
                return True
    return False


def chosen(tree: Path, count: int, seed: int) -> list[Mutant]:
    """Mutants of all packages, as many of each, drawn without repetition."""
    rng, drawn = np.random.default_rng(seed), []
    for k, package in enumerate(PACKAGES):
        files = sorted((tree / "micah_plan" / package).rglob("*.py"))
        found = [m for file in files for m in mutants_of(str(file.relative_to(tree)), file.read_text("utf-8"))]
        share = count // len(PACKAGES) + (k < count % len(PACKAGES))
        drawn += [found[i] for i in rng.choice(len(found), share, replace=False)]
    return drawn


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mutants", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--revision", help="commit to mutate; default: the checkout as it is")
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as place:
        tree = ROOT
        if given.revision:
            tree = Path(place) / "tree"
            git = ["git", "-C", str(ROOT), "worktree", "add", "--detach", str(tree), given.revision]
            subprocess.run(git, check=True, capture_output=True)  # noqa: S603
        if failed := failures_without_a_mutant(tree):
            sys.exit(f"{failed}\nthe tests fail without a mutant; mend them first")
        drawn, survivors, killed = chosen(tree, given.mutants, given.seed), [], Counter[str]()
        with ThreadPoolExecutor(given.jobs) as pool:
            for mutant, dead in zip(drawn, pool.map(lambda m: is_killed(m, tree), drawn), strict=True):
                killed[mutant.file.split("/")[1]] += dead
                print("killed  " if dead else "survived", mutant, flush=True)
                survivors += [] if dead else [mutant]
        if given.revision:
            subprocess.run(["git", "-C", str(ROOT), "worktree", "remove", "--force", str(tree)], check=True)  # noqa: S603, S607
    total = Counter(mutant.file.split("/")[1] for mutant in drawn)
    print(f"\n{'package':<12}{'mutants':>8}{'killed':>8}")
    for package in PACKAGES:
        print(f"{package:<12}{total[package]:>8}{killed[package]:>8}")
    print(f"{'all':<12}{len(drawn):>8}{len(drawn) - len(survivors):>8}")


if __name__ == "__main__":
    main()
