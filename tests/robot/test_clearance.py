"""Clearances: distances and depths that can be computed by hand, derivatives, and sweeps that miss nothing."""

from __future__ import annotations

import numpy as np
import pytest
from robot_examples import SLIDER, arm7, described
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.automaton.hybrid import Part, Primitive
from micah_plan.errors import InputError
from micah_plan.robot.clearance import ClearanceModel, clearance_model
from micah_plan.robot.load_arm import describe_robot, load_arm
from micah_plan.robot.sweep import MotionBound, sweep_between
from micah_plan.task.body import Body, Hull

TABLE = Body("table", (Primitive("box", (1.2, 1.2, 0.02), (0.5, 0.0, -0.011)),))
BOX = tuple((x, y, z) for x in (-0.05, 0.05) for y in (-0.05, 0.05) for z in (-0.05, 0.05))
ROCK = Body("rock", (Hull(BOX),), position=(0.5, 0.3, 0.2))
STICK = Part("stick", (Primitive("box", (0.02, 0.2, 0.02)),))


def slider(scene: tuple[Body, ...], parts: tuple[Part, ...] = (), carried: tuple[str, ...] = ()) -> ClearanceModel:
    """The cart, a ball of 0.1 m, on its rail: where it stands is known by hand."""
    return clearance_model(load_arm(described(SLIDER, "finger")), scene, parts, carried)


def cart(q: np.ndarray) -> np.ndarray:
    direction = Rotation.from_euler("xyz", [0.1, -0.2, 0.3]).apply([0.6, 0.0, 0.8])
    return np.array([0.0, 0.0, 0.3]) + q[0] * direction


def far_wheel() -> np.ndarray:
    return np.array([0.1, 0.0])


def test_distances_and_depths_are_those_computed_by_hand() -> None:
    q = far_wheel()
    for z, inside in ((1.0, False), (0.45, True)):
        ball = Body("ball", (Primitive("sphere", (0.07,)),), position=(0.0, -0.1, z))
        model = slider((ball,))
        expected = np.linalg.norm(cart(q) - np.array([0.0, -0.1, z])) - 0.17
        found = model.distances(q, {})[model.names.index(("cart", "ball"))]
        assert (expected < 0) == inside
        assert found == pytest.approx(expected, abs=1e-6)


def test_hulls_boxes_and_bodies_that_are_turned_are_alike() -> None:
    q = far_wheel()
    turned = tuple(Rotation.from_euler("xyz", [0.3, 0.2, 0.1]).as_quat().tolist())
    shapes = Primitive("box", (0.1, 0.1, 0.1)), Hull(BOX)
    found = []
    for shape in shapes:
        model = slider((Body("block", (shape,), position=(0.0, -0.3, 0.5), quaternion=turned),))
        found.append(model.distances(q, {}))
    np.testing.assert_allclose(found[0], found[1], atol=1e-6)


def test_the_smallest_distance_names_its_pair_and_can_be_allowed() -> None:
    arm = arm7()
    model = clearance_model(arm, [TABLE, ROCK], [STICK], ["stick"])
    poses = {"stick": arm.poses(arm.rest)[0]}
    lowered = {"stick": RigidTransform.from_translation([0.5, 0.0, -0.002])}
    closest = model.at(arm.rest, lowered)
    assert closest.pair == ("stick", "table")
    assert closest.distance == pytest.approx(-0.011, abs=1e-6)
    assert model.at(arm.rest, lowered, frozenset({("stick", "table")})).pair != ("stick", "table")
    assert model.at(arm.rest, poses).distance > closest.distance


def test_pairs_are_those_that_can_meet_and_should_not() -> None:
    model = clearance_model(arm7(), [TABLE], [STICK], ["stick"])
    names = set(model.names)
    assert ("base_link", "table") not in names  # neither moves
    assert ("shoulder", "table") in names
    assert ("hand", "stick") not in names  # it is what the hand holds
    assert ("forearm", "stick") in names
    assert ("stick", "table") in names
    assert ("shoulder", "upper_link") not in names  # one joint between them
    assert ("forearm", "hand") in names
    assert model.at(model.arm.rest, {"stick": model.arm.poses(model.arm.rest)[0]}).distance > 0.02


def test_an_srdf_takes_pairs_out() -> None:
    srdf = '<robot><disable_collisions link1="hand" link2="forearm" reason="never"/></robot>'
    description = describe_robot(arm_path(), "tool")
    arm = load_arm(type(description)(**{**vars(description), "srdf": srdf}))
    assert ("forearm", "hand") not in clearance_model(arm).names


