"""The kinds of `unseen_plants.py`: what is planted in which object, and controls that are hard with nothing in them.

Devices and forces share one signature each, whatever they use of it: ARG is off.
"""
# ruff: noqa: ARG001, ARG005

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation
from unseen_objects import Case, Device, Hand, Piece, Thing, World, changed, late, loose, second_order, slow, stick_slip

Rng = np.random.Generator


def door(rng: Rng, **more: object) -> Thing:
    """A hinged door about the vertical."""
    radius = float(rng.uniform(0.25, 0.7))
    piece = Piece("revolute", float(rng.uniform(0.9, 1.5)), (0.0, 0.0, 1.0), (0.1, 0.2, 0.0))
    return Thing((piece,), (0.1 + radius, 0.2, 0.4), **more)


def flap(rng: Rng) -> Thing:
    """A lid about the horizontal, that has weight."""
    piece = Piece("revolute", float(rng.uniform(1.2, 2.2)), (0.0, -1.0, 0.0), (0.0, 0.0, 0.5))
    return Thing((piece,), (float(rng.uniform(0.2, 0.5)), 0.1, 0.5))


def drawer(rng: Rng, **more: object) -> Thing:
    axis = np.array([1.0, float(rng.uniform(-0.5, 0.5)), 0.1])
    piece = Piece("prismatic", float(rng.uniform(0.2, 0.5)), tuple((axis / np.linalg.norm(axis)).tolist()))
    return Thing((piece,), (0.4, 0.0, 0.6), **more)


def slide_then_swing(rng: Rng) -> Thing:
    slide, turn = float(rng.uniform(0.2, 0.4)), float(rng.uniform(0.7, 1.2))
    pieces = (
        Piece("prismatic", slide, (1.0, 0.0, 0.0)),
        Piece("revolute", turn, (0.0, 0.0, 1.0), (0.4 + slide, -0.4, 0.5)),
    )
    return Thing(pieces, (0.4, 0.0, 0.5))


def swing_then_slide(rng: Rng) -> Thing:
    turn, radius = float(rng.uniform(0.7, 1.2)), float(rng.uniform(0.3, 0.5))
    away = (-float(np.sin(turn)), float(np.cos(turn)), 0.0)
    pieces = (Piece("revolute", turn, (0.0, 0.0, 1.0)), Piece("prismatic", float(rng.uniform(0.2, 0.4)), away))
    return Thing(pieces, (radius, 0.0, 0.5))


def hand(rng: Rng, thing: Thing, **more: object) -> Hand:
    """A hand whose largest step goes over the range in twelve to twenty-five."""
    return Hand(**{"step": thing.length / float(rng.uniform(12, 25)), "noise": thing.length * 0.002, **more})


def of(*names: str) -> tuple[frozenset[str], ...]:
    """What must be named: one entry for each, and what means the same on the plant separated by a bar."""
    return tuple(frozenset(name.split("|")) for name in names)


Made = Callable[[Rng], Case]


def plain(
    make: Callable[[Rng], Thing], device: Callable[[Rng, Thing, float], World], truth: str, **more: object
) -> Made:
    """A case of one thing, one world, and a hand with differences."""

    def made(rng: Rng) -> Case:
        thing = make(rng)
        own = hand(rng, thing, **more)
        names = () if truth == "?" else of(*truth.split(" + "))
        return Case(thing, device(rng, thing, own.step), own, names, truth != "?", float(rng.uniform(1.5, 6.0)))

    return made


def actuated(
    device: Callable[[Rng, Thing, float], Device],
) -> Callable[[Rng, Thing, float], World]:
    return lambda rng, thing, step: World(actuator=device(rng, thing, step))


def pushed(
    device: Callable[[Rng, Thing, float], Callable[[float, float, int], float]],
) -> Callable[[Rng, Thing, float], World]:
    return lambda rng, thing, step: World(push=device(rng, thing, step))


def simple(rule: Callable[[float, int], float]) -> Device:
    return lambda: rule


def _within(rng: Rng, *runs: int) -> tuple[int, int]:
    """A run of some, of eight without the last two, and a row of it, not near its ends."""
    return int(rng.choice(runs or range(6))), int(rng.integers(15, 46))


def _weak(rng: Rng, thing: Thing, step: float) -> Device:
    share = float(rng.choice([rng.uniform(0.6, 0.88), rng.uniform(1.12, 1.4)]))
    return simple(lambda u, run: share * u)


