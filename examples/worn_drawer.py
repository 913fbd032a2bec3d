"""A drawer whose handle is loose: it follows only once the hand has taken up 25 mm of play. It stands for your machine.

    micah-plan execute plan.json --plant examples/worn_drawer.py:WornDrawer -o runs.csv

Nothing in it comes from the model but where the drawer stands and which way it slides. It knows no more than a tracker
sees, so success is what the belief says of it. The page "Start" (docs/start.md) finds the play.
"""

import numpy as np

from micah_plan.execution.plant import Measurement

PLAY, SIGHT, CHANCE, LENGTH = 0.025, 0.003, 0.001, 0.3
"""Of the handle, of what is measured, of a step, of the rail [m]."""
PERIOD_S = 0.5


class WornDrawer:
    """Three methods make a machine: reset, apply and close."""

    def __init__(self, problem):
        joint = problem.automaton.modes[0].joints[0]
        self.place, self.axis = np.array(joint.position), np.array(joint.axis)
        self.quaternion = np.array([joint.quaternion])
        self.start = problem.start

    def reset(self, rng):
        self.rng, self.time = rng, 0.0
        self.drawer = self.hand = float(rng.normal(self.start.mean[0], self.start.std[0]))
        return self.seen()

    def apply(self, command):
        self.time += PERIOD_S
        way = self.carried(float(command.handle[0] @ self.axis))
        if way:
            self.drawer = float(np.clip(self.drawer + way + self.rng.normal(0.0, CHANCE), 0.0, LENGTH))
        return self.seen()

    def carried(self, pull):
        """How far the drawer goes if the hand goes by `pull` [m]."""
        self.hand += pull
        return min(max(self.drawer, self.hand - PLAY / 2), self.hand + PLAY / 2) - self.drawer

    def seen(self):
        position = self.place + self.axis * self.drawer + self.rng.normal(0.0, SIGHT, 3)
        return Measurement(self.time, position[None], self.quaternion)

    def close(self):
        """Nothing runs on."""