def arm_path() -> str:
    from robot_examples import ARM7

    return str(ARM7)


def test_derivatives_of_the_clearance_are_its_differences() -> None:
    arm = arm7()
    model = clearance_model(arm, [TABLE, ROCK], [STICK], ["stick"])

    def distance(q: np.ndarray, pair: tuple[str, str]) -> float:
        values = model.distances(q, {"stick": arm.poses(q)[0]})
        return float(min(v for v, name in zip(values, model.names, strict=True) if name == pair))

    step, checked = 1e-5, 0
    for q in arm.sample(np.random.default_rng(5), 40):
        closest, gradient = model.gradient(q, {"stick": arm.poses(q)[0]}, frozenset())
        if closest.distance < 1e-3:
            continue
        expected = [
            (distance(q + step * e, closest.pair) - distance(q - step * e, closest.pair)) / (2 * step)
            for e in np.eye(7)
        ]
        np.testing.assert_allclose(gradient, expected, atol=5e-3)
        checked += 1
    assert checked > 25


def test_missing_parts_and_names_that_occur_twice_are_reported() -> None:
    model = clearance_model(arm7(), [], [STICK])
    with pytest.raises(InputError, match="missing stick"):
        model.at(model.arm.rest, {})
    with pytest.raises(InputError, match="two things are called 'hand'"):
        clearance_model(arm7(), [Body("hand", (Primitive("sphere", (0.1,)),))])


def test_a_sweep_finds_what_lies_between_two_free_postures() -> None:
    arm = arm7()
    start, end = arm.rest.copy(), arm.rest.copy()
    start[0], end[0] = -0.6, 0.6
    hand = arm.poses(arm.rest).translation[0]
    post = Body("post", (Primitive("cylinder", (0.01, 2.0)),), position=(float(hand[0]), float(hand[1]), 0.5))
    model = clearance_model(arm, [post])
    assert min(model.at(q).distance for q in (start, end)) > 0.05
    found = sweep_between(model, MotionBound(model), (start, {}), (end, {}))
    assert found.clearance.distance < 0
    assert found.clearance.pair[1] == "post"
    assert 0.2 < found.share < 0.8


@pytest.mark.slow
def test_a_sweep_is_never_more_hopeful_than_a_dense_check() -> None:
    arm = arm7()
    model = clearance_model(arm, [TABLE, ROCK], [STICK], ["stick"])
    bound = MotionBound(model)
    generator = np.random.default_rng(6)
    relative = RigidTransform.from_components([0, 0, 0.02], Rotation.from_rotvec([0.4, 0, 0]))
    free = blocked = 0
    for q in arm.sample(generator, 60):
        q = 0.5 * (q + arm.rest)
        other = np.clip(q + generator.normal(size=7) * 0.3, arm.lower, arm.upper)
        ends = [
            (row, {"stick": arm.poses(row)[0] * turn})
            for row, turn in ((q, RigidTransform.identity()), (other, relative))
        ]
        found = sweep_between(model, bound, *ends)
        screw = relative.as_exp_coords()
        dense = np.inf
        for share in np.linspace(0, 1, 40):
            row = q + share * (other - q)
            pose = arm.poses(row)[0] * RigidTransform.from_exp_coords(share * screw)
            dense = min(dense, model.at(row, {"stick": pose}).distance)
        if found.clearance.distance >= 0:
            assert dense > -1.1e-3  # the resolution of the sweep
            free += 1
        else:
            blocked += 1
            row = q + found.share * (other - q)
            pose = arm.poses(row)[0] * RigidTransform.from_exp_coords(found.share * screw)
            assert model.at(row, {"stick": pose}).distance == pytest.approx(found.clearance.distance, abs=1e-6)
    assert min(free, blocked) >= 5


def test_no_point_moves_further_than_the_bound() -> None:
    arm = load_arm(described(SLIDER, "finger"))
    model = clearance_model(arm, [ROCK])
    bound = MotionBound(model)
    wheel = next(i for i, item in enumerate(model.geometry.geometryObjects) if item.name.startswith("wheel"))
    rim = np.array([0.2, 0.0, 0.025, 1.0])
    generator = np.random.default_rng(7)
    for q, other in zip(arm.sample(generator, 50), arm.sample(generator, 50), strict=True):
        finger = np.eye(4)
        finger[1, 3] = -0.2  # from the finger's frame back to the wheel's
        moved = np.linalg.norm(((arm.matrix(q) - arm.matrix(other)) @ finger @ rim)[:3])
        assert moved <= bound.levers[wheel] @ np.abs(q - other) + 1e-12
