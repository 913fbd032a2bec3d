"""How well `explore` opens what nobody has demonstrated, beside a compliant pull and a circle fitted and followed.

    python -m benchmarks explore [--objects 330] [--first-seed 10000] [--faults] [--json FILE]

Objects of `explore_plants.py`, families in turn, all else drawn by seed. Right: opened with 0.19 m of true way and
exactly the true joints, or held if locked. Forces are those at rest after each step. The baselines know the stiffness
of the hand and the axes of the front, and push with 38 N; what kinds they believe is not asked. Coverage: axes (and
centres of hinges) of first joints within the 95 % ellipsoid of the model that is left.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from explore_plants import FAMILIES, LATCHED, HandlePlant, Thing, drawn
from numpy.typing import NDArray
from saving import add_json, save_json

from micah_plan.automaton.joint import axis_basis
from micah_plan.execution.handle import HandlePlant as Checked
from micah_plan.execution.plant import Command
from micah_plan.exploration.run import Exploration, explore
from micah_plan.task.exploration_scene import Scene

Floats = NDArray[np.float64]
_PULL, _ENOUGH = 38.0, 0.19
_BINS = (0.0, 0.5, 0.9, 0.99, 0.999, 1.01)
_NAMED = {  # what says so
    **dict.fromkeys(("out_nan", "out_frozen", "out_late"), ("tracker saw nothing", "tracker has not seen")),
    "slip": ("is seen",),
    "lost": ("has lost the handle", "does not hold the handle"),
    "dies": ("stopped itself",),
    "none": ("tracker", "is seen", "has lost", "does not hold", "stopped"),  # is to be named in none
}
_INSIDE = {2: 5.991, 4: 9.488}  # 95 % of chi squared


@dataclass(frozen=True)
class Score:
    """Of one object: whether opened, right, the largest true force [N], steps, and what else is asked of ours."""

    family: str
    opened: bool
    right: bool
    force: float
    steps: int
    probability: float = 1.0
    inside: bool | None = None
    thinking: float = 0.0


def ours(thing: Thing, seed: int) -> Score:
    """`explore` on an object."""
    plant = HandlePlant(None, thing)
    found = explore(Scene(), Checked(plant), np.random.default_rng(seed))
    opened = plant.travelled >= _ENOUGH
    right = found.outcome == ("held" if thing.is_locked else "opened") and found.kinds == thing.kinds
    right = right and opened != thing.is_locked
    claimed = found.outcome == "opened"
    inside = _covered(found, thing, plant) if right and claimed else None
    force, sure = plant.largest_force, found.probability
    return Score(thing.family, claimed, right, force, found.steps, sure, inside, found.thinking)


def _covered(found: Exploration, thing: Thing, plant: HandlePlant) -> bool | None:
    """Whether the true first axis lies in the 95 % ellipsoid of the model's first joint."""
    if found.model is None:
        return None
    joint = next(mode for mode in found.model.modes if mode.name != "rigid").joints[0]
    if joint.covariance is None:
        return None
    stage, origin = thing.stages[0], plant.track.place[0]
    turn, direction = np.array(stage.turn), np.array(stage.direction)
    rate = float(np.linalg.norm(turn))
    axis = plant.frame.apply(turn / rate if rate else direction)
    sign = 1.0 if axis @ np.array(joint.axis) > 0 else -1.0
    basis, names = axis_basis(joint.axis), joint.covariance.names
    error = basis @ np.cross(joint.axis, sign * axis)
    if rate:
        point = plant.frame.apply(origin + np.cross(turn / rate, direction) / rate) + plant.shift
        off = point - np.array(joint.center)
        off = off - (off @ np.array(joint.axis)) / (axis @ np.array(joint.axis)) * axis
        error = np.concatenate([error, basis @ off])
    number = [names.index(name) for name in ("axis_1", "axis_2", "center_1", "center_2")[: len(error)]]
    covariance = np.array(joint.covariance.matrix)[np.ix_(number, number)]
    return bool(error @ np.linalg.solve(covariance, error) <= _INSIDE[len(error)])


