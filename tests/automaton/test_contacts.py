"""Contact modes of a held object: which there are, and that geometry and dynamics agree."""

from dataclasses import replace

import numpy as np
import pytest
from held_stapler import AROUND, GRIP, LATCH, NOISE, PITCH, TABLE, stapler
from scipy.spatial.transform import Rotation

from micah_plan.automaton.contacts.hit import collision_regions
from micah_plan.automaton.contacts.product import COLLIDED, with_contacts
from micah_plan.automaton.contacts.touch import box_corners, moved, touch_pieces
from micah_plan.automaton.contacts.values import Face
from micah_plan.automaton.drawn_thresholds import threshold_stds
from micah_plan.automaton.hybrid import Part, Primitive
from micah_plan.automaton.transition import TransitionBatch, simulate, step
from micah_plan.belief.filter import initial_belief, predict_belief, repeated_belief, update
from micah_plan.errors import InputError
from micah_plan.symbolic.compiled import compiled_mode

TASK = with_contacts(stapler(), GRIP, AROUND, NOISE)


def lowest_point(grip, hand, displacement, turn=0.0):
    """Height of the lowest corner of the moving part, from the pose of every corner: a second derivation."""
    rotation = Rotation.from_rotvec(grip.rotation) * Rotation.from_rotvec([0.0, turn, 0.0])
    points = moved(box_corners(grip.moving.shapes), displacement, True)
    return (hand + rotation.apply(points - np.array(grip.point)))[:, 2].min()


def modes(task):
    return [mode.name for mode in task.modes if mode.name != COLLIDED]


def test_a_stapler_has_the_four_modes_of_the_paper():
    assert modes(TASK) == ["free", "line", "surface", "rigid"]
    names = {edge.name for edge in TASK.edges if edge.target != COLLIDED and not edge.is_self_transition}
    assert names == {
        "free -> line", "line -> free", "line -> surface", "surface -> line", "surface -> rigid", "free -> rigid",
    }  # fmt: skip


def test_a_part_that_is_held_fast_lies_flat_but_does_not_close():
    task = with_contacts(stapler(), replace(GRIP, pivots=False), AROUND)
    assert modes(task) == ["free", "line", "rigid"]
    assert not [edge for edge in task.edges if edge.target == "rigid" and edge.source == "line"]


def test_without_a_latch_there_is_no_rigid_mode():
    task = with_contacts(stapler(latches=False), replace(GRIP, datum=LATCH), AROUND)
    assert modes(task) == ["free", "line", "surface"]


def on_chord(piece, c):
    """The hand's height where the joint is at c."""
    return piece.begin_height + piece.slope * (c - piece.begin)


def test_the_edge_touches_where_the_geometry_says_and_lies_flush_at_the_pitch_of_the_hand():
    line, surface = touch_pieces(GRIP, TABLE, LATCH, 0.0, LATCH, True)
    assert line.end == pytest.approx(LATCH - PITCH, abs=1e-9)
    assert (surface.begin, surface.end) == (line.end, LATCH)
    for c, height in ((line.begin, line.begin_height), (line.end, line.end_height)):
        assert lowest_point(GRIP, [0.0, 0.0, height], c - LATCH) == pytest.approx(0.0, abs=1e-9)
    places = np.linspace(line.begin, line.end, 50)
    worst = max(abs(lowest_point(GRIP, [0.0, 0.0, on_chord(line, c)], c - LATCH)) for c in places)
    assert worst == pytest.approx(0.000888, rel=0.01)  # as the docstring of `touch` says
    # Flat on the table the lower arm keeps its pose while the upper one turns in the hand.
    assert lowest_point(GRIP, [0.0, 0.0, surface.end_height], 0.0, PITCH) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("turn", [0.0, 0.7, -2.0])
def test_contacts_do_not_depend_on_where_the_base_frame_points(turn):
    about_z = Rotation.from_rotvec([0.0, 0.0, turn]) * Rotation.from_rotvec(GRIP.rotation)
    turned = replace(GRIP, rotation=tuple(about_z.as_rotvec()))
    for mine, other in zip(
        touch_pieces(GRIP, TABLE, LATCH, 0.0, LATCH, True),
        touch_pieces(turned, TABLE, LATCH, 0.0, LATCH, True),
        strict=True,
    ):
        assert other.kind == mine.kind
        values = [(p.begin, p.end, p.begin_height, p.end_height) for p in (mine, other)]
        assert values[1] == pytest.approx(values[0], abs=1e-9)


