"""Joints as arrays: h joints of any kinds, one row each, for batched comparison, motion and fits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from micah_plan.arrays import Booleans, Floats
from micah_plan.automaton.joint import KINDS, Joint, JointKind, twisting
from micah_plan.learning.joints.quaternions import (
    rotated,
    rotation_quaternion,
    times,
)


@dataclass(frozen=True, eq=False)
class JointArrays:
    """h joints.

    Attributes:
        kinds: (h,) kinds.
        axis, center, position: (h, 3) unit vector, a point of the axis [m] and origin at configuration 0 [m].
        quaternion: (h, 4) orientation at configuration 0, scalar last.
        pitch: (h,) [m/rad]; 0 unless screw.
    """

    kinds: tuple[JointKind, ...]
    axis: Floats
    center: Floats
    position: Floats
    quaternion: Floats
    pitch: Floats

    def __len__(self) -> int:
        return len(self.kinds)

    @cached_property
    def moving(self) -> Booleans:
        """(h,) whether each joint is not rigid."""
        return np.array([KINDS[kind].moves for kind in self.kinds], dtype=bool)

    @cached_property
    def turning(self) -> Booleans:
        """(h,) whether each joint rotates."""
        return np.array([KINDS[kind].turns for kind in self.kinds], dtype=bool)

    @cached_property
    def twisting(self) -> Booleans:
        """(h,) whether each joint has a pitch."""
        return np.array([KINDS[kind].climbs for kind in self.kinds], dtype=bool)

    def take(self, index: Sequence[int] | NDArray[np.int64]) -> JointArrays:
        """The joints with these indices."""
        i = np.asarray(index, dtype=np.int64)
        kinds = tuple(self.kinds[j] for j in i)
        return JointArrays(kinds, self.axis[i], self.center[i], self.position[i], self.quaternion[i], self.pitch[i])

    def joint(self, i: int) -> Joint:
        """Joint i."""
        fixed = self.axis[i], self.center[i], float(self.pitch[i])
        return twisting(self.kinds[i], *fixed, self.position[i], self.quaternion[i])

    def moved(self, step: Floats) -> JointArrays:
        """The joints moved by (h, 13): a base-side and a part-side displacement (6 each) and a change of pitch.

        A displacement is a rotation vector about the base's origin and a translation; those of the base side carry
        the axis along, those of the part side act first and move only the part's origin.
        """
        base, part = rotation_quaternion(np.stack([step[:, :3], step[:, 6:9]]))
        origin = rotated(part, self.position) + step[:, 9:12]
        # Of every joint: its axis, a point of it and its origin, carried along by the base side.
        carried = rotated(base, np.stack([self.axis, self.center, origin]))
        axis = carried[0] / np.where(self.moving, np.sqrt((carried[0] ** 2).sum(axis=1)), 1.0)[:, None]
        center = np.where(self.turning[:, None], carried[1] + step[:, 3:6], 0.0)
        quaternion = times(base, times(part, self.quaternion))
        quaternion /= np.sqrt((quaternion**2).sum(axis=1))[:, None]
        pitch = np.where(self.twisting, self.pitch + step[:, 12], 0.0)
        return JointArrays(self.kinds, axis, center, carried[2] + step[:, 3:6], quaternion, pitch)

    def where(self, condition: Booleans, alternative: JointArrays) -> JointArrays:
        """These joints where a condition (h,) holds, the alternatives (of the same kinds) where not."""
        wide = condition[:, None]
        return JointArrays(
            self.kinds,
            np.where(wide, self.axis, alternative.axis),
            np.where(wide, self.center, alternative.center),
            np.where(wide, self.position, alternative.position),
            np.where(wide, self.quaternion, alternative.quaternion),
            np.where(condition, self.pitch, alternative.pitch),
        )


def arrays_of(joints: Sequence[Joint]) -> JointArrays:
    """Joints as arrays."""
    return JointArrays(
        tuple(joint.kind for joint in joints),
        np.array([joint.axis for joint in joints]).reshape(-1, 3),
        np.array([joint.center for joint in joints]).reshape(-1, 3),
        np.array([joint.position for joint in joints]).reshape(-1, 3),
        np.array([joint.quaternion for joint in joints]).reshape(-1, 4),
        np.array([joint.pitch for joint in joints]).reshape(-1),
    )


def concatenated_joints(several: Sequence[JointArrays]) -> JointArrays:
    """The concatenation of several arrays of joints."""
    names = ("axis", "center", "position", "quaternion", "pitch")
    arrays = (np.concatenate([getattr(part, name) for part in several]) for name in names)
    return JointArrays(tuple(kind for part in several for kind in part.kinds), *arrays)
