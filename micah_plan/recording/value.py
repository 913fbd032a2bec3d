"""The recording: measured poses, applied actions and forces, in rows of runs and parts.

A demonstration and an executed run have the same type, so logs of executions can be learned from.
"""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from micah_plan.arrays import Floats, Ints
from micah_plan.errors import InputError, MissingDependencyError
from micah_plan.quantities import count, interval, quantity
from micah_plan.summaries import Summarised, aligned, listed

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform


DEFAULT_PART = "part"
_ONE_RUN: Ints = np.zeros(0, dtype=np.int64)  # represents "all rows are run 0" until the number of rows is known

ESTIMATE = tuple(f"estimate_{name}" for name in ("x", "y", "z", "qx", "qy", "qz", "qw"))
"""Extra columns with the pose that the controller believed when it chose the action; orientation may be missing."""

COLUMNS = {
    "time": ("t",),
    "position": ("x", "y", "z"),
    "quaternion": ("qx", "qy", "qz", "qw"),
    "action": ("ax", "ay", "az"),
    "force": ("fx", "fy", "fz"),
}
"""The arrays of numbers, and what text files call their columns."""


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Summarised):
    """Rows of one or several runs of one or several parts, in the order of the file.

    All arrays are read-only and have one row per sample (n rows).

    Attributes:
        time: (n,) [s], increasing within one run and part.
        position: (n, 3) [m], position of the part's origin in the base frame.
        quaternion: (n, 4) unit quaternion, scalar last, part to base; None if orientation was not measured.
        action: (n, 3) [m], base frame: displacement of the part's origin commanded from this row to the next, relative
            to the measured pose. NaN where empty (the last row of a run). None if the recording has no actions.
        force: (n, 3) [N] at the handle, NaN where empty; None if absent.
        run: (n,) integer run of each row.
        part: (n,) name of the part of each row.
        has_run, has_part: whether the file had these columns (a writer keeps what was there).
        extra: further columns by name, as the text that the file held, preserved untouched.
        conventions: of its file (`conventions.Conventions`), as texts by name.
        notes: omissions and assumptions of reading it, one line each.
    """

    time: Floats
    position: Floats
    quaternion: Floats | None = None
    action: Floats | None = None
    force: Floats | None = None
    run: Ints = field(default_factory=lambda: _ONE_RUN)
    part: tuple[str, ...] = ()
    has_run: bool = False
    has_part: bool = False
    extra: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    conventions: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.time)
        if self.run is _ONE_RUN:
            object.__setattr__(self, "run", np.zeros(n, dtype=np.int64))
        if not self.part:
            object.__setattr__(self, "part", (DEFAULT_PART,) * n)
        for name, columns in {**COLUMNS, "run": ("run",)}.items():
            value = getattr(self, name)
            if value is None:
                continue
            array = np.array(value, dtype=np.int64 if name == "run" else np.float64)
            expected = (n, len(columns)) if len(columns) > 1 else (n,)
            if array.shape != expected:
                raise InputError(f"Recording.{name} must have shape {expected}. Got {array.shape}")
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        if len(self.part) != n or any(len(column) != n for column in self.extra.values()):
            raise InputError(f"Recording.part and every extra column must have {n} rows")

    def __len__(self) -> int:
        return len(self.time)

    def summary(self) -> str:
        """Rows, runs, parts, time, extent and recorded columns, in a few lines."""
        columns = (("orientation", self.quaternion), ("actions", self.action), ("forces", self.force))
        with_them = [name for name, array in columns if array is not None]
        rows = count(len(self), "row") + (f" in {count(len(self.runs), 'run')}" if len(self.runs) > 1 else "")
        if not len(self):
            return "Recording of no rows"
        size = np.ptp(self.position, axis=0)
        return aligned(
            f"Recording of {rows}",
            {
                "parts": listed(self.parts),
                "time": f"{interval(float(self.time.min()), float(self.time.max()), 's')}",
                "moves over": f"{' x '.join(quantity(float(side), 'm') for side in size)} (x, y, z)",
                "with": ", ".join(with_them) or "positions only",
                "columns": listed(tuple(self.extra)),
            },
        )

    @cached_property
    def runs(self) -> tuple[int, ...]:
        """Run numbers in order of first appearance."""
        return tuple(dict.fromkeys(int(r) for r in self.run))

    @cached_property
    def parts(self) -> tuple[str, ...]:
        """Part names in order of first appearance."""
        return tuple(dict.fromkeys(self.part))

    @property
    def has_orientation(self) -> bool:
        return self.quaternion is not None

    @property
    def has_actions(self) -> bool:
        return self.action is not None

    def poses(self) -> RigidTransform:
        """(n,) poses of the parts in the base frame; identity orientation if not measured."""
        from scipy.spatial.transform import RigidTransform, Rotation

        rotation = Rotation.identity(len(self)) if self.quaternion is None else Rotation.from_quat(self.quaternion)
        return RigidTransform.from_components(self.position, rotation)

    def believed(self) -> Recording | None:
        """The rows with the controller's estimated poses, NaN where empty; None without such columns.

        Raises:
            InputError: if one of their values is no number.
        """
        if any(name not in self.extra for name in ESTIMATE[:3]):
            return None
        names = [name for name in ESTIMATE if name in self.extra]
        values = np.array([[self._number(name, row) for name in names] for row in range(len(self))])
        turned = values[:, 3:] if names == list(ESTIMATE) else None
        return replace(self, position=values[:, :3], quaternion=turned)

    def _number(self, name: str, row: int) -> float:
        """The number in a further column, NaN if empty."""
        text = self.extra[name][row].strip()
        try:
            return float(text) if text else float("nan")
        except ValueError:
            raise InputError(f"column {name}, row {row + 1}: expected a number. Got {text!r}") from None

    def rows(self, index: Any) -> Recording:
        """The rows that a NumPy index (integers, slice or booleans) selects, in that order."""
        chosen = np.arange(len(self))[index]
        columns: dict[str, Any] = {name: getattr(self, name) for name in (*COLUMNS, "run")}
        arrays: dict[str, Any] = {name: None if array is None else array[chosen] for name, array in columns.items()}
        return replace(
            self,
            **arrays,
            part=tuple(self.part[i] for i in chosen),
            extra={name: tuple(column[i] for i in chosen) for name, column in self.extra.items()},
        )

    def select(self, *, run: int | None = None, part: str | None = None) -> Recording:
        """The rows of one run and/or one part.

        Raises:
            InputError: if there are no such rows.
        """
        index = self.index(run=run, part=part)
        if not len(index):
            raise InputError(f"no rows of run {run} and part {part}; runs: {self.runs}, parts: {self.parts}")
        return self.rows(index)

    def index(self, *, run: int | None = None, part: str | None = None) -> Ints:
        """The numbers of the rows of one run and/or one part, from 0."""
        if run is None and part is None:
            return np.arange(len(self))
        return self._numbers.get((run, part), np.zeros(0, dtype=int))

    @cached_property
    def _numbers(self) -> dict[tuple[int | None, str | None], Ints]:
        """Row indices by run, by part, and by both, computed together for files with thousands of runs."""
        lists: dict[tuple[int | None, str | None], list[int]] = defaultdict(list)
        for i, (run, part) in enumerate(zip(self.run.tolist(), self.part, strict=True)):
            for key in ((run, None), (None, part), (run, part)):
                lists[key].append(i)
        return {key: np.array(numbers) for key, numbers in lists.items()}

    def columns(self) -> dict[str, Any]:
        """Arrays and texts by the names of the columns of a recording CSV, as ``pandas.DataFrame`` takes them."""
        columns: dict[str, Any] = {"run": self.run} if self.has_run else {}
        columns |= {"part": list(self.part)} if self.has_part else {}
        for field_name, names in COLUMNS.items():
            array = getattr(self, field_name)
            if array is not None:
                columns |= dict(zip(names, np.atleast_2d(array.T), strict=True))
        return columns | {name: list(texts) for name, texts in self.extra.items()}

    def to_pandas(self) -> Any:
        """The rows as a ``pandas.DataFrame`` with the columns of a recording CSV.

        Raises:
            MissingDependencyError: if pandas is not installed.
        """
        try:
            import pandas
        except ImportError:
            raise MissingDependencyError("a data frame needs pandas: pip install pandas") from None
        return pandas.DataFrame(self.columns())

    def digest(self) -> str:
        """SHA-256 of the content (not of the file's formatting), for provenance."""
        parts = [repr(self.part), repr(sorted(self.extra.items()))]
        arrays = (self.time, self.position, self.quaternion, self.action, self.force, self.run)
        blob = b"|".join(b"-" if a is None else np.ascontiguousarray(a).tobytes() for a in arrays)
        return hashlib.sha256(blob + "|".join(parts).encode()).hexdigest()
