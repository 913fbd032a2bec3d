"""Recordings in an automaton's coordinates: one row per time, one column per link, configurations for poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.arrays import Booleans, Floats
from micah_plan.automaton.effects.registry import form
from micah_plan.automaton.hybrid import HybridAutomaton, Link
from micah_plan.automaton.link_motion import link_motions
from micah_plan.errors import InputError, shown
from micah_plan.recording.continuity import continuity
from micah_plan.recording.symmetry import with_unified_orientations
from micah_plan.recording.value import DEFAULT_PART, Recording


@dataclass(frozen=True, eq=False)
class Track:
    """One run of a recording in the automaton's coordinates (T times, l links, n states, m inputs).

    Attributes:
        run: its number in the recording.
        time: (T,) [s].
        position: (T, l, 3) [m] and quaternion: (T, l, 4) of each link's child relative to its parent; the quaternion is
            None where orientation was not measured.
        x: (T, n) measured configuration, from the inverse kinematics along each link's path.
        u: (T-1, m) commanded displacement of the configuration, from the actions by the inverse Jacobian; None if
            the recording has no actions.
        action: (T-1, l, 3) commanded displacement of each part's origin relative to its parent [m]; None as `u`.
        believed: (T, n) configuration that the controller believed, NaN where it was not recorded; None if it never
            was.
        is_outside: whether another sensor than the controller's own measured `x`, such as a ruler.
        led_from: (T, n) configurations that commands start from, where their rows are not those of the commands.
        is_measured: (T,) rows whose poses are measurements, see `recording.continuity`; the others have their commands.
    """

    run: int
    time: Floats
    position: Floats
    quaternion: Floats | None
    x: Floats
    u: Floats | None
    is_measured: Booleans
    action: Floats | None = None
    believed: Floats | None = None
    is_outside: bool = False
    led_from: Floats | None = None

    @property
    def origin(self) -> Floats:
        """(T, n) configurations from which commands count: estimated ones for externally measured logs."""
        if self.led_from is not None:
            return self.led_from
        if self.believed is None or not self.is_outside:
            return self.x
        return np.asarray(np.where(np.isfinite(self.believed), self.believed, self.x))


def measuring_links(automaton: HybridAutomaton) -> tuple[tuple[int, Link], ...]:
    """(number, link) that measures each coordinate: the first of those whose joint moves in most modes.

    A part that is fixed to its parent measures nothing; one that follows the coordinate in some modes measures it there
    only.
    """
    links: dict[int, tuple[int, Link]] = {}
    moves = [sum(mode.joints[n].moves for mode in automaton.modes) for n in range(len(automaton.links))]
    for number, link in enumerate(automaton.links):
        before = links.get(link.coordinate)
        if before is None or moves[before[0]] < moves[number]:
            links[link.coordinate] = (number, link)
    return tuple(links.values())


def tracks(automaton: HybridAutomaton, recording: Recording) -> tuple[Track, ...]:
    """Every run of a recording in the automaton's coordinates.

    Effects of sensors are removed from their readings: from the measured poses or, where another sensor than the
    controller's own measured a log, from the controller's belief. The choice is the one that agrees better.

    Parts are matched to links by name; a recording without a part column matches an automaton with a single link.

    Raises:
        InputError: if parts and links do not match, or the parts of a run were not measured at the same times.
    """
    names = _part_of_link(automaton, recording)
    seen = _RowsByLink.of(automaton, with_unified_orientations(recording), names)
    inside = _tracks(automaton, seen, is_outside=False)
    if inside[0].believed is None or not any(form(effect.name).layer == "sensor" for effect in automaton.effects):
        return inside
    outside = _tracks(automaton, seen, is_outside=True)
    return outside if _estimate_error(outside) < _estimate_error(inside) else inside


def _estimate_error(tracks: tuple[Track, ...]) -> float:
    """Sum of squared estimated minus measured configurations [rad² or m²]."""
    return float(sum(np.nansum((track.believed - track.x) ** 2) for track in tracks if track.believed is not None))


def _part_of_link(automaton: HybridAutomaton, recording: Recording) -> tuple[str, ...]:
    """The part of the recording for each link, in the automaton's order."""
    children = tuple(link.child for link in automaton.links)
    if len(children) == 1 and recording.parts == (DEFAULT_PART,):
        return recording.parts
    missing = [name for name in children if name not in recording.parts]
    if missing:
        raise InputError(
            f"expected the parts {', '.join(children)} of the model, found {', '.join(recording.parts)}",
            where="column 'part'",
            remedy=f"rename the part or take the model of this object (missing: {', '.join(missing)})",
        )
    return children


