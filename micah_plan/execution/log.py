"""Log of a run: a Recording with the belief and, where known, the true state."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.execution.plant import Measurement
from micah_plan.execution.pose import chain, components, moving_joints
from micah_plan.recording.value import DEFAULT_PART, ESTIMATE, Recording


class RunLog:
    """Collects the samples of one run of an automaton's object."""

    def __init__(self, automaton: HybridAutomaton) -> None:
        self._automaton = automaton
        self._measurements: list[Measurement] = []
        self._beliefs: list[HybridBelief] = []
        self._true: list[Floats] = []
        self._actions: list[Floats] = []

    def __len__(self) -> int:
        return len(self._beliefs)

    def add(self, measurement: Measurement, belief: HybridBelief, true_x: Floats | None, action: Floats | None) -> None:
        """Append a sample.

        Args:
            belief: after the measurement, with which the action was chosen.
            true_x: (n,) [rad or m]; None in every sample of a run if it is unknown.
            action: (l, 3) [m]; None in the run's last sample.
        """
        self._measurements.append(measurement)
        self._beliefs.append(belief)
        self._true += [] if true_x is None else [true_x]
        self._actions.append(np.full((len(self._automaton.links), 3), np.nan) if action is None else action)

    def recording(self, run: int) -> Recording:
        """The run so far as a Recording, times outermost, one row per part.

        Extra columns: ``mode`` (the most probable), per coordinate c ``belief_c`` and ``belief_std_c`` (mean and std in
        that mode) and, if it is known, ``true_c`` [rad or m], and ``estimate_x`` to ``estimate_qw``, the part's pose at
        that mean in the base frame [m].
        """
        parts = tuple(link.child for link in self._automaton.links)
        rows = len(self) * len(parts)

        def per_part(values: Sequence[Floats]) -> Floats:
            return np.asarray(values).reshape(rows, -1)

        forces = [m.force for m in self._measurements if m.force is not None]
        times = {name: tuple(v for v in values for _ in parts) for name, values in self._belief_columns().items()}
        return Recording(
            time=np.repeat([m.time for m in self._measurements], len(parts)),
            position=per_part([m.position for m in self._measurements]),
            quaternion=per_part([m.quaternion for m in self._measurements]),
            action=per_part(self._actions),
            force=per_part(forces) if len(forces) == len(self) else None,
            run=np.full(rows, run),
            part=parts * len(self),
            has_run=True,
            has_part=parts != (DEFAULT_PART,),
            extra=times | self._estimate_columns(),
        )

    def _belief_columns(self) -> dict[str, list[str]]:
        """Belief columns as strings, one per sample."""
        likely = [(belief, belief.most_likely) for belief in self._beliefs]
        columns = {"mode": [self._automaton.mode_names[q] for _, q in likely]}
        for index, name in enumerate(coordinate.name for coordinate in self._automaton.coordinates):
            columns[f"belief_{name}"] = _texts(b.means[q, index] for b, q in likely)
            columns[f"belief_std_{name}"] = _texts(float(np.linalg.norm(b.factors[q, index])) for b, q in likely)
            if len(self._true) == len(self):
                columns[f"true_{name}"] = _texts(x[index] for x in self._true)
        return columns

    def _estimate_columns(self) -> dict[str, tuple[str, ...]]:
        """Estimate columns as strings, one per sample and part."""
        automaton, poses = self._automaton, []
        for belief in self._beliefs:
            number = belief.most_likely
            joints = moving_joints(automaton, automaton.mode_names[number])
            poses.append(chain(automaton, joints, belief.means[number]))
        columns = np.hstack(components(np.concatenate(poses))).T
        return {name: tuple(_texts(column)) for name, column in zip(ESTIMATE, columns, strict=True)}


def concatenated_recordings(recordings: Sequence[Recording]) -> Recording:
    """Several recordings with the same columns, one after the other."""
    first = recordings[0]
    stacked: dict[str, Any] = {}
    for name in ("time", "position", "quaternion", "action", "force", "run"):
        values = [getattr(recording, name) for recording in recordings]
        stacked[name] = None if any(value is None for value in values) else np.concatenate(values)
    part = tuple(name for recording in recordings for name in recording.part)
    extra = {name: tuple(v for recording in recordings for v in recording.extra[name]) for name in first.extra}
    return replace(first, part=part, extra=extra, **stacked)


def _texts(values: Iterable[float]) -> list[str]:
    return [f"{float(value):.9g}" for value in values]
