"""The log of a run: a Recording with what was believed and, if somebody knows, what was true beside the poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.execution.plant import Measurement
from micah_plan.execution.pose import chain, components, moving_joints
from micah_plan.recording.value import DEFAULT_PART, Recording

Floats = NDArray[np.float64]

ESTIMATE = tuple(f"estimate_{name}" for name in ("x", "y", "z", "qx", "qy", "qz", "qw"))


@dataclass(frozen=True, eq=False)
class _Sample:
    """One time: what was measured, believed and true, and the action (l, 3) [m] then commanded (NaN: none)."""

    measurement: Measurement
    belief: HybridBelief
    true_x: Floats | None
    action: Floats


@dataclass(eq=False)
class RunLog:
    """Collects the samples of one run of an automaton's object."""

    automaton: HybridAutomaton
    _samples: list[_Sample] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self._samples)

    def add(self, measurement: Measurement, belief: HybridBelief, true_x: Floats | None, action: Floats | None) -> None:
        """A sample.

        Args:
            belief: after the measurement: what the action was chosen with.
            true_x: (n,) [rad or m]; None in every sample of a run: nobody knows.
            action: (l, 3) [m]; None in the run's last sample.
        """
        empty = np.full((len(self.automaton.links), 3), np.nan)
        self._samples.append(_Sample(measurement, belief, true_x, empty if action is None else action))

    def recording(self, run: int) -> Recording:
        """The run so far as a Recording, times outermost, one row per part.

        Extra columns: ``mode`` (the most probable), per coordinate c ``belief_c`` and ``belief_std_c`` (mean and std in
        that mode) and, if it is known, ``true_c`` [rad or m], and ``estimate_x`` to ``estimate_qw``, the part's pose at
        that mean in the base frame [m].
        """
        parts = tuple(link.child for link in self.automaton.links)
        rows = len(self._samples) * len(parts)

        def per_part(values: Sequence[Floats]) -> Floats:
            return np.asarray(values).reshape(rows, -1)

        measurements = [sample.measurement for sample in self._samples]
        forces = [m.force for m in measurements if m.force is not None]
        times = {name: tuple(v for v in values for _ in parts) for name, values in self._belief_columns().items()}
        return Recording(
            time=np.repeat([m.time for m in measurements], len(parts)),
            position=per_part([m.position for m in measurements]),
            quaternion=per_part([m.quaternion for m in measurements]),
            action=per_part([sample.action for sample in self._samples]),
            force=per_part(forces) if len(forces) == len(measurements) else None,
            run=np.full(rows, run),
            part=parts * len(self._samples),
            has_run=True,
            has_part=parts != (DEFAULT_PART,),
            extra=times | self._estimate_columns(),
        )

    def _belief_columns(self) -> dict[str, list[str]]:
        """One text per sample."""
        modes = self.automaton.mode_names
        columns: dict[str, list[str]] = {"mode": [modes[sample.belief.most_likely] for sample in self._samples]}
        for index, coordinate in enumerate(self.automaton.coordinates):
            beliefs = [(sample.belief, sample.belief.most_likely) for sample in self._samples]
            columns[f"belief_{coordinate.name}"] = [_text(b.means[q, index]) for b, q in beliefs]
            deviations = [float(np.linalg.norm(b.factors[q, index])) for b, q in beliefs]
            columns[f"belief_std_{coordinate.name}"] = [_text(value) for value in deviations]
            true = [_text(sample.true_x[index]) for sample in self._samples if sample.true_x is not None]
            if len(true) == len(self._samples):
                columns[f"true_{coordinate.name}"] = true
        return columns

    def _estimate_columns(self) -> dict[str, tuple[str, ...]]:
        """One text per sample and part."""
        automaton, modes = self.automaton, self.automaton.mode_names
        poses = []
        for belief in (sample.belief for sample in self._samples):
            number = belief.most_likely
            poses.append(chain(automaton, moving_joints(automaton, modes[number]), belief.means[number]))
        columns = np.hstack(components(np.concatenate(poses))).T
        return {name: tuple(map(_text, column)) for name, column in zip(ESTIMATE, columns, strict=True)}


def concatenated(recordings: Sequence[Recording]) -> Recording:
    """Several recordings with the same columns, one after the other."""
    first = recordings[0]

    def stack(name: str) -> Floats | None:
        values = [getattr(recording, name) for recording in recordings]
        return None if any(value is None for value in values) else np.concatenate(values)

    return Recording(
        time=np.concatenate([recording.time for recording in recordings]),
        position=np.concatenate([recording.position for recording in recordings]),
        quaternion=stack("quaternion"),
        action=stack("action"),
        force=stack("force"),
        run=np.concatenate([recording.run for recording in recordings]),
        part=tuple(name for recording in recordings for name in recording.part),
        has_run=first.has_run,
        has_part=first.has_part,
        extra={name: tuple(v for recording in recordings for v in recording.extra[name]) for name in first.extra},
    )


def _text(value: float) -> str:
    return f"{float(value):.9g}"
