"""The interface of machines: `Plant`, its commands and measurements; and, separate from it, `Referee`.

A plant is a machine with an object: a robot, a simulation, the model itself. It need not know the true state. One that
does is a referee; only scores and logs use it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from micah_plan.arrays import Booleans, Floats
from micah_plan.errors import MicahError
from micah_plan.task.problem import Problem


class PlantError(MicahError):
    """The machine failed: it stopped, lost the object or does not answer.

    A plant raises it with one sentence for people. From `apply` it ends the trial as a failure, and the next trial
    resets the plant; from `reset` it ends the execution. There are no commands in between.
    """


@dataclass(frozen=True, eq=False)
class Measurement:
    """A measurement of the machine at one time; one row per link, in the automaton's order of links.

    Attributes:
        time: [s] since the reset; later at every step.
        position: (l, 3) [m], measured origin of each link's child part in the base frame.
        quaternion: (l, 4) its measured orientation, part to base, unit norm, scalar last.
        force: (l, 3) [N], base frame, that the hand exerts at each part's handle; None if forces are not measured. An
            object that is released needs that at the part in the hand, with its weight or without; after a step with a
            limit of force at least that at which the hand stopped.
        joints: (J,) from the encoders of the arm [rad or m]; None without an arm.
        unseen: (l,) parts that were not measured, with their last pose. It is optional: a plant may return NaN for the
            pose of such a part.
    """

    time: float
    position: Floats
    quaternion: Floats
    force: Floats | None = None
    joints: Floats | None = None
    unseen: Booleans | None = None


@dataclass(frozen=True, eq=False)
class Command:
    """One control step's command, in the forms in which plants and logs take it.

    The first three are equivalent under the model that the command was computed with: move from the estimate x by u. A
    plant carries out the one that suits it; a hand or arm takes `handle`.

    Attributes:
        input: (m,) u of the automaton [rad or m].
        origin: (l, 3) [m], base frame: displacement of each part's origin, logged as the action.
        handle: (l, 3) [m], base frame: displacement of each part's handle, the command of a hand that holds it.
        posture: (J,) joints at which the plan has the arm after the step [rad or m]; None: any will do.
        force_limit: change of the force on the hand since the beginning of the step at which it stops [N]; None: no
            limit. Only for the lowering of an object that is released.
        opens: whether the gripper is opened in this step; it then stays open.
    """

    input: Floats
    origin: Floats
    handle: Floats
    posture: Floats | None = None
    force_limit: float | None = None
    opens: bool = False


@dataclass(frozen=True, eq=False)
class Truth:
    """The true state, for scores and logs only: no decision may use it.

    Attributes:
        mode: the true mode; None if the plant has no modes (physics), then `latched` is used.
        x: (n,) true configuration [rad or m], in the coordinates of the plant's own automaton.
        position, quaternion: (l, 3) [m] and (l, 4), the true poses of the parts in the base frame.
        latched: (n,) whether a latch has caught each coordinate.
        incident: a failure that the final state does not show, such as a collision; empty without one.
        stands: after the gripper was opened, whether the object stands on its own as intended, without contact to the
            hand; x then is the state in which a hand would hold it there.
    """

    mode: str | None
    x: Floats
    position: Floats
    quaternion: Floats
    latched: NDArray[np.bool_]
    incident: str = ""
    stands: bool = False


@runtime_checkable
class Plant(Protocol):
    """Interface of a machine. `conformance.check_plant` tests whether a plant conforms.

    A plant that may take longer than a minute to answer has an attribute ``patience`` [s]; None: unlimited. One that
    does not answer by then has failed.
    """

    def reset(self, rng: np.random.Generator) -> Measurement:
        """Bring the object to the start of a trial and measure it.

        A simulation draws the start and all its noise from `rng`. A real machine may ignore it.

        Raises:
            PlantError: if it cannot be brought there.
        """
        ...

    def apply(self, command: Command) -> Measurement:
        """Carry out one control step, wait for its end, and measure.

        Raises:
            PlantError: if the machine failed; it must have stopped by then.
        """
        ...

    def close(self) -> None:
        """Stop and release all resources. Called once, also after a failure; the plant is not used afterwards."""
        ...


PlantMaker = Callable[[Problem], Plant]
"""A class or function that makes a plant for a problem: automaton, start, physical parameters, arm."""


@runtime_checkable
class Referee(Protocol):
    """Access to the true state, as simulations have. A plant with this method is its own referee."""

    def truth(self) -> Truth:
        """The true state now."""
        ...
