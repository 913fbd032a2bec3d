"""The nominal plant: the automaton with process noise, measured by a tracker of the model's precision."""

from __future__ import annotations

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.drawn_thresholds import drawn_shifts, with_boundaries
from micah_plan.automaton.effects.registry import form
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.input_memory import InputChannel
from micah_plan.automaton.kinematics import ROTATION_LENGTH, jacobian, placements
from micah_plan.automaton.memo import memoised
from micah_plan.automaton.step_noise import drawn_gains, with_gains
from micah_plan.automaton.tracks import measuring_links
from micah_plan.automaton.transition import step
from micah_plan.execution.mujoco.parameters import parameters_of
from micah_plan.execution.plant import Command, Measurement, Truth
from micah_plan.execution.pose import carried, chain, components, matrices, moving_joints
from micah_plan.execution.tracker import PoseTracker, TrackerNoise
from micah_plan.task.problem import Problem, Release
from micah_plan.task.release import Rest, resting_place
from micah_plan.task.start import Start, sample_start

# Std [rad] beyond which an orientation is not measured at all: of a slide that is seen to metres only.
_MOST_ROTATION = 0.5


class NominalPlant:
    """The planner's model as a plant: x⁺ = step(x, u) + w, with poses of the model's observation noise.

    Thresholds and gains are drawn at every reset, as well as the model knows them.

    Pose noise is white in position and rotation, in the ratio in which the inverse kinematics weighs them, and of such
    a size that the configuration found from it, effects of sensors taken out, has the std that the model states for the
    true mode and place. The pose of a part that another one carries is measured relative to that one.
    """

    def __init__(
        self,
        automaton: HybridAutomaton,
        start: Start,
        control_period: float = 0.5,
        release: tuple[Release, Rest] | None = None,
    ) -> None:
        """Args: the model, the start belief, the duration of a control step [s], and the release, if any."""
        self._release = release
        self.automaton = self._true = automaton
        self.start, self._period = start, control_period
        self._process_std = np.array(automaton.noise.process_std)
        self._tracker: PoseTracker | None = None

    @classmethod
    def of(cls, problem: Problem) -> NominalPlant:
        """The nominal plant of a problem."""
        release = None if problem.release is None else (problem.release, resting_place(problem))
        return cls(problem.automaton, problem.start, parameters_of(problem).control_period, release)

    def reset(self, rng: np.random.Generator) -> Measurement:
        """A new trial from a start drawn from the belief."""
        gains, shifts = (drawn(self.automaton, rng, 1)[0] for drawn in (drawn_gains, drawn_shifts))
        self._true = with_gains(with_boundaries(self.automaton, shifts), gains)
        self._mode, self._x = sample_start(self._true, self.start, rng)
        self._rng, self._channel, self._time = rng, InputChannel(self._true), 0.0
        self._tracker = PoseTracker(pose_noise(self.automaton), len(self.automaton.links), rng)
        self._force, self._stands = 0.0, False
        self._raised = 0.0 if self._release is None else self._release[0].support_std * float(rng.standard_normal())
        return self._measure(self._tracker, 0.0)

    def apply(self, command: Command) -> Measurement:
        """One step of the automaton with a drawn disturbance."""
        if self._tracker is None:
            raise RuntimeError("apply before reset")
        self._time += self._period
        disturbance = self._process_std * self._rng.standard_normal(self.automaton.n)
        if self._release is not None and (self._stands or command.opens or command.force_limit is not None):
            self._let_go(command, disturbance, *self._release)
            return self._measure(self._tracker, self._period)
        carried_out = self._channel.pass_on(command.input, self._mode, self._x)
        after = step(self._true, self._mode, self._x, carried_out, disturbance)
        self._mode, self._x = after.mode, after.x
        return self._measure(self._tracker, self._period)

    def _let_go(self, command: Command, disturbance: Floats, release: Release, rest: Rest) -> None:
        """A step of a hand that puts the object down: it stops at the support, where the object settles.

        An object that stands stays when the hand moves away."""
        if self._stands:
            return
        if command.opens:
            self._x = rest.state(self._x, self._raised)
            self._x[:2] += release.shift_std * self._rng.standard_normal(2)
            self._stands = True
            return
        lowest = rest.top + rest.touching + self._raised
        self._x = self._x + self.automaton.mode(self._mode).B @ command.input + disturbance
        for pin in self.automaton.mode(self._mode).pins:
            self._x[pin.coordinate] = pin.value
        touches = self._x[2] <= lowest
        self._x[2] = max(self._x[2], lowest)
        self._force = -2.0 * release.force if touches else 0.0

    def truth(self) -> Truth:
        """The true mode and configuration."""
        joints = moving_joints(self.automaton, self._mode)
        position, quaternion = components(chain(self.automaton, joints, self._x))
        latched = ~self.automaton.mode(self._mode).free
        return Truth(self._mode, self._x.copy(), position, quaternion, latched, stands=self._stands)

    def close(self) -> None:
        """No resources to release."""

    def _shown(self) -> tuple[Floats, Floats]:
        """(n,) sensor readings of the present configuration, and (n,) their derivatives."""
        shown, slope = self._x.copy(), np.ones(self.automaton.n)
        for effect in self.automaton.effects:
            i, effect_form, here = self.automaton.index(effect.coordinate), form(effect.name), shown.copy()
            if effect_form.layer == "sensor":
                shown[i] = effect_form.measured(np, here[i], self._time, effect.values)
                slope[i] *= effect_form.measured(np, here[i] + 1.0, self._time, effect.values) - shown[i]
        return shown, np.abs(slope)

    def _measure(self, tracker: PoseTracker, elapsed: float) -> Measurement:
        automaton = self.automaton
        joints, (shown, slope) = moving_joints(automaton, self._mode), self._shown()
        links = zip(joints, automaton.links, strict=True)
        relative = np.array([placements(joint, shown[link.coordinate])[0] for joint, link in links])
        sensing = automaton.sensing(automaton.mode(self._mode))
        noise = pose_noise(automaton, slope * sensing.std_at(self._x))
        measured = matrices(*tracker.measure(*components(relative.reshape(-1, 4, 4)), elapsed, noise))
        force = None if self._release is None else np.tile([0.0, 0.0, self._force], (len(automaton.links), 1))
        return Measurement(self._time, *components(carried(automaton, measured)), force)


def pose_noise(automaton: HybridAutomaton, observation_std: Floats | None = None) -> TrackerNoise:
    """White pose noise equivalent to `observation_std` (n,; None: the model's) in each link's configuration.

    The inverse kinematics is the least-squares fit of position p and rotation L r (L the rotation length), so noise of
    std s in p and s / L in r gives a configuration of std s / |J|, J the Jacobian with its rotation scaled by L.
    """
    std = np.array(automaton.noise.observation_std) if observation_std is None else observation_std
    # A part fixed to another is seen as well as that one.
    position = (std * _sensitivity(automaton))[[link.coordinate for link in automaton.links]]
    return TrackerNoise(position, np.minimum(position / ROTATION_LENGTH, _MOST_ROTATION))


@memoised
def _sensitivity(automaton: HybridAutomaton) -> Floats:
    """(n,) |J| of each measured coordinate, 0 for others."""
    configuration, joints = np.zeros(automaton.n), moving_joints(automaton, automaton.modes[0].name)
    for number, link in measuring_links(automaton):
        scaled = jacobian(joints[number], 0.0)[0] * np.repeat([ROTATION_LENGTH, 1.0], 3)
        # An unmoving part has no configuration; its noise is that of a slide.
        configuration[link.coordinate] = float(np.linalg.norm(scaled)) or 1.0
    return configuration
