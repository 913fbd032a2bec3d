"""A plant for `micah-plan explore` in sixty lines: a drawer whose handle a springy hand holds.

micah-plan explore problems/explore_handle.yaml --plant examples/held_drawer.py:HeldDrawer -o drawer.yaml
"""

from __future__ import annotations

import numpy as np

from micah_plan.execution.plant import Command, Measurement

OUTWARDS = np.array([0.6, -0.8, 0.0])  # unit vector, base frame
STIFFNESS = 1200.0  # of the hand [N/m]
FRICTION = 4.0  # [N]
LENGTH = 0.35  # [m]
NOISE = 0.001, 0.01  # of the tracker [m] and [rad]


class HeldDrawer:
    """Called with the scene; a robot would connect to its driver here."""

    def __init__(self, scene):
        self.closed = np.array([0.4, 0.1, 0.8]) if scene.position is None else np.array(scene.position)

    def reset(self, rng):
        self.rng, self.time, self.way, self.force = rng, 0.0, 0.0, np.zeros(3)
        return self.measured()

    def apply(self, command: Command):
        """The hand's equilibrium goes `command.handle[0]` away from where the handle is; then all comes to rest."""
        equilibrium = self.place() + command.handle[0]
        pull = STIFFNESS * (equilibrium - self.place()) @ OUTWARDS
        if abs(pull) > FRICTION:  # it slides until the spring pulls no harder than friction holds
            self.way += (pull - np.sign(pull) * FRICTION) / STIFFNESS
            self.way = min(max(self.way, 0.0), LENGTH)
        self.force = STIFFNESS * (equilibrium - self.place())  # what the hand exerts at the handle, base frame
        self.time += 0.5
        return self.measured()

    def close(self):
        """Nothing to free."""

    def place(self):
        return self.closed + self.way * OUTWARDS

    def measured(self):
        place = self.place() + NOISE[0] * self.rng.standard_normal(3)
        x, y, z = 0.5 * NOISE[1] * self.rng.standard_normal(3)
        turn = np.array([x, y, z, np.sqrt(1.0 - x * x - y * y - z * z)])  # scalar last
        return Measurement(self.time, place[None], turn[None], self.force[None])