def _magnet(
    rng: Rng, thing: Thing, step: float, at: float, is_end: bool = False
) -> Callable[[float, float, int], float]:
    reach, pull = 0.09 * thing.length, 0.45 * step
    return lambda c, u, run: -pull * (c - at) / reach * float(np.exp(0.5 - 0.5 * ((c - at) / reach) ** 2))


def _tilting(rng: Rng, thing: Thing) -> Callable[[np.ndarray], tuple[np.ndarray, Rotation]]:
    lean = float(rng.uniform(0.06, 0.12))

    def pose(c: np.ndarray) -> tuple[np.ndarray, Rotation]:
        position, turn = thing.pose(c)
        tilt = Rotation.from_rotvec(np.outer(lean * np.sin(2.0 * c), [1.0, 0.0, 0.0]))
        center = np.array(thing.pieces[0].center)
        return center + tilt.apply(position - center), tilt * turn

    return pose


def _climbing(thing: Thing, pitch: float) -> Callable[[np.ndarray], tuple[np.ndarray, Rotation]]:
    def pose(c: np.ndarray) -> tuple[np.ndarray, Rotation]:
        position, turn = thing.pose(c)
        return position + np.outer(pitch * c, thing.pieces[0].axis), turn

    return pose


def _off_axis(thing: Thing, by: float) -> Callable[[np.ndarray], tuple[np.ndarray, Rotation]]:
    def pose(c: np.ndarray) -> tuple[np.ndarray, Rotation]:
        _, turn = thing.pose(c)
        center = np.array(thing.pieces[0].center) + np.array([by, 0.5 * by, 0.0])
        return center + turn.apply(np.array(thing.start) - center), turn

    return pose


def _ends(upper: float | None = None, lower: float | None = None) -> Callable[[Rng, Thing, float], World]:
    """Ends moved by shares of the range."""
    return lambda rng, thing, step: World(ends=((lower or 0.0) * thing.length, (1.0 + (upper or 0.0)) * thing.length))


BOTH = (-0.15, 1.15)


def _screw_learned_as_hinge(pitch: float) -> Made:
    def made(rng: Rng) -> Case:
        thing = door(rng)
        return Case(
            thing,
            World(beside=_climbing(thing, pitch)),
            hand(rng, thing, noise=0.004),
            of("screw_pitch"),
        )

    return made


def _geometry(world: Callable[[Rng, Thing], World], truth: str) -> Made:
    def made(rng: Rng) -> Case:
        thing = door(rng)
        names = () if truth == "?" else of(truth)
        return Case(thing, world(rng, thing), hand(rng, thing, noise=0.003), names, truth != "?")

    return made


def _far_half(c: float, thing: Thing) -> bool:
    return c > 0.5 * thing.length


