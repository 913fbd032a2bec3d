"""Work folders: their files in the order of the workflow, and the next step."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from micah_plan.api.files import Loaded, load
from micah_plan.api.planning import PlanningResult
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.documents.kind import kind_of
from micah_plan.errors import InputError, MicahError
from micah_plan.exchange.convert import READABLE
from micah_plan.output_files import PAGE
from micah_plan.recording.value import Recording
from micah_plan.task.problem import Problem

if TYPE_CHECKING:
    from micah_plan.view.page import Status

Group = Literal["recordings", "models", "problems", "plans", "runs", "others"]
GROUPS: tuple[Group, ...] = ("recordings", "models", "problems", "plans", "runs", "others")
"""In the order in which work goes on."""

# A text may be anything, so trajectories are only those of their own ending.
_SUFFIXES = (".yaml", ".yml", ".json", *(suffix for suffix in READABLE if suffix != ".txt"))
_NOT_A_PLAN = ".timings.json"
# Files that are read, and bytes of the largest: what is larger is named without being read.
_MOST_FILES, _MOST_BYTES = 200, 50_000_000


@dataclass(frozen=True, eq=False)
class FileInFolder:
    """A file of a folder.

    Attributes:
        file: where it is.
        group: its role in the work.
        words: its main facts or errors, in a few lines.
        value: its content; None: it cannot be used, or is too large to be read here.
        pages: of it, in the same folder.
    """

    file: Path
    group: Group
    words: str
    value: Loaded | None
    pages: tuple[Path, ...] = ()


@dataclass(frozen=True, eq=False)
class Folder:
    """Contents of a folder.

    Attributes:
        folder: where it is.
        files: sorted by name, those of work.
        pages: that belong to no file.
        step: the next command with its reason; empty if there is none.
    """

    folder: Path
    files: tuple[FileInFolder, ...]
    pages: tuple[Path, ...]
    step: tuple[str, str]

    def of(self, group: Group) -> tuple[FileInFolder, ...]:
        """The files of a group."""
        return tuple(each for each in self.files if each.group == group)


def read_folder(folder: Path, without: Sequence[Path] = ()) -> Folder:
    """The contents of a folder, without subfolders.

    Args:
        without: files that are left out, as the page that is to be written.

    Raises:
        InputError: if it holds no file that the package reads, or too many.
    """
    left_out = {path.resolve() for path in without}
    paths = [path for path in sorted(folder.iterdir()) if path.is_file() and path.resolve() not in left_out]
    pages = [path for path in paths if path.suffix.lower() in PAGE]
    wanted = [p for p in paths if p.name.lower().endswith(_SUFFIXES) and not p.name.endswith(_NOT_A_PLAN)]
    if not wanted:
        raise InputError(
            "the folder has no recording, model, problem or plan", source=folder, remedy="name another, or a file"
        )
    if len(wanted) > _MOST_FILES:
        problem = f"expected at most {_MOST_FILES} files, found {len(wanted)}"
        raise InputError(problem, source=folder, remedy="show a folder of one piece of work")
    files = tuple(_file_in_folder(path, [page for page in pages if page.stem == path.stem]) for path in wanted)
    known = {page for each in files for page in each.pages}
    return Folder(folder, files, tuple(page for page in pages if page not in known), _next_step(files))


def _file_in_folder(path: Path, pages: Sequence[Path]) -> FileInFolder:
    if path.stat().st_size > _MOST_BYTES:
        words = f"{path.stat().st_size / 1e6:,.0f} MB, not read here"
        return FileInFolder(path, "others", words, None, tuple(pages))
    try:
        kind, value = kind_of(path), None
        if kind in ("recording", "model", "problem", "plan", "sweep", "experiment", "parts"):
            value = load(path)
        words = str(value) if isinstance(value, Recording | HybridAutomaton | Problem | PlanningResult) else kind
    except MicahError as error:  # one that cannot be used, or needs a library that is not there
        return FileInFolder(path, "others", str(error), None, tuple(pages))
    return FileInFolder(path, _group_of(value), words, value, tuple(pages))


def _group_of(value: Loaded | None) -> Group:
    if isinstance(value, Recording):
        # Columns that executions add to the poses.
        return "runs" if any(name.startswith("belief_") for name in value.extra) else "recordings"
    groups: Mapping[type, Group] = {HybridAutomaton: "models", Problem: "problems", PlanningResult: "plans"}
    return groups.get(type(value), "others")


def page_of(found: Folder, title: str = "") -> str:
    """The page of a folder, with links to the pages in it."""
    from micah_plan.view.folder_page import Card, folder_page

    cards = []
    for group in GROUPS:
        own = []
        for each in found.of(group):
            badge: tuple[str, Status] | None = None
            if isinstance(each.value, PlanningResult):
                badge = each.value.outcome.replace("_", " "), "good" if each.value.success else "bad"
            own.append(Card(each.file.name, each.words, badge, tuple(page.name for page in each.pages)))
        cards.append((group.capitalize(), own))
    title = title or found.folder.resolve().name
    return folder_page(title, cards, [page.name for page in found.pages], found.step)


def _next_step(files: Sequence[FileInFolder]) -> tuple[str, str]:
    """The next command of the workflow, with its reason."""
    last: dict[Group, FileInFolder] = {each.group: each for each in files if each.value is not None}

    def command(*words: str | Path) -> str:
        return shlex.join(["micah-plan", *(word.name if isinstance(word, Path) else word for word in words)])

    if "runs" in last and "models" in last:
        runs = last["runs"].file
        better = [each for each in files if isinstance(each.value, HybridAutomaton) and each.value.effects]
        if better:
            asked = command("predict", better[-1].file, runs)
            return asked, "see how well the calibrated model predicts what was measured"
        asked = command("calibrate", last["models"].file, runs, "-o", "better.yaml")
        return asked, "compare the model with what was measured, and add what it lacks"
    if "plans" in last:
        plan = last["plans"]
        if isinstance(plan.value, PlanningResult) and not plan.value.success:
            return command("explain", plan.file), "hear what stands in the way of the plan"
        return command("execute", plan.file, "-o", "runs.csv"), "execute the plan in simulation"
    if "problems" in last:
        return command("solve", last["problems"].file, "-o", "plan.json"), "make a plan"
    if "models" in last:
        return command("new", "problem", "task", "--model", last["models"].file), "ask for a motion of the model"
    if "recordings" in last:
        asked = command("learn", last["recordings"].file, "-o", "model.yaml", "--html", "model.html")
        return asked, "learn a model from the recording"
    return "", ""
