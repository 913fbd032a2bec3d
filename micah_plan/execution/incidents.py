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


class Watch:
    """Remembers the first incident of a trial."""

    def __init__(self, mujoco: Any, model: Any, touchable: set[str]) -> None:
        """Args: touchable: bodies that the object, but no arm, may push against."""
        self._mj, self._model = mujoco, model
        names = [model.geom(i).name.split("/") for i in range(model.ngeom)]
        self._body = {i: name[1] for i, name in enumerate(names) if name[0] == "scene"}
        self._is_scene = np.array([name[0] == "scene" for name in names])
        self._object = {i for i in range(model.ngeom) if model.geom(i).name.startswith(OBJECT)}
        owner = model.geom_bodyid
        self._loose = {int(owner[i]): name for i, name in self._body.items() if model.body_dofnum[owner[i]]}
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
        guests = ~self._is_scene[data.contact.geom].all(axis=1)  # what rests on other bodies of the scene is no hit
        for number in np.flatnonzero(guests):
            contact = data.contact[int(number)]
            ends = int(contact.geom1), int(contact.geom2)
            scene, guest = ends if ends[0] in self._body else ends[::-1]
            body, is_object = self._body[scene], guest in self._object
            loose = int(self._model.geom_bodyid[scene]) in self._loose
            self._mj.mj_contactForce(self._model, data, int(number), push)
            forbidden = not loose and not (is_object and body in self._touchable)
            if contact.dist < -LARGEST_PENETRATION or (forbidden and push[0] > _LARGEST_PUSH_N):
                what = "it" if is_object else f"the arm's {self._link(guest)}"
                depth = max(0.0, -1e3 * contact.dist)
                return f"{what} hit '{body}' at {data.time:.1f} s with {push[0]:.0f} N, {depth:.1f} mm deep"
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

    def _link(self, geom: int) -> str:
        return str(self._model.body(int(self._model.geom_bodyid[geom])).name).rpartition("/")[2]
