"""A door with a latch, made by hand: the smallest automaton that has everything a model file can say."""

import pytest

from micah_plan.automaton.hybrid import (
    Coordinate,
    Edge,
    HybridAutomaton,
    Link,
    Mode,
    Noise,
    Part,
    Pin,
    Primitive,
    Reset,
)
from micah_plan.automaton.joint import Joint, ParameterCovariance, revolute, rigid
from micah_plan.automaton.region import Region, above, below, input_above, input_below, input_box


@pytest.fixture
def door() -> HybridAutomaton:
    """Revolute from 0 to 1.2 rad, then rigid until it is pushed back by more than 0.01 rad per step."""
    hinge = revolute((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (0.22, 0.0, 0.1))
    covariance = ParameterCovariance(("axis_1", "center_2"), ((1e-4, 2e-6), (2e-6, 4e-6)))
    hinge = Joint(**{**vars(hinge), "covariance": covariance})
    inputs = input_box((-0.1,), (0.1,), 1, ["door"])
    return HybridAutomaton(
        coordinates=(Coordinate("door", "rad"),),
        inputs=(Coordinate("door", "rad"),),
        links=(Link("base", "door", 0),),
        parts=(
            Part("base", (Primitive("cylinder", (0.02, 0.3), color="#102030"),)),
            Part("door", (Primitive("box", (0.22, 0.02, 0.3), (-0.11, 0.0, 0.0)),), (0.0, 0.05, 0.0)),
        ),
        modes=(
            Mode(
                "revolute",
                (hinge,),
                ((1.0,),),
                Region((above(0, 0.0, 1, 1, name="door"), below(0, 1.2, 1, 1, strict=True, name="door"))),
                inputs,
            ),
            Mode(
                "rigid",
                (rigid((0.1, 0.2, 0.1), fixed_at=1.2),),
                ((0.0,),),
                Region((above(0, 1.2, 1, 1, name="door"),)),
                inputs,
                (Pin(0, 1.2, 0.005),),
            ),
        ),
        edges=(
            Edge("revolute", "rigid", Region((above(0, 1.2, 1, 1, name="door"),)), Reset(((0.0,),), None, (1.2,))),
            Edge("rigid", "revolute", Region((input_below(0, -0.01, 1, 1, strict=True, name="input door"),))),
            Edge(
                "revolute",
                "revolute",
                Region((below(0, 0.0, 1, 1, strict=True, name="door"),)),
                Reset(((0.0,),), None, (0.0,)),
            ),
            Edge(
                "rigid",
                "rigid",
                Region((input_above(0, 0.0, 1, 1, name="input door"),)),
                Reset(((0.0,),), None, (1.2,)),
            ),
        ),
        noise=Noise((0.002,), (0.02,)),
        provenance={"method": "by hand", "seed": "0"},
    )