KINDS: dict[str, Made] = {
    "gain, one way": plain(drawer, actuated(_weak), "gain", one_way=True, runs=5, rows=30),
    "gain, one run": plain(door, actuated(_weak), "gain", runs=1, rows=120),
    "gain in one mode": plain(
        lambda r: replace((d := door(r)), cuts=(0.5 * d.length,)),
        pushed(lambda r, t, s: lambda c, u, run: -0.3 * u if _far_half(c, t) else 0.0),
        "gain",
    ),
    "gain since half-way": plain(
        drawer, actuated(lambda r, t, s: simple(lambda u, run: 0.7 * u if run >= 4 else u)), "gain", runs=8
    ),
    "gain since within a run": plain(
        door, actuated(lambda r, t, s: changed(_within(r), lambda u: 0.75 * u)), "gain", runs=8
    ),
    "bias since within a run": plain(
        drawer, actuated(lambda r, t, s: changed(_within(r), lambda u: u - 0.2 * s)), "bias", runs=8
    ),
    "dead zone since within a run": plain(
        drawer,
        actuated(lambda r, t, s: changed(_within(r), lambda u: float(np.sign(u) * max(abs(u) - 0.3 * s, 0.0)))),
        "dead_zone",
        runs=8,
    ),
    "gain, weaker since within a run": plain(
        door, actuated(lambda r, t, s: changed(_within(r, 4, 5, 6), lambda u: 0.7 * u, 0.8)), "gain + gain", runs=8
    ),
    "gain, dead zone since within a run": plain(
        drawer,
        actuated(
            lambda r, t, s: changed(_within(r, 4, 5, 6), lambda u: float(np.sign(u) * max(abs(u) - 0.3 * s, 0.0)), 0.8)
        ),
        "gain + dead_zone",
        runs=8,
    ),
    "gain, bias in the last run (?)": plain(
        door, actuated(lambda r, t, s: changed((7, 0), lambda u: u - 0.25 * s, 0.8)), "?", runs=8
    ),
    "wears (?)": plain(
        drawer, actuated(lambda r, t, s: simple(lambda u, run: u * (1.0 - 0.06 * max(run - 1, 0)))), "?", runs=8
    ),
    "bias": plain(drawer, pushed(lambda r, t, s: lambda c, u, run: 0.25 * s), "bias|gravity"),
    "saturation": plain(
        door, actuated(lambda r, t, s: simple(lambda u, run: float(np.clip(u, -0.5 * s, 0.5 * s)))), "saturation"
    ),
    "dead zone, one way": plain(
        door,
        actuated(lambda r, t, s: simple(lambda u, run: float(np.sign(u)) * max(abs(u) - 0.35 * s, 0.0))),
        "dead_zone",
        one_way=True,
        rows=45,
    ),
    "backlash": plain(drawer, actuated(lambda r, t, s: loose(0.9 * s)), "backlash"),
    "delay, two runs": plain(door, actuated(lambda r, t, s: late(int(r.integers(1, 4)))), "delay", runs=2),
    "lag": plain(drawer, actuated(lambda r, t, s: slow(float(r.uniform(0.35, 0.65)))), "lag"),
    "spring": plain(door, pushed(lambda r, t, s: lambda c, u, run: -0.05 * (c - 0.4 * t.length)), "spring"),
    "gravity": plain(flap, pushed(lambda r, t, s: lambda c, u, run: -0.35 * s * float(np.cos(c))), "gravity|spring"),
    "magnet half-way": plain(door, pushed(lambda r, t, s: _magnet(r, t, s, 0.5 * t.length)), "latch"),
    "magnet near shut": plain(door, pushed(lambda r, t, s: _magnet(r, t, s, 0.0)), "latch", span=(-0.1, 0.8)),
    "clings when shut, no mode": plain(
        door, lambda r, t, s: World(cling=(0.7 * s, 0.0), reach=0.004), "guard_hysteresis|latch", span=(-0.12, 0.7)
    ),
    "clings near shut": plain(
        drawer,
        lambda r, t, s: World(cling=(0.6 * s, 0.0), reach=0.05 * t.length),
        "guard_hysteresis|latch|dead_zone",
        span=(-0.12, 0.7),
    ),
    "clings to its mode": plain(
        lambda r: door(r, held=(False, True)),
        lambda r, t, s: World(cling=(0.0, 0.7 * s)),
        "guard_hysteresis",
        span=(0.3, 1.15),
    ),
    "end nearer, mode": plain(
        lambda r: door(r, held=(False, True)), _ends(upper=-0.06), "guard_shift|limit", span=BOTH
    ),
    "end nearer, no mode": plain(drawer, _ends(upper=-0.08), "guard_shift|limit", span=BOTH),
    "end further, no mode": plain(drawer, _ends(upper=0.09), "guard_shift|limit", span=(0.1, 1.3)),
    "end further, mode": plain(
        lambda r: drawer(r, held=(True, False)),
        lambda r, t, s: World(ends=(-0.07 * t.length, t.length)),
        "guard_shift|limit",
        span=(-0.25, 0.9),
    ),
    "end nearer, one way": plain(
        drawer, _ends(upper=-0.1), "guard_shift|limit", one_way=True, span=(0.0, 1.1), rows=40
    ),
    "sensor scale": plain(door, lambda r, t, s: World(read=lambda c, when: 1.08 * c), "sensor_scale", span=BOTH),
    "drift": plain(drawer, lambda r, t, s: World(read=lambda c, when: c + 0.006 * t.length * when), "drift", span=BOTH),
    "places, first order": plain(
        door,
        lambda r, t, s: World(goes_to=second_order(float(r.uniform(0.3, 0.7)), 0.0, 0)),
        "follow",
        rows=90,
    ),
    "places, second order, late": plain(
        door, lambda r, t, s: World(goes_to=second_order(0.25, 0.5, 1)), "follow", rows=90
    ),
    "turned frame": plain(door, lambda r, t, s: World(turned=(0.0, 0.0, 0.5)), "frame_rotation", across=0.4),
    "gain and delay": plain(
        drawer,
        actuated(lambda r, t, s: _weak_and_late),
        "gain + delay",
    ),
    "gain and backlash": plain(
        door, actuated(lambda r, t, s: loose(1.2 * s, lambda u, _: 0.75 * u)), "gain + backlash", rows=90
    ),
    "bias and saturation": plain(
        door,
        lambda r, t, s: World(
            actuator=simple(lambda u, run: float(np.clip(u, -0.5 * s, 0.5 * s))), push=lambda c, u, run: 0.15 * s
        ),
        "bias + saturation",
    ),
    "slide then arc: gain": plain(slide_then_swing, actuated(_weak), "gain"),
    "slide then arc: delay": plain(slide_then_swing, actuated(lambda r, t, s: late(2)), "delay"),
    "arc then slide: weak slide": plain(
        swing_then_slide, pushed(lambda r, t, s: lambda c, u, run: -0.35 * u if c > t.pieces[0].length else 0.0), "gain"
    ),
    "arc then slide: dead zone": plain(
        swing_then_slide, actuated(lambda r, t, s: simple(lambda u, run: u if abs(u) > 0.4 * s else 0.0)), "dead_zone"
    ),
    "screw 40": _screw_learned_as_hinge(0.04),
    "screw 10": _screw_learned_as_hinge(0.01),
    "axis 12 mm beside": _geometry(lambda r, t: World(beside=_off_axis(t, 0.012)), "axis_offset"),
    "half a demonstration: gain": plain(
        lambda r: replace((d := door(r)), told=(0.0, 0.5 * d.length)), actuated(_weak), "gain"
    ),
    "axis tilts on the way (?)": _geometry(lambda r, t: World(beside=_tilting(r, t)), "?"),
    "stick-slip": plain(door, actuated(lambda r, t, s: stick_slip(1.6 * s)), "stick_slip"),
    "warms up (?)": plain(
        drawer, actuated(lambda r, t, s: simple(lambda u, run: u * (1.0 - 0.5 * np.exp(-run / 3.0)))), "?", runs=10
    ),
    "ripple (?)": plain(
        door, pushed(lambda r, t, s: lambda c, u, run: 0.35 * s * float(np.sin(14.0 * c / t.length))), "?"
    ),
    "weak one way": plain(
        drawer, actuated(lambda r, t, s: simple(lambda u, run: 0.65 * u if u < 0 else u)), "direction_gain"
    ),
    "wobbles in time (?)": plain(door, lambda r, t, s: _swaying(s), "?", rows=90),
}


