"""An object that stands, in MuJoCo: rigid bodies, friction, end stops, latches, and a hand that pulls at each part.

The plant reads the model's geometry, but none of its dynamics: what moves, sticks, latches or springs back is physics.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.execution.mujoco.core import Core, Latch
from micah_plan.execution.mujoco.hands import Hands
from micah_plan.execution.mujoco.library import import_mujoco
from micah_plan.execution.mujoco.parameters import PhysicalParameters
from micah_plan.execution.mujoco.standing_object import StandingPart, base_shapes, standing_parts
from micah_plan.execution.mujoco.world import latch_name, standing_mjcf
from micah_plan.execution.plant import Command, Measurement, Truth
from micah_plan.task.start import Start, sample_start

Floats = NDArray[np.float64]


class StandingPlant:
    """Any automaton whose parts each have one moving joint, as a mechanism in MuJoCo.

    Each part's handle is pulled by a compliant hand (spring, critical damping, limited force) that is told
    displacements relative to where it is. Within a control step its target moves on a straight line and then rests.
    """

    def __init__(self, automaton: HybridAutomaton, start: Start, parameters: PhysicalParameters | None = None) -> None:
        """Build the simulation.

        Args:
            automaton: the object; its shapes if it has any, else boxes.
            start: the belief from which true starts are drawn.
            parameters: of the physics; None: the defaults.

        Raises:
            MissingDependencyError: if MuJoCo is not installed.
            InputError: if the automaton cannot be built as a mechanism.
        """
        mujoco = import_mujoco()
        self.automaton = automaton
        self.start = start
        self.parameters = parameters or PhysicalParameters()
        self._parts = standing_parts(automaton)
        text = standing_mjcf(self._parts, base_shapes(automaton), self.parameters)
        model = mujoco.MjModel.from_xml_string(text)
        self._core = Core(mujoco, model, self.parameters, len(self._parts))
        self._bodies = [model.body(part.name).id for part in self._parts]
        moving = [part for part in self._parts if part.joint.kind != "rigid"]
        self._joints = [(part, int(model.joint(part.name).qposadr[0])) for part in moving]
        self._hands = Hands(self._core, self._parts)
        self._still: Floats = np.zeros(automaton.n)

    def reset(self, rng: np.random.Generator) -> Measurement:
        """A new trial: a start drawn from the belief, everything at rest, latched if the start mode pins it."""
        core = self._core
        mode, x = sample_start(self.automaton, self.start, rng)
        core.mujoco.mj_resetData(core.model, core.data)
        self._still = x.copy()
        for part, address in self._joints:
            x[part.coordinate] = np.clip(x[part.coordinate], part.lower, part.upper)
            core.data.qpos[address] = x[part.coordinate]
            if part.joint.kind == "screw":
                core.data.qpos[address + 1] = part.joint.pitch * x[part.coordinate]
        self._set_latches(x, {pin.coordinate for pin in self.automaton.mode(mode).pins})
        self._hands.start()
        core.begin(rng)
        return self._measure(0.0, np.zeros((len(self._parts), 3)))

    def apply(self, command: Command) -> Measurement:
        """One control step: every hand moves by the command's displacement from where its handle truly is."""
        self._hands.move(command.handle)
        return self._measure(self.parameters.control_period, self._hands.force)

    def truth(self) -> Truth:
        """The true configuration, poses and latches."""
        x, latched = self._still.copy(), np.zeros(self.automaton.n, dtype=bool)
        coordinates = {address: part.coordinate for part, address in self._joints}
        for address, coordinate in coordinates.items():
            x[coordinate] = self._core.data.qpos[address]
        for latch in self._core.latches:
            latched[coordinates[latch.qpos]] |= self._core.is_locked(latch)
        return Truth(None, x, *self._core.poses(self._bodies), latched)

    def close(self) -> None:
        """Free the simulation."""
        self._core.close()

    def _set_latches(self, x: Floats, pinned: set[int]) -> None:
        """New latches for an object at x (n,), closed on the pinned coordinates."""
        core = self._core
        core.latches = []
        for part, address in self._joints:
            for number, position in enumerate(part.latches):
                latch = self._latch(part, number, position, address)
                away = abs(x[part.coordinate] - position)
                closed = part.coordinate in pinned and away < 1e-9
                latch.armed = closed or not latch.low <= x[part.coordinate] <= latch.high
                core.data.eq_active[latch.equality] = closed
                core.latches.append(latch)

    def _latch(self, part: StandingPart, number: int, position: float, address: int) -> Latch:
        capture = self.parameters.latch_capture / part.arm
        return Latch(
            self._core.model.equality(latch_name(part.name, number)).id,
            address,
            position,
            position - capture,
            position + capture,
            release=self.parameters.latch_force * part.arm,
            free_down=position - part.lower > capture,
            free_up=part.upper - position > capture,
        )

    def _measure(self, elapsed: float, force: Floats) -> Measurement:
        seen = self._core.seen(*self._core.poses(self._bodies), elapsed)
        return Measurement(float(self._core.data.time), *seen, force)
