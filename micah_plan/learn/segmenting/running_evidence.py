"""Evidence of the open segments of a few hypotheses, row by row: what the recursion with particles needs.

Memory is (live starts × hypotheses) and a row costs as much, where the exact recursion holds all (n, n) segments.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.joint import JointKind
from micah_plan.learn.segmenting.evidence import EvidenceColumn, EvidenceTable

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class RunningEvidence:
    """Sums of densities since each live start.

    Args:
        table: densities.
        kinds: candidate kinds, in the order of the evidence's columns.
        members: hypotheses to choose among.
        paid: those whose parameters cost a segment nothing (whoever chose them pays).
    """

    def __init__(
        self, table: EvidenceTable, kinds: tuple[JointKind, ...], members: Sequence[int], paid: Collection[int] = ()
    ) -> None:
        self._table, self._members = table, np.array(members, dtype=np.int64)
        self._density = np.ascontiguousarray(table.log_density[:, :, self._members])
        names = table.pool.hypotheses.joints.kinds
        self._of_kind = [np.array([j for j, i in enumerate(members) if names[i] == kind], np.int64) for kind in kinds]
        self._paid = np.isin(self._members, list(paid))
        self._sums = np.zeros((0, len(members)))
        self.starts: Ints = np.zeros(0, dtype=np.int64)
        self.row = -1

    def __len__(self) -> int:
        return int(self._density.shape[1])

    def advance(self) -> EvidenceColumn:
        """Open a segment at the next row and take that row into all open segments."""
        self.row += 1
        self.starts = np.append(self.starts, self.row)
        known = np.minimum(self.row - self.starts, len(self._density) - 1)
        self._sums = np.concatenate([self._sums, np.zeros((1, len(self._members)))]) + self._density[known, self.row]
        total = self._sums
        if not self._paid.all():
            rows: Floats = (self.row - self.starts + 1.0)[:, None].astype(np.float64)
            total = total - np.where(self._paid, 0.0, self._table.cost(self._members, rows))
        best = np.full((len(self.starts), len(self._of_kind)), -np.inf)
        which = np.zeros(best.shape, dtype=np.int64)
        for k, of_kind in enumerate(self._of_kind):
            if len(of_kind):
                at = total[:, of_kind].argmax(axis=1)
                best[:, k] = total[np.arange(len(at)), of_kind[at]]
                which[:, k] = self._members[of_kind[at]]
        return EvidenceColumn(self.starts, best, which)

    def keep(self, index: Ints) -> None:
        """Go on with these of the open segments only (indices into the last column)."""
        self.starts, self._sums = self.starts[index], self._sums[index]