def test_pressing_closes_the_stapler_latches_it_and_it_stays_latched():
    down, up = [[0.0, 0.0, -0.01]] * 30, [[0.0, 0.0, 0.01]] * 10
    run = simulate(TASK, "free", [-0.1, 0.0, 0.25, 0.15], down + up)
    visited = [mode for i, mode in enumerate(run.modes) if i == 0 or mode != run.modes[i - 1]]
    assert visited == ["free", "line", "surface", "rigid"]
    heights, angles = run.states[:, 2], run.states[:, 3]
    line, surface = touch_pieces(GRIP, TABLE, LATCH, 0.0, LATCH, True)
    assert heights.min() == pytest.approx(surface.end_height)
    assert angles[-1] == LATCH
    assert (np.diff(angles) >= 0).all()
    for k, mode in enumerate(run.modes):
        if mode in ("line", "surface"):
            piece = line if mode == "line" else surface
            assert heights[k] == pytest.approx(on_chord(piece, angles[k]), abs=1e-9)


def test_a_stapler_that_is_lifted_before_it_latches_stays_open():
    run = simulate(TASK, "free", [-0.1, 0.0, 0.15, 0.15], [[0.0, 0.0, -0.01]] * 6 + [[0.0, 0.0, 0.02]])
    assert run.modes[-2:] == ("line", "free")
    assert 0.15 < run.states[-1, 3] < LATCH


def test_disturbances_move_a_tied_joint_with_the_hand():
    tie = TASK.mode("line").ties[0]
    z = 0.1
    x = np.array([0.0, 0.0, z, tie.value(np.array([0.0, 0.0, z, 0.0]))])
    after = step(TASK, "line", x, np.zeros(3), [0.001, 0.0, -0.002, 0.3])
    assert after.mode == "line"
    assert after.x[3] == pytest.approx(tie.value(after.x))
    factor = compiled_mode(TASK, "line").predict(x, np.zeros((4, 4)), np.zeros(3))[1].full()
    noise = factor @ factor.T
    assert noise[3] == pytest.approx(tie.weights[2] * noise[2], rel=1e-6, abs=1e-15)


def test_batched_steps_are_the_scalar_ones_in_contact():
    rng = np.random.default_rng(3)
    names = [mode.name for mode in TASK.modes]
    count = 60
    x = np.column_stack([rng.normal(0, 0.02, (count, 2)), rng.uniform(0.06, 0.16, count), rng.uniform(0, 0.5, count)])
    u, w = rng.normal(0, 0.01, (count, 3)), rng.normal(0, 0.003, (count, 4))
    chosen = rng.integers(0, 4, count)
    batch = TransitionBatch(TASK, np.zeros((count, threshold_stds(TASK).size)))
    after, states = batch.step(chosen, x, u, w)
    for i in range(count):
        one = step(TASK, names[chosen[i]], x[i], u[i], w[i])
        assert names[after[i]] == one.mode
        np.testing.assert_allclose(states[i], one.x, atol=1e-12)


def test_contact_is_information():
    belief = initial_belief(TASK, [-0.1, 0.0, 0.13, 0.2], [0.01, 0.01, 0.01, 0.1], "free")
    for _ in range(5):
        belief = predict_belief(TASK, belief, [0.0, 0.0, -0.007])
    line = [mode.name for mode in TASK.modes].index("line")
    assert belief.weights[line] > 0.5
    factor, tie = belief.factors[line], TASK.mode("line").ties[0]
    across = np.array([*(-np.array(tie.weights[:3])), 1.0]) @ factor
    assert np.linalg.norm(across) < 1e-6
    assert np.linalg.norm(factor[2]) > 2e-3
    seen = update(TASK, belief, [np.nan, np.nan, np.nan, float(belief.means[line, 3])])
    assert np.linalg.norm(seen.factors[line, 2]) < np.linalg.norm(factor[2])