def compliant_pull(thing: Thing, seed: int) -> Score:
    """Pull with all force along the axes in turn until it moves, then on where it went."""
    return _pulled(thing, seed, lambda _, last: last)


def screw_follow(thing: Thing, seed: int) -> Score:
    """As the pull, but along the circle or line through the places of the last joint, as soon as there are some."""
    return _pulled(thing, seed, _along_circle)


def _pulled(thing: Thing, seed: int, onwards: Callable[[Floats, Floats], Floats]) -> Score:
    plant = HandlePlant(None, thing)
    first = plant.reset(np.random.default_rng(seed)).position[0]
    places, direction, steps = [first], np.zeros(3), 0
    lead = min(_PULL / thing.stiffness, 0.05)
    axes = plant.frame.apply(np.concatenate([-np.eye(3)[1:2], np.eye(3), -np.eye(3)]))
    while steps < 300 and np.linalg.norm(places[-1] - first) < 0.2:
        pull = direction if direction.any() else axes[steps % len(axes)]
        seen = plant.apply(Command(lead * pull, lead * pull[None], lead * pull[None])).position[0]
        gone = seen - places[-1]
        steps += 1
        moved = np.linalg.norm(gone) > 4.0 * thing.position_noise
        if moved:
            places.append(seen)
            direction = onwards(np.array(places), gone / np.linalg.norm(gone))
        else:
            direction = np.zeros(3)
    opened = plant.travelled >= _ENOUGH
    return Score(thing.family, opened, opened != thing.is_locked, plant.largest_force, steps)


def _along_circle(places: Floats, last: Floats) -> Floats:
    """(3,) tangent at the last place of the circle through the last ten, or of the line if that is as good."""
    near = places[-10:]
    if len(near) < 5:
        return last
    middle = near.mean(axis=0)
    plane = np.linalg.svd(near - middle)[2][:2]
    x, y = (near - middle) @ plane.T[:, 0], (near - middle) @ plane.T[:, 1]
    line = plane[0] * np.sign(plane[0] @ last)
    solution = np.linalg.lstsq(np.stack([x, y, np.ones(len(x))], axis=1), x**2 + y**2, rcond=None)[0]
    centre = solution[:2] / 2.0
    if not np.isfinite(centre).all() or np.linalg.norm(centre) > 2.0:
        return line
    arm = np.array([x[-1], y[-1]]) - centre
    tangent = np.array([-arm[1], arm[0]]) @ plane
    return np.asarray(tangent / np.linalg.norm(tangent) * np.sign(tangent @ last))


def table(scores: Sequence[Score], pulls: Sequence[Score], screws: Sequence[Score]) -> list[dict[str, Any]]:
    """A row per family, and one of all."""
    rows = []
    for name in (*FAMILIES, "all"):
        own, pull, screw = ([s for s in each if name in ("all", s.family)] for each in (scores, pulls, screws))
        if own:
            mean = lambda values: float(np.mean(list(values)))  # noqa: E731
            rows.append({
                "family": name, "objects": len(own), "right": mean(s.right for s in own),
                "force_median": float(np.median([s.force for s in own])), "force_max": max(s.force for s in own),
                "steps_median": float(np.median([s.steps for s in own])),
                "pull_right": mean(s.right for s in pull), "pull_force": float(np.median([s.force for s in pull])),
                "pull_steps": float(np.median([s.steps for s in pull])),
                "screw_right": mean(s.right for s in screw), "screw_force": float(np.median([s.force for s in screw])),
                "screw_steps": float(np.median([s.steps for s in screw])),
            })  # fmt: skip
    return rows


