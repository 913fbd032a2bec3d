"""Evidence of the open segments of a few hypotheses, row by row: what the recursion with particles needs.

Memory is (live starts × hypotheses) and a row costs as much, where the exact recursion holds all (n, n) segments.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from micah_plan.arrays import Floats, Ints
from micah_plan.automaton.joint import JointKind
from micah_plan.learn.segmenting.evidence import EvidenceColumn, EvidenceTable


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
        names = table.pool.hypotheses.joints.kinds
        of_kind = [[i for i in members if names[i] == kind] for kind in kinds]
        self._members = np.array([i for one in of_kind for i in one], dtype=np.int64)
        ends = np.cumsum([len(one) for one in of_kind])
        self._of_kind = [slice(end - len(one), end) for one, end in zip(of_kind, ends, strict=True)]
        # Rows by rows known before them; what those of a young segment differ by from the others.
        density = table.log_density[:, :, self._members]
        self._density, self._young = np.ascontiguousarray(density[-1]), density[:-1] - density[-1]
        self._cost: Floats | None = None
        if not set(members) <= set(paid):
            lengths = np.arange(1.0, len(self) + 1)[:, None]
            self._cost = np.where(np.isin(self._members, list(paid)), 0.0, table.cost(self._members, lengths)).T
        self._sums = np.zeros((len(self._members), 0))
        self.starts: Ints = np.zeros(0, dtype=np.int64)
        self.row = -1

    def __len__(self) -> int:
        return len(self._density)

    def advance(self) -> EvidenceColumn:
        """Open a segment at the next row and take that row into all open segments."""
        self.row += 1
        self.starts = np.concatenate([self.starts, [self.row]])
        live = len(self.starts)
        density = self._density[self.row][:, None]
        sums = np.empty((len(self._members), live))
        np.add(self._sums, density, out=sums[:, :-1])
        sums[:, -1:] = density
        young = self.starts[max(live - len(self._young), 0) :]
        young = young[young > self.row - len(self._young)]
        if len(young):
            sums[:, live - len(young) :] += self._young[self.row - young, self.row].T
        self._sums = sums
        total = sums if self._cost is None else sums - self._cost.take(self.row - self.starts, axis=1)
        best = np.full((len(self._of_kind), live), -np.inf)
        for row, of_kind in zip(best, self._of_kind, strict=True):
            if of_kind.start < of_kind.stop:
                total[of_kind].max(axis=0, out=row)

        def hypothesis(i: int, kind: int) -> int:
            own = self._of_kind[kind]
            return int(self._members[own.start + int(total[own, i].argmax())])

        return EvidenceColumn(self.starts, best.T, hypothesis)

    def keep(self, index: Ints) -> None:
        """Go on with these of the open segments only (indices into the last column)."""
        self.starts, self._sums = self.starts[index], self._sums[:, index]
