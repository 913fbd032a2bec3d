"""Plans and recordings that say nonsense: each is refused or told, and unusual ones that make sense are neither."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nonsense_corpus import CORPUS
from test_nonsense import EXPLAINED, MODELS, PROBLEMS

from micah_plan import solve
from micah_plan.checking import FileCheck, check_file
from micah_plan.documents.plan import plan_text
from micah_plan.documents.problem import load_problem

ROOT = Path(__file__).resolve().parents[2]
Change = Callable[[Any], Any]
Rows = list[list[str]]


def always(value: Any) -> Change:
    return lambda _: value


# What is changed in a plan, by its key, and into what.
_T = "trajectory"
PLANS: dict[str, tuple[str, Change]] = {
    "more than sure": ("success_probability", always(1.7)),
    "less than never": ("success_probability", always(-0.2)),
    "solved and unlikely": ("success_probability", always(0.1)),
    "a share of nothing": ("verification_trials", always(0)),
    "less than no trials": ("verification_trials", always(-5)),
    "half a trial": ("verification_trials", always(0.5)),
    "interval inside out": ("success_interval", always([0.9, 0.1])),
    "interval beside its value": ("success_interval", always([0.1, 0.2])),
    "gains of a rocket": (f"{_T}.gains.3", always([[1e9]])),
    "gains the other way": (f"{_T}.gains.0", always([[-5e4]])),
    "gains of two inputs": (f"{_T}.gains.0", always([[1.0, 2.0]])),
    "an input of seven metres": (f"{_T}.inputs.4", always([7.0])),
    "an input of no world": (f"{_T}.inputs.4", always([1e300])),
    "fewer inputs": (f"{_T}.inputs", lambda rows: rows[:-2]),
    "a mean that leaps": (f"{_T}.means.5", always([9.0])),
    "a start elsewhere": (f"{_T}.means.0", always([0.2])),
    "an end out of range": (f"{_T}.means.13", always([55.0])),
    "an end elsewhere": (f"{_T}.means.13", always([0.05])),
    "a factor inside out": (f"{_T}.factors.2", always([[-1e-3]])),
    "a belief as wide as a town": (f"{_T}.factors.2", always([[1e4]])),
    "a factor of two coordinates": (f"{_T}.factors.0", always([[0.1, 0.0], [0.0, 0.1]])),
    "a mode of nobody": (f"{_T}.modes.2", always("frozen")),
    "an empty trajectory": (_T, lambda old: {key: [] for key in old}),
    "no trajectory": (_T, always(None)),
    "a distance of a town": ("goal_error", always(3000.0)),
    "a negative distance": ("goal_error", always(-0.1)),
    "a spread of a town": ("goal_std", always(3000.0)),
    "a spread of nothing": ("goal_std", always(0.0)),
    "a cost of nan": ("cost", always(float("nan"))),
    "a negative cost": ("cost", always(-3.0)),
    "another sequence": ("mode_sequence", always(["frozen"])),
    "an empty sequence": ("mode_sequence", always([])),
    "an outcome of nobody": ("outcome", always("perfect")),
    "no plan with a plan": ("outcome", always("no_plan")),
    "a negative seed": ("seed", always(-4)),
    "a candidate of nobody": ("candidates.0.modes", always(["frozen"])),
    "a candidate that earns": ("candidates.0.search_cost", always(-8.0)),
    "a candidate of words": ("candidates.0.cost", always("cheap")),
    "findings of numbers": ("findings", always([1, 2])),
    "a reason of several": ("reason", always(["a", "b"])),
    "a digest of words": ("digests.model", always("as before")),
    "a joint without an axis": ("model.modes.prismatic.joints.drawer.axis", always([0, 0, 0])),
    "a tracker of 100 m": ("model.noise.observation_std.drawer", always(100.0)),
    "sure beyond one": ("problem.confidence", always(95)),
    "a goal out of reach": ("problem.goal.target.drawer.value", always(90.0)),
    "steps of rounding": ("problem.planner.max_step.drawer", always(1e-9)),
}
# The model has a transition from its only mode to itself, so a step may say that it takes it.
PLANS_EXPLAINED = {"every step is a transition": (f"{_T}.is_transition", lambda steps: [True] * len(steps))}
UNUSUAL_PLANS: dict[str, tuple[str, Change]] = {
    "no feedback": (f"{_T}.gains", lambda gains: [[[0.0]]] * len(gains)),
    "no candidates": ("candidates", always([])),
    "nothing cost anything": ("cost", always(0.0)),
    "another reason": ("reason", always("by hand")),
}


def each(columns: str, change: Callable[[float, int], Any]) -> Callable[[list[str], Rows], None]:
    """Changes every number of some columns, given the number of its row."""

    def apply(header: list[str], rows: Rows) -> None:
        for name in columns.split(","):
            place = header.index(name)
            for i, row in enumerate(rows):
                if row[place]:
                    row[place] = str(change(float(row[place]), i))

    return apply


def rows_of(change: Callable[[Rows], Rows]) -> Callable[[list[str], Rows], None]:
    def apply(_: list[str], rows: Rows) -> None:
        rows[:] = change(rows)

    return apply


def new_column(name: str, values: Callable[[int], str]) -> Callable[[list[str], Rows], None]:
    def apply(header: list[str], rows: Rows) -> None:
        header.append(name)
        for i, row in enumerate(rows):
            row.append(values(i))

    return apply


def renamed(old: str, new: str) -> Callable[[list[str], Rows], None]:
    def apply(header: list[str], _: Rows) -> None:
        header[header.index(old)] = new

    return apply


def named(name: Callable[[int], str]) -> Callable[[list[str], Rows], None]:
    def apply(_: list[str], rows: Rows) -> None:
        for i, row in enumerate(rows):
            row[0] = name(i)

    return apply


_P, _Q, _A, _F = "x,y,z", "qx,qy,qz,qw", "ax,ay,az", "fx,fy,fz"


def at_random(i: int) -> int:
    """Between -50 and 50, another one in every row."""
    return (i * 7919) % 101 - 50


RECORDINGS = {
    "time backwards": each("t", lambda t, _: -t),
    "time that stands": each("t", lambda *_: 0.0),
    "time in ms": each("t", lambda t, _: 1e3 * t),
    "time in ns": each("t", lambda t, _: 1e9 * t),
    "time in days": each("t", lambda t, _: t / 86400 / 10),
    "rows of a nanosecond": each("t", lambda _, i: 1e-9 * i),
    "a clock that was set": each("t", lambda t, i: t + 1e6 * (i > 40)),
    "time of nobody": renamed("t", "time_of_nobody"),
    "millimetres": each(_P, lambda x, _: 1e3 * x),
    "micrometres": each(_P, lambda x, _: 1e6 * x),
    "another town": each("x", lambda x, _: x + 1e5),
    "another galaxy": each("x", lambda *_: 1e300),
    "words for places": each("x", lambda *_: "far"),
    "one word": each("x", lambda x, i: "oops" if i == 5 else x),
    "one infinite": each("y", lambda y, i: "inf" if i == 3 else y),
    "a kilometre for a row": each("x", lambda x, i: x + 1000 * (i == 20)),
    "noise of 100 m": each(_P, lambda _, i: 2.0 * at_random(i)),
    "noise of a metre": each(_P, lambda _, i: 0.02 * at_random(i)),
    "no turn": each(_Q, lambda *_: 0.0),
    "ten times a turn": each(_Q, lambda q, _: 10 * q),
    "turns in degrees": each(_Q, lambda q, _: 90 * q),
    "one without a turn": each(_Q, lambda q, i: q * (i != 9)),
    "no scalar": each("qw", lambda *_: 0.0),
    "actions in mm": each(_A, lambda a, _: 1e3 * a),
    "actions in Gm": each(_A, lambda a, _: 1e-9 * a),
    "actions are places": each(_A, lambda a, _: 50 * a + 0.5),
    "actions of nobody": each("ax", lambda *_: "nan"),
    "the force of a rocket": each(_F, lambda *_: 1e9),
    "forces in mN": each(_F, lambda f, _: 1e5 * f),
    "no rows": rows_of(lambda _: []),
    "one row": rows_of(lambda rows: rows[:1]),
    "rows twice": rows_of(lambda rows: rows + rows),
    "rows from the end": rows_of(lambda rows: rows[::-1]),
    "rows in pairs exchanged": rows_of(lambda rows: [rows[i ^ 1] for i in range(len(rows) - 1)]),
    "no name": named(lambda _: ""),
    "a name per row": named(lambda i: f"p{i}"),
    "x twice": new_column("x", lambda _: "0.1"),
    "no x": renamed("x", "xx"),
    "a short row": rows_of(lambda rows: [row[: -1 if i == 7 else None] for i, row in enumerate(rows)]),
    "a long row": rows_of(lambda rows: [[*row, *["1"] * (i == 7)] for i, row in enumerate(rows)]),
    "runs of words": new_column("run", lambda _: "first"),
    "half a run": new_column("run", lambda _: "1.5"),
    "a run before the first": new_column("run", lambda i: str(i // 40 - 1e20)),
}
UNUSUAL_RECORDINGS = {
    "runs numbered down": new_column("run", lambda i: str(9 - i // 20)),
    "two rows": rows_of(lambda rows: rows[:2]),
    "a part that stands still": rows_of(lambda rows: [[row[0], row[1], *rows[0][2:9], *row[9:]] for row in rows]),
    "another name": named(lambda _: "the left door"),
    "another column": new_column("remark", lambda i: f"row {i}"),
    "a slow recorder": each("t", lambda t, _: 30 * t),
    "never pushed": each(_A, lambda *_: 0.0),
    "a weak motor": each(_A, lambda a, _: 20 * a),
    "a hand that gains a hundredfold": each(_A, lambda a, _: 0.01 * a),
    "a recorder of 50 kHz": each("t", lambda _, i: 2e-5 * i),
    "a press": each(_F, lambda f, _: 9e3 / 2.0 * np.sign(f)),
}


@pytest.fixture(scope="module")
def plan() -> dict[str, Any]:
    problem = load_problem(ROOT / "problems" / "drawer_open.yaml")
    content: dict[str, Any] = json.loads(plan_text(solve(problem).plan, problem))
    return content


def checked_plan(plan: dict[str, Any], folder: Path, key: str, change: Change) -> FileCheck:
    """A plan with one value changed, and its digest as if it had been written so."""
    data = inner = deepcopy(plan)
    *way, last = (int(part) if part.isdigit() else part for part in key.split("."))
    for part in way:
        inner = inner[part]
    inner[last] = change(inner[last])
    content = {key: value for key, value in data.items() if key != "digest"}
    data["digest"] = hashlib.sha256(json.dumps(content, separators=(",", ":")).encode()).hexdigest()
    path = folder / "plan.json"
    path.write_text(json.dumps(data))
    return check_file(path)


def checked_recording(folder: Path, change: Callable[[list[str], Rows], None]) -> FileCheck:
    header, *rows = (line.split(",") for line in (ROOT / "examples/demonstrations/microwave.csv").read_text().split())
    change(header, rows)
    path = folder / "recording.csv"
    path.write_text("\n".join(",".join(row) for row in [header, *rows]) + "\n")
    return check_file(path)


def is_told(found: FileCheck) -> bool:
    """Whether something is said of a file, each in one line with the file or the place."""
    for fault in found.faults:
        line = str(fault)
        assert len(line.splitlines()) == 1
        assert line.startswith(str(found.file))
    return bool(found.faults or found.warnings)


@pytest.mark.parametrize("case", PLANS)
def test_a_nonsensical_plan_is_refused_or_reported(plan: dict[str, Any], tmp_path: Path, case: str) -> None:
    found = checked_plan(plan, tmp_path, *PLANS[case])
    assert is_told(found)
    assert not any("digest: the content" in str(fault) for fault in found.faults)


@pytest.mark.parametrize("case", UNUSUAL_PLANS | PLANS_EXPLAINED)
def test_an_unusual_plan_can_be_used(plan: dict[str, Any], tmp_path: Path, case: str) -> None:
    assert not is_told(checked_plan(plan, tmp_path, *(UNUSUAL_PLANS | PLANS_EXPLAINED)[case]))


@pytest.mark.parametrize("case", RECORDINGS)
def test_a_nonsensical_recording_is_refused_or_reported(tmp_path: Path, case: str) -> None:
    assert is_told(checked_recording(tmp_path, RECORDINGS[case]))


@pytest.mark.parametrize("case", UNUSUAL_RECORDINGS)
def test_an_unusual_recording_can_be_used(tmp_path: Path, case: str) -> None:
    found = checked_recording(tmp_path, UNUSUAL_RECORDINGS[case])
    assert not found.faults
    assert not any("units" in line or "read in" in line for line in found.warnings)


def test_the_page_on_untrusted_files_counts_the_corpus() -> None:
    taken = len(EXPLAINED) + len(PLANS_EXPLAINED)
    edits = sum(map(len, (CORPUS, MODELS, PROBLEMS, PLANS, PLANS_EXPLAINED, RECORDINGS)))
    unusual = len(UNUSUAL_PLANS) + len(UNUSUAL_RECORDINGS)
    page = " ".join((ROOT / "docs/reference/untrusted_files.md").read_text().split())
    assert f"in {edits} ways that make no sense: {edits - taken} are refused or told, {taken} are taken" in page
    assert f"so are {unusual} unusual plans and recordings" in page
