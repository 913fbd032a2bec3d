"""The latest rows of a stream, in bounded memory: neighbouring rows become one where a motion is slow."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from micah_plan.arrays import Ints
from micah_plan.learn.track import PartTrack


@dataclass(frozen=True, eq=False)
class WindowRows:
    """Rows of a window, each the mean of a few measured ones, of which `last` (n,) has the last ones' numbers."""

    track: PartTrack
    last: Ints

    def __len__(self) -> int:
        return len(self.track)

    def take(self, index: slice) -> WindowRows:
        """Some of the rows."""
        return WindowRows(self.track.take(index), self.last[index])

    def coarsened(self, size: int) -> WindowRows:
        """Means of `size` rows each."""
        ends = np.minimum(np.arange(size, len(self) + size, size), len(self)) - 1
        return WindowRows(self.track.coarsened(size), self.last[ends])

    def followed_by(self, other: WindowRows) -> WindowRows:
        """These rows and later ones."""
        return WindowRows(self.track.followed_by(other.track), np.concatenate([self.last, other.last]))


class RowWindow:
    """Rows that came in and have not been dropped.

    Attributes:
        stride: measured rows that one row of the window stands for.
    """

    def __init__(self) -> None:
        self.stride = 1
        self._rows: WindowRows | None = None
        self._new: list[WindowRows] = []

    def add(self, track: PartTrack) -> None:
        """Take in measured rows."""
        self._new.append(WindowRows(track, track.rows))

    def rows(self) -> WindowRows | None:
        """What the window holds; None if nothing."""
        new = _joined(self._new)
        if new is None:
            return self._rows
        if self.stride > 1:
            new = new.coarsened(self.stride)
        return new if self._rows is None else self._rows.followed_by(new)

    def settle(self) -> WindowRows | None:
        """The same, and from now on measured rows begin a new row of the window."""
        self._rows, self._new = self.rows(), []
        return self._rows

    def coarsen(self) -> None:
        """Make one row of every two."""
        rows = self.settle()
        self._rows = None if rows is None else rows.coarsened(2)
        self.stride *= 2

    def drop(self, count: int) -> None:
        """Forget the first rows."""
        rows = self.settle()
        if rows is not None:
            kept = rows.take(slice(count, None))
            # Copies, so that what was dropped is not held by a view of it.
            self._rows = WindowRows(_copied(kept.track), kept.last.copy())


def _joined(parts: list[WindowRows]) -> WindowRows | None:
    """All parts at once: joining one by one would copy each row as often as there are parts."""
    if not parts:
        return None
    tracks = [part.track for part in parts]
    first = tracks[0]

    def column(name: str) -> NDArray[np.float64] | None:
        return None if getattr(first, name) is None else np.concatenate([getattr(one, name) for one in tracks])

    rows = np.concatenate([one.rows for one in tracks])
    time = np.concatenate([one.time for one in tracks])
    position = np.concatenate([one.position for one in tracks])
    track = PartTrack(rows, time, position, column("quaternion"), column("action"))
    return WindowRows(track, np.concatenate([part.last for part in parts]))


def _copied(track: PartTrack) -> PartTrack:
    columns = {name: getattr(track, name) for name in ("rows", "time", "position", "quaternion", "action")}
    return replace(track, **{name: value.copy() for name, value in columns.items() if value is not None})