@dataclass(frozen=True, eq=False)
class _RowsByLink:
    """All runs concatenated (N rows) in the frames of their links, since the overhead is per call.

    Attributes:
        runs: number of each, and its rows.
        by_link: (l) rows of each link's child. relative: (l) the same relative to its parent.
        position: (N, l, 3) [m], quaternion: (N, l, 4) or None, of these.
        x: (N, n) configurations.
    """

    runs: tuple[tuple[int, slice], ...]
    by_link: tuple[Recording, ...]
    relative: tuple[Recording, ...]
    position: Floats
    quaternion: Floats | None
    x: Floats

    @classmethod
    def of(cls, automaton: HybridAutomaton, recording: Recording, names: Sequence[str]) -> _RowsByLink:
        """The rows of each part in one order.

        Raises:
            InputError: if the parts of a run were not measured at the same times.
        """
        rows = {name: [recording.index(run=run, part=name) for run in recording.runs] for name in names}
        for run, *by_part in zip(recording.runs, *(rows[name] for name in names), strict=True):
            for name, of_part in zip(names, by_part, strict=True):
                if not len(of_part):
                    recording.select(run=run, part=name)  # says that there are none
                if not np.array_equal(recording.time[of_part], recording.time[by_part[0]]):
                    raise InputError(
                        f"run {run}: part {shown(name)} was not measured at the same times as part {shown(names[0])}",
                        where="column 't'",
                        remedy="write one row per part and time",
                    )
        edges = np.cumsum([0, *map(len, rows[names[0]])]).tolist()
        runs = tuple((run, slice(a, b)) for run, (a, b) in zip(recording.runs, pairwise(edges), strict=True))
        named = {name: recording.rows(np.concatenate(rows[name])) for name in names}
        relative, position, quaternion = _relative_poses(automaton, named)
        turned = [None if quaternion is None else quaternion[of_run] for _, of_run in runs]
        by_run = zip(runs, turned, strict=True)
        x = np.concatenate([configurations(automaton, position[of_run], q) for (_, of_run), q in by_run])
        return cls(runs, tuple(named[name] for name in names), relative, position, quaternion, x)


def _tracks(automaton: HybridAutomaton, seen: _RowsByLink, *, is_outside: bool) -> tuple[Track, ...]:
    time = seen.by_link[0].time
    since = np.concatenate([time[rows] - time[rows][:1] for _, rows in seen.runs])
    believed = _estimated_configurations(automaton, seen)
    # In a run without recorded beliefs the sensor's own readings were measured.
    tells_beliefs = [believed is not None and bool(np.isfinite(believed[rows]).any()) for _, rows in seen.runs]
    outside = np.repeat(
        [is_outside and by_run for by_run in tells_beliefs], [rows.stop - rows.start for _, rows in seen.runs]
    )
    x = np.where(outside[:, None], seen.x, read_by_sensors(automaton, seen.x, since))
    if believed is not None and is_outside:
        believed = read_by_sensors(automaton, believed, since)
    u = actions = None
    if all(part.action is not None for part in seen.by_link):
        actions = _relative_actions(automaton, seen, x)
        u = displacements(automaton, x, actions)
    return tuple(
        Track(
            run=run,
            time=time[rows],
            position=seen.position[rows],
            quaternion=None if seen.quaternion is None else seen.quaternion[rows],
            x=x[rows],
            u=None if u is None else u[rows][:-1],
            is_measured=np.all([_is_measured(part, rows) for part in seen.by_link], axis=0),
            action=None if actions is None else actions[rows][:-1],
            believed=believed[rows] if believed is not None and is_told else None,
            is_outside=is_outside and is_told,
        )
        for (run, rows), is_told in zip(seen.runs, tells_beliefs, strict=True)
    )


def _is_measured(part: Recording, rows: slice) -> Booleans:
    """(T,) rows of a run that are measurements of its motion."""
    quaternion, action = (None if column is None else column[rows] for column in (part.quaternion, part.action))
    return continuity(part.time[rows], part.position[rows], quaternion, action).is_measured


def _relative_poses(
    automaton: HybridAutomaton, named: dict[str, Recording]
) -> tuple[tuple[Recording, ...], Floats, Floats | None]:
    """Each link's rows relative to its parent, their positions (N, l, 3) and quaternions (N, l, 4)."""
    relative = tuple(_relative(named, link) for link in automaton.links)
    position = np.stack([r.position for r in relative], axis=1)
    quaternions = [r.quaternion for r in relative if r.quaternion is not None]
    return relative, position, np.stack(quaternions, axis=1) if len(quaternions) == len(relative) else None


def _estimated_configurations(automaton: HybridAutomaton, seen: _RowsByLink) -> Floats | None:
    """(N, n) configurations estimated by the controller, NaN where a pose is missing; None if all are.

    They are in the turn of the measured ones.
    """
    poses = {part.part[0]: part.believed() for part in seen.by_link}
    measured = {name: part for name, part in poses.items() if part is not None}
    if len(measured) < len(poses):
        return None
    is_known = np.all([np.isfinite(part.position).all(axis=1) for part in measured.values()], axis=0)
    if not is_known.any():
        return None
    known = {name: part.rows(is_known) for name, part in measured.items()}
    _, position, quaternion = _relative_poses(automaton, known)
    believed = np.full((len(is_known), automaton.n), np.nan)
    believed[is_known] = configurations(automaton, position, quaternion, seen.x[is_known])
    return believed


