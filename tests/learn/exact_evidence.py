"""The evidence of all segments as a stream: what the recursions and the running evidence are compared with."""

from __future__ import annotations

import numpy as np

from micah_plan.automaton.joint import JointKind
from micah_plan.learn.segmenting.evidence import EvidenceColumn, EvidenceTable


class ExactEvidence:
    """Evidence of all segments of a track, given out row by row as a stream's is: the reference for both recursions.

    Args:
        table: densities; every segment pays for the parameters of its joint.
        kinds: candidate kinds, in the order of the evidence's columns.
    """

    def __init__(self, table: EvidenceTable, kinds: tuple[JointKind, ...]) -> None:
        names = table.pool.hypotheses.joints.kinds
        members = [np.flatnonzero([name == kind for name in names]) for kind in kinds]
        n = table.log_density.shape[1]
        charged = np.stack([table.charged(i) for i in range(len(table.rows))], axis=2)
        self._best = np.full((n, n, len(kinds)), -np.inf)
        self._which = np.zeros((n, n, len(kinds)), dtype=np.int64)
        for column, of_kind in enumerate(members):
            if len(of_kind):
                evidence = charged[:, :, of_kind]
                self._best[:, :, column] = evidence.max(axis=2)
                self._which[:, :, column] = of_kind[np.argmax(evidence, axis=2)]
        self.starts = np.zeros(0, dtype=np.int64)
        self.row = -1

    def __len__(self) -> int:
        return len(self._best)

    def advance(self) -> EvidenceColumn:
        """Open a segment at the next row and take that row into all open segments."""
        self.row += 1
        self.starts = np.append(self.starts, self.row)
        which = self._which[self.starts, self.row]
        return EvidenceColumn(self.starts, self._best[self.starts, self.row], lambda i, kind: int(which[i, kind]))

    def keep(self, index: np.ndarray) -> None:
        """Go on with these of the open segments only (indices into the last column)."""
        self.starts = self.starts[index]
