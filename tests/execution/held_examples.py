"""Objects in a hand that are built otherwise than the stapler."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from micah_plan.automaton.contacts.product import with_contacts
from micah_plan.automaton.contacts.values import Grip
from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Link, Mode, Noise, Part, Pin, Primitive
from micah_plan.automaton.joint import Joint, prismatic, revolute, rigid
from micah_plan.automaton.region import HalfSpace, Region, above, box, input_box
from micah_plan.task.body import Body
from micah_plan.task.goal import Goal
from micah_plan.task.problem import Hold, Problem
from micah_plan.task.start import Start
from micah_plan.task.surroundings import surroundings_of

TRAVEL = 0.03
CASE = Part("case", (Primitive("box", (0.04, 0.04, 0.08), (0.0, 0.0, 0.06)),))
PIN = Part("pin", (Primitive("box", (0.02, 0.02, 0.08), (0.0, 0.0, 0.02)),))
TABLE = Body("table", (Primitive("box", (1.0, 1.0, 0.04)),), (0.0, 0.0, -0.02))
WALL = Body("wall", (Primitive("box", (0.04, 1.0, 0.4)),), (0.22, 0.0, 0.2))
EXACT = {"position_noise": 0.0, "rotation_noise": 0.0, "spread": 0.0}


def stamp() -> Problem:
    """A case in the hand with a pin below it that slides up by 3 cm and latches there when it is pressed on a table."""
    inputs = input_box([-0.01], [0.01], 1, ["pin"])
    latched = rigid((0.0, 0.0, TRAVEL), fixed_at=TRAVEL)
    threshold = Region((above(0, TRAVEL, 1, 1),))
    learned = HybridAutomaton(
        coordinates=(Coordinate("pin", "m"),),
        inputs=(Coordinate("pin", "m"),),
        links=(Link("base", "pin", 0),),
        parts=(),
        modes=(
            Mode(
                "sliding",
                (prismatic((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)),),
                ((1.0,),),
                box([0.0], [TRAVEL], 1, ["pin"]),
                inputs,
            ),
            Mode("latched", (latched,), ((0.0,),), threshold, inputs, (Pin(0, TRAVEL, 1e-3),)),
        ),
        edges=(Edge("sliding", "latched", threshold, threshold_std=1e-3),),
        noise=Noise((0.001,), (0.002,)),
    )
    grip = Grip(CASE, PIN, point=(0.0, 0.0, 0.06), rotation=(0.0, 0.0, 0.0), travel=TRAVEL, coordinate="pin")
    hold = Hold(grip, (("table", 2, 1),), (-0.3, -0.3, 0.0), (0.3, 0.3, 0.5))
    automaton = with_contacts(learned, grip, surroundings_of((TABLE,), hold.contacts, hold.lower, hold.upper))
    start = Start((0.0, 0.0, 0.2, 0.004), (0.0,) * 4)
    return Problem(automaton, start, Goal(((3, TRAVEL, 0.002),)), plant=EXACT, scene=(TABLE, WALL), hold=hold)


def reordered(problem: Problem, order: tuple[int, ...]) -> Problem:
    """The problem with its coordinates in another order, without transitions and ties, which physics does not read."""
    automaton = problem.automaton
    place = {old: new for new, old in enumerate(order)}

    def moved(mode: Mode) -> Mode:
        rows = [HalfSpace(tuple(h.a[i] for i in order), h.b, h.c, h.strict, h.name) for h in mode.invariant.half_spaces]
        return replace(
            mode,
            input_matrix=tuple(mode.input_matrix[i] for i in order),
            invariant=Region(tuple(rows)),
            pins=tuple(replace(pin, coordinate=place[pin.coordinate]) for pin in mode.pins),
            ties=(),
        )

    changed = replace(
        automaton,
        coordinates=tuple(automaton.coordinates[i] for i in order),
        links=tuple(replace(link, coordinate=place[link.coordinate]) for link in automaton.links),
        modes=tuple(moved(mode) for mode in automaton.modes),
        edges=(),
        noise=Noise((0.0,) * automaton.n, (0.01,) * automaton.n),
    )
    start = Start(tuple(problem.start.mean[i] for i in order), tuple(problem.start.std[i] for i in order))
    return replace(problem, automaton=changed, start=start, goal=Goal(((0, 0.0, 1.0),)))


def in_hand(slides: dict[str, Joint], case: Joint, pin: Joint, names: tuple[str, ...], *, pivots: bool) -> Problem:
    """A case in a hand on slides and a pin on the case, with these joints.

    Args:
        slides: by coordinate, from the base on; inputs displace them.
        names: the coordinates that case and pin follow.
    """
    coordinates = list(dict.fromkeys((*slides, *names)))
    carriages = [*(f"carriage {i}" for i in range(len(slides) - 1)), "hand"]
    chain = ["base", *carriages]
    links = [Link(chain[i], chain[i + 1], coordinates.index(name)) for i, name in enumerate(slides)]
    links += [Link("hand", "case", coordinates.index(names[0])), Link("case", "pin", coordinates.index(names[1]))]
    effect = np.eye(len(coordinates), len(slides))
    free = Mode("free", (*slides.values(), case, pin), tuple(map(tuple, effect.tolist())))
    automaton = HybridAutomaton(
        coordinates=tuple(Coordinate(name, "rad" if name == "turn" else "m") for name in coordinates),
        inputs=tuple(Coordinate(name, "m") for name in slides),
        links=tuple(links),
        parts=(Part("case", CASE.shapes), Part("pin", PIN.shapes)),
        modes=(free,),
        edges=(),
        noise=Noise((0.0,) * len(coordinates), (0.01,) * len(coordinates)),
    )
    grip = Grip(CASE, PIN, (0.0, 0.0, 0.06), (0.0, 0.0, 0.0), TRAVEL, pivots=pivots, datum=TRAVEL)
    hold = Hold(grip, (("table", 2, 1),), (-0.3, -0.3, 0.0), (0.3, 0.3, 0.5))
    start = Start((0.0,) * len(coordinates), (0.0,) * len(coordinates))
    return Problem(automaton, start, Goal(((0, 0.0, 1.0),)), plant=EXACT, scene=(TABLE, WALL), hold=hold)


def tool() -> Problem:
    """One rigid body in a hand that moves in a plane only: along a slanted rail, and across it, from 20 cm above."""
    rails = {
        "along": prismatic((0.6, 0.0, 0.8), (0.0, 0.0, 0.2)),
        "across": prismatic((0.0, 1.0, 0.0), (0.0, 0.0, 0.0)),
    }
    fixed = rigid((0.0, 0.0, 0.0))
    return in_hand(rails, rigid((0.0, 0.0, -0.06)), fixed, ("along", "along"), pivots=False)


def pivoting() -> Problem:
    """A rigid body that turns in the hand, where the turn is a coordinate of the model; it starts turned by 0.1 rad."""
    slides = dict(zip("xyz", (prismatic(axis, (0.0, 0.0, 0.0)) for axis in np.eye(3)), strict=True))
    turn = revolute((0.0, -1.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, -0.06))
    problem = in_hand(slides, turn, rigid((0.03, 0.0, 0.0)), ("turn", "turn"), pivots=True)
    return replace(problem, start=Start((0.0, 0.0, 0.2, 0.1), (0.0,) * 4))