def _weak_and_late() -> Callable[[float, int], float]:
    line = late(2)()
    return lambda u, run: line(0.75 * u, run)


def _swaying(step: float) -> World:
    def made() -> Callable[[float, int], float]:
        rows = [0]

        def send(u: float, _: int) -> float:
            rows[0] += 1
            return u + 0.3 * step * float(np.sin(0.4 * rows[0]))

        return send

    return World(actuator=made)


def control(seed: int) -> Case:
    """A recording with nothing in it: the object and what is hard about the log take turns."""
    rng = np.random.default_rng([seed, 11])
    things = (
        door,
        drawer,
        slide_then_swing,
        swing_then_slide,
        flap,
        lambda r: door(r, held=(True, True)),
        lambda r: drawer(r, held=(True, False)),
    )
    thing = things[seed % len(things)](rng)
    hard = (
        "plain",
        "uneven",
        "coloured",
        "outliers",
        "dropped",
        "pushed",
        "half told",
        "one run",
        "heavy tails",
        "fine",
        "no orientation",
    )
    what = hard[seed % len(hard)]
    more: dict[str, object] = {
        "runs": int(rng.integers(2, 9)),
        "rows": int(rng.integers(30, 100)),
        "moved": float(rng.uniform(0.0, 1.2)),
    }
    more["noise"] = thing.length * float(np.exp(rng.uniform(np.log(5e-4), np.log(5e-3))))
    more |= {
        "uneven": {"jitter": 0.5},
        "coloured": {"memory": 0.7},
        "outliers": {"outliers": 0.03},
        "dropped": {"dropped": 0.06},
        "pushed": {"span": BOTH},
        "one run": {"runs": 1, "rows": 150},
        "heavy tails": {"heavy": True},
        "fine": {"noise": 1e-6 * thing.length},
        "no orientation": {"poses": False},
    }.get(what, {})
    if what == "half told" and len(thing.pieces) == 1:
        thing = replace(thing, told=(0.0, 0.55 * thing.length), held=(thing.held[0], False))
    if rng.random() < 0.3:
        more["span"] = BOTH
    return Case(thing, World(), hand(rng, thing, **more), kind=f"{what}, {len(thing.pieces)} joint(s)")
