"""A stapler written by hand, held above a table in front of a shelf: what the tests of contacts share."""

from micah_plan.automaton.contacts.values import Face, Grip, HandNoise, Solid, Surroundings
from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Link, Mode, Noise, Part, Pin, Primitive
from micah_plan.automaton.joint import revolute, rigid
from micah_plan.automaton.region import Region, above, box, input_below

LATCH = 0.5
PITCH = 0.12
TABLE = Face("table", 2, 1, 0.0)
GRIP = Grip(
    held=Part("upper_arm", (Primitive("box", (0.15, 0.04, 0.02), (0.075, 0.0, 0.02)),)),
    moving=Part("lower_arm", (Primitive("box", (0.16, 0.04, 0.02), (0.075, 0.0, -0.01)),)),
    point=(0.1, 0.0, 0.04),
    rotation=(0.0, -PITCH, 0.0),
    travel=0.5,
    pivots=True,
)
AROUND = Surroundings(
    solids=(
        Solid("books", (0.3, -0.15, 0.0), (0.65, 0.15, 0.2)),
        Solid("shelf", (0.3, -0.2, 0.32), (0.7, 0.2, 0.34)),
    ),
    faces=(TABLE,),
    lower=(-0.3, -0.2, 0.0),
    upper=(0.6, 0.2, 0.6),
)
NOISE = HandNoise(observation=(0.01, 0.01, 0.01))


def stapler(latches: bool = True) -> HybridAutomaton:
    """The joint alone: closes towards larger angles and latches at `LATCH`."""
    swing = revolute((0.0, 1.0, 0.0), (0.0, 0.0, 0.0), (0.1, 0.0, 0.0))
    modes = [Mode("revolute", (swing,), ((1.0,),), box([-9.0], [LATCH], 1, ["arm"]))]
    edges = []
    if latches:
        held = rigid((0.1, 0.0, 0.0), fixed_at=LATCH)
        shut = Region((above(0, LATCH, 1, 1, name="arm"),))
        modes.append(Mode("rigid", (held,), ((0.0,),), shut, pins=(Pin(0, LATCH, 0.01),)))
        edges = [
            Edge("revolute", "rigid", shut, threshold_std=0.005),
            Edge("rigid", "revolute", Region((input_below(0, 0.0, 1, 1, strict=True),))),
        ]
    coordinate = Coordinate("arm", "rad")
    return HybridAutomaton(
        coordinates=(coordinate,),
        inputs=(coordinate,),
        links=(Link("base", "arm", 0),),
        parts=(),
        modes=tuple(modes),
        edges=tuple(edges),
        noise=Noise((0.03,), (0.03,)),
    )
