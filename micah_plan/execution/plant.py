"""The interface of a plant: what a hand is told, what a tracker sees, and, apart from both, what is true."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Measurement:
    """What the executing side sees at one time; one row per link, in the automaton's order of links.

    Attributes:
        time: [s] since the reset.
        position: (l, 3) [m], measured origin of each link's child part in the base frame.
        quaternion: (l, 4) its measured orientation, scalar last.
        force: (l, 3) [N], base frame, that the hand exerts at each part's handle; None if the plant has no forces.
        joints: (J,) what the encoders of the arm say [rad or m]; None if the plant has no arm.
    """

    time: float
    position: Floats
    quaternion: Floats
    force: Floats | None = None
    joints: Floats | None = None


@dataclass(frozen=True, eq=False)
class Command:
    """One control step's command, in the forms in which plants and logs take it.

    The first three say the same thing for the model that the command was computed with: move from the estimate c by u.

    Attributes:
        input: (m,) u of the automaton [rad or m].
        origin: (l, 3) [m], base frame: displacement of each part's origin. It is what the log calls the action.
        handle: (l, 3) [m], base frame: displacement of each part's handle, what a hand holding it is told.
        posture: (J,) joints at which the plan has the arm after the step [rad or m]; None: any will do.
    """

    input: Floats
    origin: Floats
    handle: Floats
    posture: Floats | None = None


@dataclass(frozen=True, eq=False)
class Truth:
    """The true state, for scoring only: nothing that decides on inputs may read it.

    Attributes:
        mode: the true mode; None if the plant does not think in modes (physics), then `held` says what is latched.
        x: (n,) true configuration [rad or m], in the coordinates of the plant's own automaton.
        position, quaternion: (l, 3) [m] and (l, 4), the true poses of the parts in the base frame.
        held: (n,) whether each coordinate is held by a latch.
        incident: what went wrong in between and cannot be seen at the end, such as a collision; empty if nothing.
    """

    mode: str | None
    x: Floats
    position: Floats
    quaternion: Floats
    held: NDArray[np.bool_]
    incident: str = ""


class Plant(Protocol):
    """Something that can be manipulated: the nominal automaton, a physics simulation, a real object."""

    def reset(self, rng: np.random.Generator) -> Measurement:
        """Bring the object to a start drawn with `rng`, which also feeds all noise until the next reset."""
        ...

    def apply(self, command: Command) -> Measurement:
        """Carry out one control step and measure."""
        ...

    def truth(self) -> Truth:
        """The true state now."""
        ...

    def close(self) -> None:
        """Free what the plant holds; it cannot be used afterwards."""
        ...
