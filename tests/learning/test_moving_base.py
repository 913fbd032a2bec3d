"""Objects on a tracked base that moves as no joint does: a door on a cart that somebody pushes about."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planted_parts import DOOR, RATE
from scipy.spatial.transform import RigidTransform, Rotation

import micah_plan
from micah_plan.api.learning import learn
from micah_plan.automaton.kinematics import forward
from micah_plan.errors import InputError
from micah_plan.learning.parts.relative import relative_to
from micah_plan.recording.value import Recording

ROWS = 160


def pushed_about(amount: float, seed: int) -> RigidTransform:
    """(ROWS,) poses of a cart on the floor: curves, stops and turns of the size `amount` [m, rad]."""
    rng = np.random.default_rng(seed)
    phase = np.linspace(0, 2 * np.pi, ROWS)[:, None] * rng.uniform(0.5, 1.5, (1, 3)) + rng.uniform(0, 6, (1, 3))
    way = amount * (np.sin(phase) + 0.4 * np.sin(2.3 * phase))
    place = np.column_stack([way[:, :2], np.zeros(ROWS)])
    return RigidTransform.from_components(place, Rotation.from_rotvec(np.outer(way[:, 2], [0.0, 0.0, 1.0])))


def recorded(cart: RigidTransform, seed: int, noise: float = 0.001) -> Recording:
    """Cart and door, opened while the cart is pushed about."""
    rng = np.random.default_rng(seed)
    opened = 1.1 * (1 - np.cos(np.linspace(0, np.pi, ROWS))) / 2
    poses = [cart, cart * forward(DOOR, opened)]
    turned = [Rotation.from_rotvec(4 * noise * rng.standard_normal((ROWS, 3))) * one.rotation for one in poses]
    order = np.arange(2 * ROWS).reshape(2, ROWS).T.ravel()
    whole = Recording(
        time=np.tile(np.arange(ROWS) / RATE, 2),
        position=np.concatenate([one.translation for one in poses]) + noise * rng.standard_normal((2 * ROWS, 3)),
        quaternion=np.concatenate([one.as_quat() for one in turned]),
        action=np.concatenate([np.diff(one.translation, axis=0, append=one.translation[-1:]) for one in poses]),
        part=("cart",) * ROWS + ("door",) * ROWS,
    )
    return whole.rows(order)


def off_axis(joint) -> float:
    return float(np.arccos(min(abs(float(np.dot(joint.axis, DOOR.axis))), 1.0)))


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed", [0, pytest.param(1, marks=pytest.mark.evidence), pytest.param(2, marks=pytest.mark.evidence)]
)
def test_that_two_free_bodies_are_joined_is_found_with_a_remedy(seed: int) -> None:
    """Which of the two stands on the other is a convention: both move freely."""
    learned = learn(recorded(pushed_about(0.5, seed), seed))
    on_base, joined = sorted(learned.graph.edges, key=lambda edge: edge.parent != "base")
    assert (on_base.parent, joined.parent) == ("base", on_base.child)
    assert on_base.segments[0].no_single_joint is not None
    assert [segment.joint.kind for segment in joined.segments] == ["revolute"]
    assert learned.automaton is None
    assert f"--base {on_base.child}" in learned.reason


@pytest.mark.sweep
@pytest.mark.parametrize("amount", [0.0, 0.05, 0.5])
def test_relative_to_the_cart_the_door_has_its_hinge(amount: float) -> None:
    learned = learn(recorded(pushed_about(amount, 4), 4), base="cart")
    (edge,) = learned.graph.edges
    (segment,) = edge.segments
    assert segment.joint.kind == "revolute"
    assert off_axis(segment.joint) < 0.02
    assert learned.automaton is not None
    assert learned.automaton.provenance["frame"] == "part cart"
    assert learned.heading(edge) == "door relative to cart"
    assert learned.recording.parts == ("door",)


@pytest.mark.slow
def test_what_is_learned_predicts_the_relative_recording() -> None:
    recording = recorded(pushed_about(0.5, 5), 5)
    model = micah_plan.learn(recording, base="cart")
    judged = micah_plan.predict(model, relative_to(recording, "cart"))
    assert judged.judgement.one_step.position < 0.004


def test_rows_keep_their_order_and_those_without_the_cart_are_left_out() -> None:
    recording = recorded(pushed_about(0.5, 6), 6, noise=0.0)
    lost = np.array([part == "cart" and 1.0 < t < 3.0 for part, t in zip(recording.part, recording.time, strict=True)])
    seen = relative_to(recording.rows(~lost), "cart")
    assert (np.diff(seen.time) > 0).all()
    assert not ((seen.time > 1.0) & (seen.time < 3.0)).any()
    assert len(seen) == pytest.approx(ROWS - 2 * RATE, abs=2)


def test_several_parts_keep_their_names_and_other_columns() -> None:
    recording = recorded(pushed_about(0.3, 7), 7)
    door = recording.select(part="door")
    both = Recording(
        time=np.concatenate([recording.time, door.time]),
        position=np.concatenate([recording.position, door.position + 0.1]),
        quaternion=np.concatenate([recording.quaternion, door.quaternion]),
        action=np.concatenate([recording.action, door.action]),
        part=recording.part + ("knob",) * ROWS,
        extra={"marker": tuple(str(row) for row in range(3 * ROWS))},
    )
    seen = relative_to(both, "cart")
    assert sorted(seen.parts) == ["door", "knob"]
    kept = [int(row) for row in seen.extra["marker"]]
    assert kept == sorted(kept)
    assert [both.part[row] for row in kept] == list(seen.part)


def test_a_base_that_is_none_is_refused() -> None:
    recording = recorded(pushed_about(0.3, 8), 8)
    with pytest.raises(InputError, match="unknown part 'table'; choose one of"):
        relative_to(recording, "table")
    with pytest.raises(InputError, match="the only part 'door' is the base"):
        relative_to(recording.select(part="door"), "door")
    with pytest.raises(InputError, match="orientation was not measured"):
        relative_to(replace(recording, quaternion=None), "cart")
    apart = replace(recording, run=np.array([int(part == "cart") for part in recording.part]))
    with pytest.raises(InputError, match="in common"):
        relative_to(apart, "cart")
