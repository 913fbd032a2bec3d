"""Incidents while a held object moves: collisions, and loose bodies knocked over."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.contacts.values import Grip
from micah_plan.execution import messages
from micah_plan.execution.mujoco.core import PhysicalPlant
from micah_plan.execution.mujoco.world import (
    OBJECT,
    SCENE,
    Flags,
    World,
)

# Deeper than this into a body [m] counts as a collision, and so does any push against a fixed body that may not be
# touched.
LARGEST_PENETRATION = 0.002
_LARGEST_PUSH_N = 2.0
# A loose body that moves [m] or tilts [rad] by more than this counts as knocked over.
LARGEST_SHIFT = 0.01
LARGEST_TILT = 0.1
_SCENE, _OBJECT, _ARM = 0, 1, 2
# Sensors, by what their names begin with: how deep the object or the arm is in anything; how often they meet what they
# may not; how often both, and the object alone, meet a body that the object may touch.
_DEPTH, _FORBIDDEN, _BY_BOTH, _BY_OBJECT = "depth/", "forbidden/", "by both/", "by object/"
# What MuJoCo's contact sensors show, how contacts are chosen, and how many.
_COUNT, _LEAST_DISTANCE = [1 << 0, 0, 1], [1 << 3, 1, 1]


def add_contact_sensors(scene: World, touchable: Collection[str], grip: Grip) -> None:
    """Add the contact sensors that an `IncidentWatch` reads.

    Args:
        touchable: names of bodies that the object, but no arm, may push against.
        grip: names the moving part of the object, which an arm could hit.
    """
    mujoco, world = scene.mujoco, scene.spec
    hand, moving = OBJECT + "hand", OBJECT + grip.moving.name
    subtree, body = mujoco.mjtObj.mjOBJ_XBODY, mujoco.mjtObj.mjOBJ_BODY

    def add(role: str, shown: list[int], name: str, partner: str = "", what: Any = subtree) -> None:
        meets = {"reftype": subtree, "refname": partner} if partner else {}
        sensor = {"name": f"{role}{len(world.sensors)}", "objtype": what, "objname": name, "intprm": shown, **meets}
        world.add_sensor(type=mujoco.mjtSensor.mjSENS_CONTACT, **sensor)

    carried = world.body(hand)  # below this body is all that moves the object, and the object
    while carried.parent.name != "world":
        carried = carried.parent
    bodies = list(world.worldbody.bodies)
    fixed = [body.name for body in bodies if body.name.startswith(SCENE) and not len(body.joints)]
    for root in (body.name for body in bodies if not body.name.startswith(SCENE)):
        add(_DEPTH, _LEAST_DISTANCE, root)
        for name in fixed:
            if root == carried.name and name.removeprefix(SCENE) in touchable:
                add(_BY_BOTH, _COUNT, root, name)
                add(_BY_OBJECT, _COUNT, hand, name)
            else:
                add(_FORBIDDEN, _COUNT, root, name)
        if not root.startswith(OBJECT):
            add(_FORBIDDEN, _COUNT, moving, root, body)
    if len(world.worldbody.geoms):  # the base of an arm
        add(_FORBIDDEN, _COUNT, "world", what=body)


class IncidentWatch:
    """Watches a held object, and keeps the first incident of a trial."""

    def __init__(self, plant: PhysicalPlant, touchable: Collection[str]) -> None:
        """Args: touchable: as of `add_contact_sensors`."""
        self._plant, model = plant, plant.model
        self._owner = model.geom_bodyid.tolist()
        owners = [model.body(body).name for body in self._owner]
        self._name = [name.partition("/")[2] for name in owners]
        # Of two that meet, the later kind hit the earlier one.
        self._kind = [_SCENE if n.startswith(SCENE) else _OBJECT if n.startswith(OBJECT) else _ARM for n in owners]
        things = zip(self._owner, self._name, self._kind, strict=True)
        self._loose = {i: name for i, name, kind in things if kind == _SCENE and model.body_dofnum[i] > 0}
        self._touchable = touchable
        sensors = [model.sensor(number) for number in range(model.nsensor)]
        roles = (_DEPTH, _FORBIDDEN, _BY_BOTH, _BY_OBJECT)
        self._columns = [[int(s.adr[0]) for s in sensors if s.name.startswith(role)] for role in roles]
        self._pose: dict[int, Floats] = {}
        self.incident = ""

    def begin(self) -> None:
        """Start a new trial."""
        self.incident = ""
        data = self._plant.data
        self._pose = {i: np.append(data.xpos[i], data.xmat[i][6:]) for i in self._loose}

    def look(self) -> bool:
        """Check the contacts of the last step; returns whether there was a reason to."""
        suspects = bool(self.suspects(self._plant.data.sensordata[None])[0])
        if suspects:
            self.incident = self._collision()
        return suspects

    def look_at_loose_bodies(self) -> None:
        """Check whether a loose body was knocked over."""
        self.incident = self.incident or self._knocked_over()

    def suspects(self, measured: Floats) -> Flags:
        """(k,) whether a contact may be a collision: deep, or with a forbidden fixed body.

        After an incident none is.
        """
        depth, forbidden, by_both, by_object = (measured[:, columns] for columns in self._columns)
        deep = (depth < -LARGEST_PENETRATION).any(axis=1)
        by_arm = (by_both > by_object).any(axis=1)
        return np.asarray((deep | forbidden.any(axis=1) | by_arm) & (not self.incident))

    def _collision(self) -> str:
        """The first collision of the last step."""
        data, push = self._plant.data, np.zeros(6)
        for number in range(data.ncon):
            contact = data.contact[number]
            hit, by = sorted((int(contact.geom1), int(contact.geom2)), key=self._kind.__getitem__)
            if self._kind[by] == _SCENE:  # it rests on another body of the scene
                continue
            name, is_object = self._name[hit], self._kind[by] == _OBJECT
            allowed = self._owner[hit] in self._loose or (is_object and name in self._touchable)
            self._plant.mujoco.mj_contactForce(self._plant.model, data, number, push)
            if contact.dist < -LARGEST_PENETRATION or (not allowed and push[0] > _LARGEST_PUSH_N):
                what = "it" if is_object else f"the arm's {self._name[by]}"
                return messages.hit(what, name, data.time, float(push[0]), max(0.0, -contact.dist))
        return ""

    def _knocked_over(self) -> str:
        data = self._plant.data
        for number, name in self._loose.items():
            before = self._pose[number]
            shift = float(np.linalg.norm(data.xpos[number] - before[:3]))
            tilt = float(np.arccos(np.clip(data.xmat[number][6:] @ before[3:], -1.0, 1.0)))
            if shift > LARGEST_SHIFT or tilt > LARGEST_TILT:
                return messages.knocked_over(name, data.time, shift, tilt)
        return ""
