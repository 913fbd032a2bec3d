"""The nominal plant: the automaton itself with process noise, seen through a tracker of the model's precision."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.kinematics import ROTATION_LENGTH, jacobian
from micah_plan.automaton.thresholds import with_drawn_thresholds
from micah_plan.automaton.tracks import measuring_links
from micah_plan.automaton.transition import step
from micah_plan.execution.plant import Command, Measurement, Truth
from micah_plan.execution.pose import chain, components, moving_joints
from micah_plan.execution.tracker import PoseTracker, TrackerNoise
from micah_plan.planning.problem import Start
from micah_plan.planning.start_state import sample_start

Floats = NDArray[np.float64]


class NominalPlant:
    """What the planner believes in: x⁺ = step(x, u) + w, and poses whose configurations are as noisy as the model says.

    Thresholds are drawn at every reset, as well as the model knows them.

    Pose noise is white in position and rotation, in the ratio in which the inverse kinematics weighs them, and of such
    a size that the configuration found from it has the model's `observation_std`.
    """

    def __init__(self, automaton: HybridAutomaton, start: Start, control_period: float = 0.5) -> None:
        """Args: the model, the belief from which true starts are drawn, and the duration of a control step [s]."""
        self.automaton = automaton
        self.start = start
        self._true = automaton
        self._period = control_period
        self._process_std = np.array(automaton.noise.process_std)
        self._rng: np.random.Generator | None = None
        self._tracker: PoseTracker | None = None
        self._mode = automaton.modes[0].name
        self._x: Floats = np.zeros(automaton.n)
        self._time = 0.0

    def reset(self, rng: np.random.Generator) -> Measurement:
        """A new trial from a start drawn from the belief."""
        self._rng = rng
        self._true = with_drawn_thresholds(self.automaton, rng)
        self._mode, self._x = sample_start(self._true, self.start, rng)
        self._time = 0.0
        self._tracker = PoseTracker(pose_noise(self.automaton), len(self.automaton.links), rng)
        return self._measure(0.0)

    def apply(self, command: Command) -> Measurement:
        """One step of the automaton with a drawn disturbance."""
        if self._rng is None:
            raise RuntimeError("apply before reset")
        disturbance = self._process_std * self._rng.standard_normal(self.automaton.n)
        after = step(self._true, self._mode, self._x, command.input, disturbance)
        self._mode, self._x = after.mode, after.x
        self._time += self._period
        return self._measure(self._period)

    def truth(self) -> Truth:
        """The true mode and configuration."""
        position, quaternion = self._poses()
        held = np.zeros(self.automaton.n, dtype=bool)
        held[[pin.coordinate for pin in self.automaton.mode(self._mode).pins]] = True
        return Truth(self._mode, self._x.copy(), position, quaternion, held)

    def close(self) -> None:
        """Nothing to free."""

    def _poses(self) -> tuple[Floats, Floats]:
        return components(chain(self.automaton, moving_joints(self.automaton, self._mode), self._x))

    def _measure(self, elapsed: float) -> Measurement:
        if self._tracker is None:  # reset creates it before measuring
            raise RuntimeError("measure before reset")
        position, quaternion = self._tracker.measure(*self._poses(), elapsed)
        return Measurement(self._time, position, quaternion)


def pose_noise(automaton: HybridAutomaton) -> TrackerNoise:
    """The white pose noise that shows as the model's `observation_std` in each link's configuration.

    The inverse kinematics is the least-squares fit of position p and rotation L r (L the rotation length), so noise of
    std s in p and s / L in r gives a configuration of std s / |J|, J the Jacobian with its rotation scaled by L.
    """
    of_coordinate = np.zeros(automaton.n)
    joints = moving_joints(automaton, automaton.modes[0].name)
    for number, link in measuring_links(automaton):
        scaled = jacobian(joints[number], 0.0)[0] * np.repeat([ROTATION_LENGTH, 1.0], 3)
        # An unmoving part has no configuration; its noise is that of a slide.
        sensitivity = float(np.linalg.norm(scaled)) or 1.0
        of_coordinate[link.coordinate] = automaton.noise.observation_std[link.coordinate] * sensitivity
    # A part fixed to another is seen as well as that one.
    position = [of_coordinate[link.coordinate] for link in automaton.links]
    return TrackerNoise(np.array(position), np.array(position) / ROTATION_LENGTH)
