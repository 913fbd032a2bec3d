"""What must not happen while a held object is moved: collisions, and loose things knocked over."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from micah_plan.execution.held_mjcf import OBJECT

Floats = NDArray[np.float64]

# Deeper than this into a body [m] counts as a collision, and so does any push against a fixed body that may not be
# touched.
LARGEST_PENETRATION = 0.002
_LARGEST_PUSH_N = 2.0
# A loose body that moves [m] or tilts [rad] by more than this counts as knocked over.
LARGEST_SHIFT = 0.01
LARGEST_TILT = 0.1
_SCENE, _OBJECT = 0, 1


class Watch:
    """Remembers the first incident of a trial."""

    def __init__(self, mujoco: Any, model: Any, touchable: set[str]) -> None:
        """Args: touchable: bodies that the object, but no arm, may push against."""
        self._mj, self._model = mujoco, model
        self._owner = model.geom_bodyid
        owners = [model.body(int(i)).name for i in self._owner]
        self._name = [name.partition("/")[2] for name in owners]
        kinds = ("scene/", OBJECT)  # and the rest is the arm: of two that meet, the later kind hit the earlier one
        self._kind = np.array([[name.startswith(kind) for kind in (*kinds, "")].index(True) for name in owners])
        free = np.flatnonzero((self._kind == _SCENE) & (model.body_dofnum[self._owner] > 0))
        self._loose = {int(self._owner[i]): self._name[i] for i in free}
        self._touchable = touchable
        self._pose: dict[int, Floats] = {}
        self.incident = ""

    def begin(self, data: Any) -> None:
        """A new trial starts from here."""
        self.incident = ""
        self._pose = {i: np.append(data.xpos[i], data.xmat[i][6:]) for i in self._loose}

    def touch(self, data: Any) -> None:
        """Look at the contacts of now: none too deep, no push against what is fixed and may not be touched."""
        if not self.incident and data.ncon:
            self.incident = self._hit(data)

    def stand(self, data: Any) -> None:
        """Look at the loose bodies: all still where they stood."""
        self.incident = self.incident or self._knocked(data)

    def _hit(self, data: Any) -> str:
        push = np.zeros(6)
        met = (self._kind[data.contact.geom] != _SCENE).any(axis=1)  # what rests on other bodies of the scene is no hit
        for number in map(int, np.flatnonzero(met)):
            contact = data.contact[number]
            hit, by = sorted((int(contact.geom1), int(contact.geom2)), key=lambda geom: int(self._kind[geom]))
            name, is_object = self._name[hit], self._kind[by] == _OBJECT
            allowed = int(self._owner[hit]) in self._loose or (is_object and name in self._touchable)
            self._mj.mj_contactForce(self._model, data, number, push)
            if contact.dist < -LARGEST_PENETRATION or (not allowed and push[0] > _LARGEST_PUSH_N):
                what = "it" if is_object else f"the arm's {self._name[by]}"
                depth = max(0.0, -1e3 * contact.dist)
                return f"{what} hit '{name}' at {data.time:.1f} s with {push[0]:.0f} N, {depth:.1f} mm deep"
        return ""

    def _knocked(self, data: Any) -> str:
        for number, name in self._loose.items():
            before = self._pose[number]
            shift = float(np.linalg.norm(data.xpos[number] - before[:3]))
            tilt = float(np.arccos(np.clip(data.xmat[number][6:] @ before[3:], -1.0, 1.0)))
            if shift > LARGEST_SHIFT or tilt > LARGEST_TILT:
                how = f"it had moved by {1e3 * shift:.0f} mm and tilted by {tilt:.2f} rad"
                return f"'{name}' was knocked over: at {data.time:.1f} s {how}"
        return ""
