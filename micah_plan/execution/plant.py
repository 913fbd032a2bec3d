"""The interface of machines: `Plant`, its commands and measurements; and, separate from it, `Referee`.

A plant is a machine with an object: a robot, a simulation, the model itself. It need not know the true state. One that
does is a referee; only scores and logs may ask it.
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

    A plant raises it with one sentence for people. From `apply` it ends the trial as a failure, and the next trial asks
    the plant for a reset; from `reset` it ends the execution. Nothing is commanded in between.
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
        joints: (J,) what the encoders of the arm say [rad or m]; None if there is no arm.
        unseen: (l,) parts that this measurement does not show, with their last pose. A plant need not tell: it answers
            NaN for the pose of such a part.
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

    The first three say the same thing for the model that the command was computed with: move from the estimate x by u.
    A plant carries out the one that suits it; a hand or arm takes `handle`.

    Attributes:
        input: (m,) u of the automaton [rad or m].
        origin: (l, 3) [m], base frame: displacement of each part's origin. It is what the log calls the action.
        handle: (l, 3) [m], base frame: displacement of each part's handle, what a hand that holds it is told.
        posture: (J,) joints at which the plan has the arm after the step [rad or m]; None: any will do.
        force_limit: force on the hand, compared with that at the beginning of the step, at which it stops where it is
            [N]; None: it goes on. Only where a problem releases the object, which is lowered so.
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
        mode: the true mode; None if the plant has no modes (physics), then `latched` says what is latched.
        x: (n,) true configuration [rad or m], in the coordinates of the plant's own automaton.
        position, quaternion: (l, 3) [m] and (l, 4), the true poses of the parts in the base frame.
        latched: (n,) whether a latch has caught each coordinate.
        incident: what went wrong in between and cannot be seen at the end, such as a collision; empty if nothing.
        stands: after the gripper was opened, whether the object stands on its own as it should, touched by nothing that
            moves the hand; x then is the state in which a hand would hold it there.
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

    One that may take longer than a minute to answer says so by an attribute ``patience`` [s]; None: however long. What
    does not answer by then has failed.
    """

    def reset(self, rng: np.random.Generator) -> Measurement:
        """Bring the object to the start of a trial and measure it.

        A simulation draws the start and all its noise with `rng`. A real machine may leave `rng` alone.

        Raises:
            PlantError: if it cannot be brought there.
        """
        ...

    def apply(self, command: Command) -> Measurement:
        """Carry out one control step, wait for its end, and measure.

        Raises:
            PlantError: if the machine failed; it must be standing still by then.
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
