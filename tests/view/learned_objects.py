"""Hand-made results of learning, with everything that learning can be sure or unsure of."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.special import logsumexp
from view_objects import HINGE, OPEN_AT, door, measured

from micah_plan.automaton.certainty import (
    ActionChannel,
    EdgeCertainty,
    EvidenceTrace,
    NoSingleJoint,
    RowPosterior,
    SegmentCertainty,
)
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.joint import Joint, ParameterCovariance
from micah_plan.automaton.kinematics import forward, inverse
from micah_plan.recording.value import Recording

STD = 0.004
SLIDE = Joint("prismatic", position=(0.3, 0.0, 0.1), axis=(0.0, -1.0, 0.0))
CHANNEL = ActionChannel(
    (0.0, 0.0, 0.21), 0.92, 0.11, tuple(map(tuple, np.diag([0.03, 0.03, 0.02, 0.02, 0.01]) ** 2)), 0.87
)
KINDS_OF_SWING = (("rigid", 0.0), ("prismatic", 0.01), ("revolute", 0.93), ("screw", 0.06))
KINDS_OF_REST = (("rigid", 0.88), ("prismatic", 0.02), ("revolute", 0.09), ("screw", 0.01))


def densities(recording: Recording, joints: dict[str, Joint]) -> np.ndarray:
    """(n, m + 1) log density of every row under each joint at its best configuration, and under free motion."""
    columns = []
    for joint in joints.values():
        apart = recording.position - forward(joint, inverse(joint, recording.position)).translation
        if joint.kind == "rigid":
            apart = recording.position - joint.position
        columns.append(-0.5 * (apart**2).sum(axis=1) / STD**2 - (2.5 if joint.kind == "rigid" else 4.5))
    return np.column_stack([np.maximum(column, -400.0) for column in columns] + [np.full(len(recording), -8.0)])


def row_posterior(before: np.ndarray, after: np.ndarray, first: int, last: int) -> RowPosterior:
    """Of the row at which the density of `after` (n,) replaces that of `before` (n,)."""
    logs = [before[:row].sum() + after[row:].sum() for row in range(first, last + 1)]
    probabilities = np.exp(logs - logsumexp(logs))
    return RowPosterior(tuple(range(first, last + 1)), tuple(float(p) for p in probabilities))


def assessed_door(rows: int = 60, noise: float = 0.004) -> tuple[Recording, KinematicGraph]:
    """The noisy door of `measured`, with a posterior for all that can have one."""
    recording, graph = measured(rows, noise=noise)
    edge = graph.edges[0]
    moving = edge.segments[1].start
    models = {"revolute": HINGE, "prismatic": SLIDE, "rigid": Joint("rigid", HINGE.position)}
    models["rigid_2"] = door().modes[1].joints[0]
    log_density = densities(recording, models)
    start = row_posterior(log_density[:, 0], log_density[:, 3], moving - 8, rows - 1)
    changepoint = np.zeros(rows)
    changepoint[list(start.rows)] = start.probabilities
    spread = ParameterCovariance(
        ("axis_1", "axis_2", "center_1", "center_2"),
        tuple(map(tuple, np.diag([0.012, 0.009, 0.002, 0.003]) ** 2)),
    )
    swing, rest = edge.segments
    swing = dataclasses.replace(
        swing, joint=dataclasses.replace(HINGE, covariance=spread), certainty=SegmentCertainty(None, KINDS_OF_SWING)
    )
    rest = dataclasses.replace(rest, certainty=SegmentCertainty(start, KINDS_OF_REST))
    trace = EvidenceTrace(
        tuple(range(rows)), (*models, "free"), tuple(map(tuple, log_density)), tuple(float(p) for p in changepoint)
    )
    certainty = EdgeCertainty(812.0, ((0.002, 0.961, 0.035, 0.002),), CHANNEL, trace)
    acted = dataclasses.replace(recording, action=np.zeros((rows, 3)))
    return acted, KinematicGraph((dataclasses.replace(edge, segments=(swing, rest), certainty=certainty),))


def no_joint(rows: int = 50) -> tuple[Recording, KinematicGraph]:
    """A part pushed about on a table: two degrees of freedom, so that no single joint fits."""
    rng = np.random.default_rng(3)
    t = np.linspace(0, 1, rows)
    position = np.column_stack([0.3 * t + 0.05 * np.sin(9 * t), 0.1 * np.sin(6 * t), np.full(rows, 0.1)])
    recording = Recording(t * 4, position + rng.normal(0, 0.002, (rows, 3)))
    best = Joint("prismatic", position=(0.0, 0.0, 0.1), axis=(0.98, -0.2, 0.0))
    no_single_joint = NoSingleJoint(0.058, None, 0.002, None, 214.0)
    certainty = SegmentCertainty(
        None, (("rigid", 0.0), ("prismatic", 0.0), ("revolute", 0.0), ("screw", 0.0)), no_single_joint
    )
    segment = Segment(best, 0, 0, rows - 1, 0.0, 0.3, (0.0, 0.3), 0.01, 0.002, -300.0, 0.6, certainty)
    edge = KinematicEdge(BASE, "part", (segment,), EdgeCertainty(-100.0, ((0.97, 0.03),), None, None))
    return recording, KinematicGraph((edge,))


def cabinet_runs(rows: int = 40) -> tuple[Recording, KinematicGraph]:
    """Two parts, their rows one after the other: a door that closes again (rigid, revolute, rigid) and a drawer."""
    rng = np.random.default_rng(5)
    c = np.concatenate(
        [np.zeros(10), np.linspace(0, OPEN_AT, rows - 10), np.linspace(OPEN_AT, 0, rows - 10), np.zeros(10)]
    )
    d = np.linspace(0, 0.25, rows)
    door_poses, drawer_poses = forward(HINGE, c), forward(SLIDE, d)
    position = np.concatenate([door_poses.translation, drawer_poses.translation + np.array([0.1, 0.0, -0.3])])
    quaternion = np.concatenate([door_poses.rotation.as_quat(), drawer_poses.rotation.as_quat()])
    n, last = len(c), len(c) - 10
    recording = Recording(
        np.concatenate([np.arange(n), np.arange(rows)]) / 20,
        position + rng.normal(0, 0.002, position.shape),
        quaternion,
        part=("door",) * n + ("drawer",) * rows,
        has_part=True,
    )
    closed = Joint("rigid", HINGE.position)
    segments = (
        Segment(closed, 0, 0, 9, 0.0, 0.0, (0.0, 0.0), 0.0, 0.01, 30.0, 0.97),
        Segment(HINGE, 0, 10, last - 1, 0.0, 0.0, (0.0, OPEN_AT), 0.004, 0.01, 200.0, 0.99),
        Segment(closed, 0, last, n - 1, 0.0, 0.0, (0.0, 0.0), 0.0, 0.01, 30.0, 0.97),
    )
    slide = dataclasses.replace(SLIDE, position=(0.4, 0.0, -0.2))
    drawer = Segment(slide, 0, n, n + rows - 1, 0.0, 0.25, (0.0, 0.25), 0.003, 0.004, 150.0, 0.99)
    return recording, KinematicGraph((KinematicEdge(BASE, "door", segments), KinematicEdge(BASE, "drawer", (drawer,))))
