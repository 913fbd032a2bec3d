"""Recordings from what programs have at hand: dictionaries of columns or arrays, data frames, tables of Arrow."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest
from extras import requires
from numpy.testing import assert_allclose, assert_array_equal

from micah_plan import Recording, learn, load
from micah_plan.errors import InputError, MissingDependencyError
from micah_plan.recording.read import read_recording

N = 40


class Frame:
    """As much of a data frame as is used: names of columns, and columns that are no arrays."""

    def __init__(self, columns: dict[str, Any]) -> None:
        self._columns = columns

    @property
    def columns(self) -> list[str]:
        return list(self._columns)

    def __getitem__(self, name: str) -> list[Any]:
        return np.asarray(self._columns[name]).tolist()


def drawer() -> dict[str, Any]:
    pulled = np.linspace(0.0, 0.3, N) + np.random.default_rng(0).normal(0, 1e-3, N)
    return {"t": np.arange(N) / 20, "x": pulled, "y": np.zeros(N), "z": np.full(N, 0.4)}


@pytest.mark.parametrize("make", [dict, Frame, pytest.param("arrow", marks=requires("parquet"))])
def test_tables_are_recordings(make: Any) -> None:
    columns = drawer() | {
        "part": ["drawer"] * N,
        "run": np.repeat([0, 1], N // 2),
        "note": ["a"] * N,
        "count": range(N),
    }
    if make == "arrow":
        from pyarrow import table as make
    recording = load(make({name: list(values) for name, values in columns.items()}))
    assert isinstance(recording, Recording)
    assert_allclose(recording.position, np.column_stack([columns[axis] for axis in "xyz"]))
    assert recording.parts == ("drawer",)
    assert recording.runs == (0, 1)
    assert recording.extra["note"] == ("a",) * N
    assert recording.extra["count"][3] == "3"


def test_a_table_is_learned_as_its_file_is(tmp_path: Any) -> None:
    recording = load(drawer())
    names = ",".join(drawer())
    rows = [",".join(repr(float(value)) for value in row) for row in zip(*drawer().values(), strict=True)]
    (tmp_path / "drawer.csv").write_text("\n".join([names, *rows]) + "\n")
    by_table, by_file = learn(drawer()), learn(tmp_path / "drawer.csv")
    assert isinstance(recording, Recording)
    assert recording.digest() == read_recording(tmp_path / "drawer.csv").digest()
    assert by_table.automaton == by_file.automaton


def test_arrays_by_the_names_of_a_recording() -> None:
    position = np.column_stack([drawer()[axis] for axis in "xyz"])
    recording = load({"time": drawer()["t"], "position": 1000 * position}, length="mm")
    assert isinstance(recording, Recording)
    assert_allclose(recording.position, position)
    with pytest.raises(InputError, match="a recording has no 'pose'; choose among action, extra, force, part"):
        load({"time": drawer()["t"], "position": position, "pose": position})


def test_conventions_of_a_table() -> None:
    theirs = {"Time": 1000 * drawer()["t"], "TX": 1000 * drawer()["x"], "TY": -1000 * drawer()["y"], "h": drawer()["z"]}
    names = {"t": "Time", "x": "TX", "y": "-TY", "z": "1000 * h"}
    recording = load(Frame(theirs), columns=names, length="mm", time="ms", name="drawer")
    assert isinstance(recording, Recording)
    assert_allclose(recording.position, np.column_stack([drawer()[axis] for axis in "xyz"]), atol=1e-12)
    assert_allclose(recording.time, drawer()["t"])
    assert recording.parts == ("drawer",)
    assert isinstance(load(dict(theirs), columns=names, length="mm", time="ms"), Recording)


def test_times_of_day_are_seconds() -> None:
    stamps = np.datetime64("2026-11-25T12:00:00") + (1e6 * drawer()["t"]).astype("timedelta64[us]")
    recording = load(drawer() | {"t": stamps})
    assert isinstance(recording, Recording)
    assert_allclose(np.diff(recording.time), 0.05, atol=1e-6)
    in_ms = load(drawer() | {"t": stamps}, time="ms")  # a time of day has no unit
    assert isinstance(in_ms, Recording)
    assert_allclose(in_ms.time, recording.time)
    passed = load(drawer() | {"t": stamps - stamps[0]})
    assert isinstance(passed, Recording)
    assert_allclose(passed.time, drawer()["t"], atol=1e-6)


def test_rows_without_a_pose_are_gaps() -> None:
    columns = drawer()
    for axis in "xyz":
        columns[axis][3] = np.nan
    recording = load(columns)
    assert isinstance(recording, Recording)
    assert len(recording) == N - 1
    assert "1 row of 40 have no pose" in recording.notes[0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"y": np.zeros(N - 1)}, "expected columns of one length, found 39 rows of 'y' and 40 of 't'"),
        ({"x": ["far"] * N}, "expected numbers in the column 'x'"),
        ({"run": np.linspace(0, 1, N)}, "expected integers in the column 'run'"),
        ({"qx": np.zeros(N)}, "column 'qy' is missing although 'qx' is there"),
        ({"x": np.full(N, np.inf)}, "row 0, column 'x': expected a finite number"),
    ],
)
def test_tables_that_are_none(change: dict[str, Any], message: str) -> None:
    load(drawer())
    with pytest.raises(InputError) as refused:
        load(drawer() | change)
    assert message in str(refused.value)


def test_what_is_no_table() -> None:
    with pytest.raises(InputError, match="expected a recording"):
        learn(3)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="column 't' is missing, found 'x'"):
        learn({"x": [1, 2, 3]})
    with pytest.raises(InputError):
        learn({})
    position = np.zeros((N, 3))
    for given, message in (
        ({"position": position}, "the array 'time' is missing"),
        ({"time": ["noon"] * N, "position": position}, "expected arrays of numbers"),
        ({"time": np.arange(N), "position": [[0.0, 0.0], [0.0]] * (N // 2)}, "expected arrays of numbers"),
        ({"t": 3, "x": 1, "y": 1, "z": 1}, "row"),
    ):
        with pytest.raises(InputError, match=message):
            learn(given)


def test_a_recording_as_columns_and_as_a_data_frame(repository: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    original = read_recording(repository / "examples" / "demonstrations" / "cabinet.csv")
    again = load(original.columns())
    assert isinstance(again, Recording)
    assert again.digest() == original.digest()
    assert_array_equal(original.columns()["ax"], original.action[:, 0])  # type: ignore[index]
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingDependencyError, match="pip install pandas"):
        original.to_pandas()


def test_a_data_frame_of_pandas(repository: Any) -> None:
    original = read_recording(repository / "examples" / "demonstrations" / "cabinet.csv")
    again = load(original.to_pandas())
    assert isinstance(again, Recording)
    assert again.digest() == original.digest()