def read_by_sensors(automaton: HybridAutomaton, x: Floats, since: Floats) -> Floats:
    """Measured configurations (T, n), `since` (T,) s after the start, corrected for sensor effects."""
    read = np.array(x)
    for effect in automaton.effects:
        effect_form = form(effect.name)
        if effect_form.layer == "sensor":  # these are affine
            i = automaton.index(effect.coordinate)
            zero = effect_form.measured(np, 0.0 * since, since, effect.values)
            slope = effect_form.measured(np, 1.0 + 0.0 * since, since, effect.values) - zero
            read[:, i] = (read[:, i] - zero) / slope
    return read


def _relative(parts: dict[str, Recording], link: Link) -> Recording:
    """The rows of a link's child with poses in its parent's frame instead of the base frame, without actions."""
    child = parts[link.child] if link.child in parts else next(iter(parts.values()))
    parent = parts.get(link.parent)
    if parent is None:
        return child
    if parent.quaternion is None:
        raise InputError(
            f"part {shown(link.child)} moves with {shown(link.parent)}, whose orientation was not measured",
            where="columns qx, qy, qz, qw",
            remedy="record the orientation of every part that carries another",
        )
    frame = parent.poses().inv()
    pose = frame * child.poses()
    return replace(
        child,
        position=pose.translation,
        quaternion=None if child.quaternion is None else pose.rotation.as_quat(),
        action=None,
    )


def _relative_actions(automaton: HybridAutomaton, seen: _RowsByLink, x: Floats) -> Floats:
    """(N, l, 3) commanded displacements of the parts' origins relative to their parents [m].

    The action of a part on a moving parent includes the parent's commanded motion: the remainder for its own joint
    counts from where its parent was commanded to go, f(c + u) of the links before it. This inverts how a command of the
    model is written as displacements; where the parent really went does not count.
    """
    ahead: dict[str, RigidTransform] = {}
    actions, lasts = [], [own.stop - 1 for _, own in seen.runs]
    for number, (link, part, relative) in enumerate(zip(automaton.links, seen.by_link, seen.relative, strict=True)):
        asked = part.position.copy() if part.action is None else part.position + part.action
        asked[lasts] = part.position[lasts]  # nothing follows
        frame = ahead.get(link.parent)
        within = asked if frame is None else frame.inv().apply(asked)
        actions.append(within - relative.position)
        path, c = link_motions(automaton)[number], x[:, link.coordinate]
        u = np.nan_to_num(path.commanded(c, actions[-1]))
        moved = path.poses(c + u) * path.poses(c).inv() * relative.poses()
        ahead[link.child] = moved if frame is None else frame * moved
    return np.stack(actions, axis=1)


def configurations(
    automaton: HybridAutomaton, position: Floats, quaternion: Floats | None, near: Floats | None = None
) -> Floats:
    """(T, n) configurations of the measured poses of one run: position (T, l, 3) [m], quaternion (T, l, 4) per link.

    Args:
        near: (T, n) configurations to choose the whole turns of hinges by; None: by the range and the run.
    """
    x = np.zeros((len(position), automaton.n))
    for number, link in measuring_links(automaton):
        rotation = None if quaternion is None else Rotation.from_quat(quaternion[:, number])
        turns = None if near is None else near[:, link.coordinate]
        x[:, link.coordinate] = link_motions(automaton)[number].configurations(position[:, number], rotation, turns)
    return x


def displacements(automaton: HybridAutomaton, x: Floats, action: Floats) -> Floats:
    """(T-1, m) inputs of commanded displacements (T-1, l, 3) [m] of the parts' origins at x (>= T-1, n).

    Source: MICAH, equation for Δ̂_t: the inverse Jacobian maps an action to a change of configuration. With fewer
    inputs than coordinates, those that move in the first mode determine the inputs: the rest follows by contact.

    Raises:
        InputError: if the first mode does not determine the inputs.
    """
    followed = {
        automaton.index(effect.coordinate) for effect in automaton.effects if form(effect.name).layer == "place"
    }
    u = np.zeros((len(action), automaton.n))
    for number, link in measuring_links(automaton):
        path, c = link_motions(automaton)[number], x[: len(action), link.coordinate]
        meant = in_base_frame(automaton, link.coordinate, action[:, number])
        u[:, link.coordinate] = (path.aimed if link.coordinate in followed else path.commanded)(c, meant)
    if automaton.m == automaton.n:
        return u
    effect = np.array(automaton.modes[0].B)
    driven = effect.any(axis=1)
    if np.linalg.matrix_rank(effect) < automaton.m:
        raise InputError("actions do not show the inputs: in the first mode some have no coordinate of their own")
    return np.asarray(u[:, driven] @ np.linalg.pinv(effect[driven]).T)


def in_base_frame(automaton: HybridAutomaton, coordinate: int, action: Floats) -> Floats:
    """Actions (k, 3) with the automaton's frame effects removed."""
    for effect in automaton.effects:
        if form(effect.name).layer == "frame" and automaton.index(effect.coordinate) == coordinate:
            unit, a = np.eye(3), list(action.T)
            action = np.stack([form(effect.name).frame_command(np, a, list(e), effect.values) for e in unit], axis=1)
    return action