def test_batched_filter_is_the_scalar_one_in_contact():
    belief = initial_belief(TASK, [-0.1, 0.0, 0.13, 0.2], [0.01, 0.01, 0.01, 0.1], "free")
    many = repeated_belief(TASK, belief, 2)
    for _ in range(8):
        belief = predict_belief(TASK, belief, [0.01, 0.0, -0.008])
        many = predict_belief(TASK, many, np.array([[0.01, 0.0, -0.008]] * 2))
    np.testing.assert_allclose(many.weights[1], belief.weights, atol=1e-6)
    best = belief.most_likely
    np.testing.assert_allclose(many.means[1, best], belief.means[best], atol=1e-6)


def test_no_true_overlap_is_outside_of_the_collision_sets():
    rng = np.random.default_rng(1)
    regions = collision_regions(GRIP, AROUND, LATCH, 0.0, LATCH, True)
    rotation = Rotation.from_rotvec(GRIP.rotation)
    inside_some, outside_all = 0, 0
    for _ in range(2000):
        hand, c = rng.uniform(AROUND.lower, AROUND.upper), rng.uniform(0.0, LATCH)
        parts = (box_corners(GRIP.held.shapes), moved(box_corners(GRIP.moving.shapes), c - LATCH, True))
        solid = AROUND.solids[rng.integers(2)]
        part = parts[rng.integers(2)]
        # Points inside a part: mixtures of its corners.
        points = rng.dirichlet(np.ones(len(part)), 60) @ part
        placed = hand + rotation.apply(points - np.array(GRIP.point))
        hits = bool(((placed > solid.lower) & (placed < solid.upper)).all(axis=1).any())
        flagged = any(region.contains(np.array([*hand, c]), np.zeros(3)) for region in regions)
        assert flagged or not hits
        inside_some += hits
        outside_all += not flagged
    assert min(inside_some, outside_all) > 50


def test_the_same_object_closes_against_a_wall():
    # Turned by a right angle about y: the wall at x = 0 looks along +x, the hand presses along -x.
    turned = Rotation.from_rotvec([0.0, np.pi / 2, 0.0]) * Rotation.from_rotvec(GRIP.rotation)
    wall = Face("wall", 0, 1, 0.0)
    around = replace(AROUND, solids=(), faces=(wall,), lower=(0.0, -0.2, -0.3), upper=(0.6, 0.2, 0.3))
    task = with_contacts(stapler(), replace(GRIP, rotation=tuple(turned.as_rotvec())), around)
    run = simulate(task, "free", [0.25, 0.0, 0.0, 0.15], [[-0.01, 0.0, 0.0]] * 30)
    assert list(dict.fromkeys(run.modes)) == ["free", "line", "surface", "rigid"]


@pytest.mark.parametrize(("pitch", "sign"), [(0.05, -1), (0.75, 1)])
def test_pressing_opens_or_closes_as_the_geometry_says(pitch, sign):
    # A flap that hangs 0.35 rad to one side of the vertical: pressing folds it further to that side.
    flap = Part("flap", (Primitive("box", (0.004, 0.04, 0.1), (0.0, 0.0, -0.05)),))
    grip = replace(GRIP, moving=flap, rotation=(0.0, -pitch, 0.0), datum=LATCH, travel=0.8, pivots=False)
    task = with_contacts(stapler(latches=False), grip, replace(AROUND, solids=()))
    start = LATCH - 0.4
    run = simulate(task, "free", [0.0, 0.0, 0.2, start], [[0.0, 0.0, -0.004]] * 18)
    assert run.modes[-1].startswith("line")
    assert 0.05 < sign * (run.states[-1, 3] - start) < 0.4


def test_models_that_contacts_cannot_be_built_on_are_refused():
    with pytest.raises(InputError, match="datum"):
        with_contacts(_endless(), GRIP, AROUND)
    with pytest.raises(InputError, match="one joint"):
        with_contacts(TASK, GRIP, AROUND)


def _endless():
    model = stapler(latches=False)
    mode = replace(model.modes[0], invariant=type(model.modes[0].invariant)())
    return replace(model, modes=(mode,))
