"""Shipped files of every kind with small mistakes: each is read or refused in one line; none is a bug of ours.

Of evidence are `MICAH_MUTANTS` of them (10,000); of the blocking ones are 300.
"""

from __future__ import annotations

import os
import re
import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from shell import exit_code

from micah_plan.cli.console import BAD_INPUT
from micah_plan.documents.plan import write_plan
from micah_plan.documents.problem import load_problem
from micah_plan.execution.trials import run_trials
from micah_plan.planning.solver import solve
from micah_plan.recording.csv_file import write_csv

NUMBERS = (
    b"nan",
    b"inf",
    b"-1",
    b"0",
    b"1e309",
    b"-0.0",
    b"1e-320",
    b"90",
    b"1000000000000",
    b"'1'",
    b"1,5",
    b"0x1f",
    b"~",
)
WORDS = (
    b"null",
    b"true",
    b"[]",
    b"{}",
    b"''",
    b"x y",
    b"\xc3\xbc",
    b"\xff",
    b"!!python/object:os.system",
    b"&a [*a]",
    b"[/red]",
)
NUMBER = re.compile(rb"-?\d+\.?\d*(?:e-?\d+)?")
WORD = re.compile(rb"[A-Za-z_]{3,}")


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """The bytes of a file with one small mistake."""
    lines = data.splitlines(keepends=True)
    i, j = (int(rng.integers(len(lines))) for _ in range(2))
    kind = int(rng.integers(9))
    if kind in (0, 1):
        found = list((NUMBER if kind == 0 else WORD).finditer(data))
        if found:
            at = found[int(rng.integers(len(found)))]
            choice = NUMBERS if kind == 0 else WORDS
            return data[: at.start()] + choice[int(rng.integers(len(choice)))] + data[at.end() :]
    if kind == 2:
        return b"".join(lines[:i] + lines[i + 1 :])
    if kind == 3:
        return b"".join([*lines[:i], lines[i], *lines[i:]])
    if kind == 4:
        lines[i], lines[j] = lines[j], lines[i]
        return b"".join(lines)
    at = int(rng.integers(len(data)))
    if kind == 5:
        return data[:at]
    if kind == 6:
        return data[:at] + bytes([int(rng.integers(256))]) + data[at + 1 :]
    if kind == 7:
        return data[:at] + data[at + 1 + int(rng.integers(8)) :]
    lines[i] = b"  " + lines[i]
    return b"".join(lines)


@pytest.fixture(scope="module")
def shipped(tmp_path_factory, repository) -> tuple[Path, tuple[Path, ...]]:
    """A copy of the shipped files, with those that are made of them, and the small ones to mutate."""
    folder = tmp_path_factory.mktemp("shipped")
    for name in ("models", "problems", "examples"):
        shutil.copytree(repository / name, folder / name, ignore=shutil.ignore_patterns("__pycache__", "*.py"))
    problem = load_problem(folder / "problems" / "drawer_open.yaml")
    plan = solve(problem)
    write_plan(plan, problem, folder / "plan.json")
    recording = run_trials(problem, plan, trials=1).recording
    write_csv(recording, folder / "runs.csv")
    files = [path for path in sorted(folder.rglob("*")) if path.suffix in (".yaml", ".csv", ".json", ".urdf")]
    return folder, tuple(path for path in files if path.stat().st_size < 60_000)


def check_mutants(shipped, count: int, seed: int, capsys) -> Counter[int]:
    _, files = shipped
    rng, codes = np.random.default_rng(seed), Counter[int]()
    for number in range(count):
        path = files[int(rng.integers(len(files)))]
        original = path.read_bytes()
        mutant = mutated(original, rng)
        try:
            path.write_bytes(mutant)
            code = exit_code("check", str(path))
        finally:
            path.write_bytes(original)
        said = capsys.readouterr()
        assert code in (0, BAD_INPUT), f"mutant {number} of {path.name}: {code}\n{said.err}"
        assert "Traceback" not in said.err, f"mutant {number} of {path.name}\n{said.err}"
        assert "\x1b" not in said.err.replace("\x1b[", ""), path.name
        codes[code] += 1
    return codes


@pytest.mark.slow
def test_mutants_of_shipped_files_are_read_or_refused(shipped, capsys) -> None:
    codes = check_mutants(shipped, 300, 0, capsys)
    assert codes[BAD_INPUT] > 100
    assert codes[0] > 20


@pytest.mark.evidence
def test_many_mutants_of_shipped_files_are_read_or_refused(shipped, capsys) -> None:
    count = int(os.environ.get("MICAH_MUTANTS", "10000"))
    codes = check_mutants(shipped, count, 1, capsys)
    with capsys.disabled():
        print(f"{count} mutants: {codes[0]} read, {codes[BAD_INPUT]} refused")
