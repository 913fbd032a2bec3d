"""What the commands of a recording mean: said by options, conventions, columns; kept in files; never said twice."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from micah_plan import learn, load
from micah_plan.api.inputs import joined_recordings
from micah_plan.automaton.effects.memories import is_as_commanded
from micah_plan.errors import InputError
from micah_plan.recording.commands import MEANING_COLUMN, command_meaning, with_commands
from micah_plan.recording.conventions import Conventions
from micah_plan.recording.read import read_recording, write_recording
from micah_plan.recording.value import Recording

ROWS = 40
PLACE = np.linspace(0.0, 0.3, ROWS) ** 2 + 0.1
TIME = np.cumsum(np.tile([0.05, 0.1], ROWS // 2))


def drawer() -> Recording:
    """A drawer along x with the displacement to the next row as its action."""
    position = np.column_stack([PLACE, 0.2 + 0.0 * PLACE, 0.4 + 0.0 * PLACE])
    action = np.vstack([np.diff(position, axis=0), np.full((1, 3), np.nan)])
    return Recording(time=TIME, position=position, action=action)


def written(folder: Path, header: str, columns: list[np.ndarray]) -> Path:
    texts = [["" if np.isnan(value) else repr(float(value)) for value in column] for column in columns]
    rows = map(",".join, zip(*texts, strict=True))
    (folder / "log.csv").write_text("\n".join([header, *rows]) + "\n")
    return folder / "log.csv"


@pytest.mark.parametrize("suffix", [".csv", ".npz"])
@pytest.mark.parametrize("kind", ["displacement", "position"])
def test_a_stated_meaning_is_kept_in_files(tmp_path: Path, suffix: str, kind) -> None:
    said = with_commands(drawer(), kind)
    write_recording(said, tmp_path / f"log{suffix}")
    again = read_recording(tmp_path / f"log{suffix}")
    assert command_meaning(again) == kind
    np.testing.assert_array_equal(again.action, drawer().action)
    assert command_meaning(drawer()) is None


def test_velocities_become_displacements_over_uneven_times(tmp_path: Path) -> None:
    speed = drawer().action / np.diff(TIME, append=np.nan)[:, None]
    log = written(tmp_path, "t,x,y,z,ax,ay,az", [TIME, *drawer().position.T, *speed.T])
    read = read_recording(log, conventions=Conventions(commands="velocity"))
    np.testing.assert_allclose(read.action, drawer().action, atol=1e-15)
    assert command_meaning(read) == "displacement"
    with pytest.raises(
        InputError, match="of the kind velocity are given, but the column 'command_meaning' has displacement"
    ):
        with_commands(read, "velocity")


def test_velocities_of_several_runs_and_parts_are_each_by_themselves() -> None:
    one, two = with_names(drawer(), "left"), with_names(drawer(), "right")
    both = Recording(
        time=np.concatenate([one.time, two.time]),
        position=np.vstack([one.position, two.position]),
        action=np.vstack([one.action, two.action]),
        part=one.part + two.part,
    )
    moved = with_commands(both, "velocity").action
    period = np.diff(TIME, append=np.nan)[:, None]
    np.testing.assert_allclose(moved, np.vstack([drawer().action * period] * 2))


def with_names(recording: Recording, name: str) -> Recording:
    return replace(recording, part=(name,) * len(recording))


def test_columns_with_commanded_places_are_positions(tmp_path: Path) -> None:
    """In millimetres, with other names, and none in the last row."""
    goal = drawer().position + 0.01
    goal[-1] = np.nan
    log = written(tmp_path, "t,X,Y,Z,GX,GY,GZ", [TIME, *1e3 * drawer().position.T, *1e3 * goal.T])
    columns = {"x": "X", "y": "Y", "z": "Z", "target x": "GX", "target y": "GY", "target z": "GZ"}
    read = read_recording(log, conventions=Conventions(columns=columns, length="mm"))
    assert command_meaning(read) == "position"
    np.testing.assert_allclose(read.action[:-1], 0.01, atol=1e-12)
    assert np.isnan(read.action[-1]).all()
    values = {"t": TIME} | dict(zip("XYZ", 1e3 * drawer().position.T, strict=True))
    values |= dict(zip(("GX", "GY", "GZ"), 1e3 * goal.T, strict=True))
    table = load(values, columns=columns, length="mm")
    assert isinstance(table, Recording)
    np.testing.assert_allclose(table.action, read.action, atol=1e-12)


def test_targets_need_all_three_and_no_actions(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected all of target x,target y,target z"):
        Conventions(columns={"target x": "GX"})
    goal = drawer().position
    log = written(tmp_path, "t,x,y,z,ax,ay,az,GX,GY,GZ", [TIME, *goal.T, *drawer().action.T, *goal.T])
    columns = {"target x": "GX", "target y": "GY", "target z": "GZ"}
    with pytest.raises(InputError, match="has actions or targets, not both"):
        read_recording(log, conventions=Conventions(columns=columns))


def test_a_column_with_another_meaning_is_reported_with_its_row(tmp_path: Path) -> None:
    said = with_commands(drawer(), "position")
    texts = list(said.extra[MEANING_COLUMN])
    texts[7] = "displacement"
    with pytest.raises(InputError, match=r"row 8.*expected displacement or position, the same"):
        command_meaning(replace(said, extra={MEANING_COLUMN: tuple(texts)}))
    lines = (tmp_path / "log.csv", said)
    write_recording(said, lines[0])
    lines[0].write_text(lines[0].read_text().replace("position", "torque"))
    with pytest.raises(InputError, match="found 'torque'"):
        read_recording(lines[0])


def test_what_is_not_there_means_nothing_and_unknown_kinds_are_named() -> None:
    with pytest.raises(InputError, match="of the kind position are given, but the recording has no commands"):
        with_commands(replace(drawer(), action=None), "position")
    with pytest.raises(InputError, match="expected one of displacement, position, velocity, found 'torque'"):
        with_commands(drawer(), "torque")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="commands: expected one of"):
        Conventions(commands="torque")  # type: ignore[arg-type]


def test_recordings_of_different_meaning_are_not_joined() -> None:
    place, way = with_commands(drawer(), "position"), with_commands(drawer(), "displacement")
    assert command_meaning(joined_recordings([place, place])) == "position"
    assert command_meaning(joined_recordings([drawer(), drawer()])) is None
    for other in (way, drawer()):
        with pytest.raises(InputError, match=r"mean different things: position, (displacement|not said)"):
            joined_recordings([place, other])


def test_a_model_learned_from_positions_reports_it() -> None:
    effects = learn(with_commands(drawer(), "position")).automaton.effects
    assert [is_as_commanded(effect) for effect in effects] == [True]
    assert learn(drawer()).automaton.effects == ()