def faults(first: int, count: int) -> None:
    """Each fault on as many objects: whether it is named, what is said then, and the largest true force."""
    print(f"{'fault':12}{'objects':>8}{'named':>7}{'right':>7}{'gave up':>9}{'wrongly opened':>16}{'max N':>8}")
    for number, (fault, words) in enumerate(_NAMED.items()):
        named = right = gave_up = wrong = 0
        force = 0.0
        for i in range(count):
            seed = first + number * count + i
            thing = drawn(seed, FAMILIES[i % len(FAMILIES)], fault)
            plant = HandlePlant(None, thing)
            found = explore(Scene(), Checked(plant), np.random.default_rng(seed))
            told = any(word in text for text in (found.reason, *found.notes) for word in words)
            named += told
            if told == (fault == "none"):
                print(f"wrongly told: {seed} {thing.family} {fault}: {found.outcome}, {found.reason}")
            gave_up += found.outcome == "gave_up"
            opened = plant.travelled >= _ENOUGH
            wrong += found.outcome == "opened" and not opened
            outcome = "held" if thing.is_locked else "opened"
            right += (found.outcome, found.kinds, opened) == (outcome, thing.kinds, not thing.is_locked)
            force = max(force, plant.largest_force)
        print(f"{fault:12}{count:8}{named:7}{right:7}{gave_up:9}{wrong:16}{force:8.1f}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description="Exploring objects that nobody has demonstrated.")
    parser.add_argument("--objects", type=int, default=330)
    parser.add_argument("--first-seed", type=int, default=10000)
    parser.add_argument("--faults", action="store_true", help="instead: with each fault of FAULTS on as many objects")
    add_json(parser)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    if options.faults:
        faults(options.first_seed, options.objects)
        return
    seeds = range(options.first_seed, options.first_seed + options.objects)
    things = [drawn(seed, FAMILIES[i % len(FAMILIES)]) for i, seed in enumerate(seeds)]
    scores, pulls, screws = (
        [run(t, s) for t, s in zip(things, seeds, strict=True)] for run in (ours, compliant_pull, screw_follow)
    )
    rows = table(scores, pulls, screws)
    print(
        f"{'family':15}{'objects':>8}{'right':>8}{'median N':>10}{'max N':>8}{'steps':>7}"
        + f"{'pull: right, N, steps':>26}{'screw: right, N, steps':>26}"
    )
    for row in rows:
        others = "".join(
            f"{row[k + '_right']:12.0%}{row[k + '_force']:8.1f}{row[k + '_steps']:6.0f}" for k in ("pull", "screw")
        )
        print(
            f"{row['family']:15}{row['objects']:8}{row['right']:8.1%}{row['force_median']:10.1f}{row['force_max']:8.1f}{row['steps_median']:7.0f}{others}"
        )
    free = [s.force for s, t in zip(scores, things, strict=True) if not t.is_locked and t.family not in LATCHED]
    wrong = [s for s, t in zip(scores, things, strict=True) if t.is_locked and s.opened]
    inside = [s.inside for s in scores if s.inside is not None]
    print(f"\nneither latched nor locked: median largest force {np.median(free):.1f} N")
    print(f"locked ones called opened: {len(wrong)}; largest force of all {max(s.force for s in scores):.1f} N")
    stated, right = (np.mean([getattr(score, name) for score in scores]) for name in ("probability", "right"))
    print(f"stated probability {stated:.3f}, right {right:.3f}")
    for low, high in pairwise(_BINS):
        told = [(s.probability, s.right) for s in scores if low <= s.probability < high]
        if told:
            mean, share = np.mean(told, axis=0)
            print(
                f"  stated {low:.2f} to {min(high, 1.0):.2f}: {len(told)} objects, mean {mean:.3f}, right {share:.3f}"
            )
    print(f"axes and centres within the stated 95 %: {np.mean(inside):.1%} of {len(inside)}")
    print(f"CPU of the slowest step: median {1000 * np.median([s.thinking for s in scores]):.0f} ms")
    print(
        "not right:", *(f"{s} {t.family}" for s, t, score in zip(seeds, things, scores, strict=True) if not score.right)
    )
    told = [asdict(score) for score in scores]
    save_json({"rows": rows, "inside": float(np.mean(inside)), "scores": told}, options.json)


if __name__ == "__main__":
    main()
