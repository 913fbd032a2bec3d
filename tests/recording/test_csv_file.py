"""The recording CSV: what is read, what is written, and that both agree to the last bit."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from micah_plan.errors import InputError
from micah_plan.recording.csv_file import read_csv, write_csv
from micah_plan.recording.read import read_recording, write_recording
from micah_plan.recording.value import Recording

FULL = (
    "part,note,run,t,x,y,z,qx,qy,qz,qw,ax,ay,az,fx,fy,fz\n"
    'door," a, ""b"" ",7,0,1,2,3,0,0,0,1,.1,-2e-3,+0,1,2,3\n'
    "lid,,7,0,4,5,6,0,0,0,-1,0,0,0,,,\n"
    "door,0.10,7,0.5,1,2,4,0,0,1,0,,,,4,5,6\n"
    "lid,007,7,0.5,4,5,7,1,0,0,0,,,,7,8,9\n"
    "door,nan,3,0,9,9,9,0,0,0.6,0.8,1,1,1,0,0,0\n"
)


def _write(tmp_path: Path, text: str | bytes, name: str = "r.csv") -> Path:
    path = tmp_path / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def test_every_column_arrives_where_it_belongs(tmp_path: Path) -> None:
    r = read_csv(_write(tmp_path, FULL))
    assert_array_equal(r.time, [0, 0, 0.5, 0.5, 0])
    assert_array_equal(r.position[1], [4, 5, 6])
    assert r.quaternion is not None
    assert r.action is not None
    assert r.force is not None
    assert_array_equal(r.quaternion[[1, 4]], [[0, 0, 0, -1], [0, 0, 0.6, 0.8]])
    assert_array_equal(r.action[0], [0.1, -2e-3, 0])
    assert_array_equal(np.isnan(r.action).all(axis=1), [False, False, True, True, False])
    assert_array_equal(np.isnan(r.force).all(axis=1), [False, True, False, False, False])
    assert r.runs == (7, 3)
    assert r.parts == ("door", "lid")
    assert r.has_run
    assert r.has_part
    assert r.extra == {"note": (' a, "b" ', "", "0.10", "007", "nan")}


def test_without_the_optional_columns_there_is_one_run_of_one_part_without_orientation(tmp_path: Path) -> None:
    r = read_csv(_write(tmp_path, "t,x,y,z\n0,1,2,3\n1,1,2,4\n"))
    assert not r.has_orientation
    assert not r.has_actions
    assert r.force is None
    assert not r.has_run
    assert not r.has_part
    assert len(r.runs) == len(r.parts) == 1


@pytest.mark.parametrize(
    "text",
    [
        "\ufefft,x,y,z,läge\n0,1,2,3,ö\n1,1,2,4,β\n",
        "t,x,y,z,läge\r\n0,1,2,3,ö\r\n1,1,2,4,β\r\n",
        "t,x,y,z,läge\n0,1,2,3,ö\n1,1,2,4,β",
        "\nt, x ,y,z,läge\n\n0, 1,2 ,3,ö\n1,1,2,4,β\n\n",
        "läge,z,y,x,t\nö,3,2,1,0\nβ,4,2,1,1\n",
        't,x,y,z,läge\n"0","1",2,3,"ö"\n1,1,2,4,β\n',
    ],
    ids=["BOM", "CRLF", "no final newline", "blanks", "other order", "quoted"],
)
def test_spellings_of_one_recording_are_the_same_recording(tmp_path: Path, text: str) -> None:
    plain = Recording(
        time=np.array([0.0, 1.0]), position=np.array([[1.0, 2, 3], [1, 2, 4]]), extra={"läge": ("ö", "β")}
    )
    assert read_csv(_write(tmp_path, text)).digest() == plain.digest()


def test_line_separators_of_other_kinds_belong_to_the_text(tmp_path: Path) -> None:
    r = read_csv(_write(tmp_path, "t,x,y,z,note\n0,1,2,3,a\u2028b\x85c\x0cd\n"))
    assert r.extra["note"] == ("a\u2028b\x85c\x0cd",)


def test_quaternions_within_a_percent_are_normalised_and_exact_ones_untouched(tmp_path: Path) -> None:
    header = "t,x,y,z,qx,qy,qz,qw\n"
    r = read_csv(_write(tmp_path, header + "0,0,0,0,0,0,0.99,0\n1,0,0,0,0.1,0.7,0.1,0.7\n2,0,0,0,0.5,0.5,0.5,0.5\n"))
    assert r.quaternion is not None
    np.testing.assert_allclose(np.linalg.norm(r.quaternion, axis=1), 1.0, atol=1e-15)
    assert_array_equal(r.quaternion[0], [0, 0, 1, 0])
    assert_array_equal(r.quaternion[2], [0.5, 0.5, 0.5, 0.5])
    np.testing.assert_allclose(r.quaternion[1], np.array([1, 7, 1, 7]) / 10, rtol=1e-15)


def test_runs_may_return_and_their_clocks_are_their_own(tmp_path: Path) -> None:
    r = read_csv(_write(tmp_path, "run,t,x,y,z\n1,5,0,0,0\n-2,0,0,0,0\n1,6,0,0,0\n-2,0.5,0,0,0\n"))
    assert_array_equal(r.select(run=-2).time, [0, 0.5])


def test_the_last_row_of_a_run_may_have_an_action(tmp_path: Path) -> None:
    r = read_csv(_write(tmp_path, "t,x,y,z,ax,ay,az\n0,0,0,0,1,1,1\n1,0,0,0,1,1,1\n"))
    assert r.action is not None
    assert np.isfinite(r.action).all()


def test_what_was_read_is_written_and_read_again_to_the_same_bytes(tmp_path: Path) -> None:
    first, second = tmp_path / "1.csv", tmp_path / "2.csv"
    write_csv(read_csv(_write(tmp_path, FULL)), first)
    again = read_csv(first)
    write_csv(again, second)
    assert first.read_bytes() == second.read_bytes()
    assert again.digest() == read_csv(tmp_path / "r.csv").digest()


@pytest.mark.slow
def test_a_hundred_thousand_rows_survive(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    n = 100_000
    r = Recording(time=np.cumsum(rng.uniform(0.01, 0.1, n)), position=rng.normal(size=(n, 3)) * 1e-7)
    write_csv(r, tmp_path / "r.csv")
    assert read_csv(tmp_path / "r.csv").digest() == r.digest()


def test_a_failed_write_leaves_the_old_file_and_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = _write(tmp_path, "old")

    def fail(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(InputError, match=r"r\.csv: cannot be written \(no space left on device\); name a file"):
        write_csv(read_csv(_write(tmp_path, FULL, "in.csv")), target)
    assert target.read_text() == "old"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["in.csv", "r.csv"]


def test_a_link_is_kept_and_its_file_replaced(tmp_path: Path) -> None:
    target = _write(tmp_path, "old", "real.csv")
    link = tmp_path / "link.csv"
    link.symlink_to(target)
    write_csv(read_csv(_write(tmp_path, FULL)), link)
    assert link.is_symlink()
    assert len(read_csv(target)) == 5


def test_a_pipe_is_written_to_and_never_replaced(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.csv"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        write_csv(read_csv(_write(tmp_path, "t,x,y,z\n0,1,2,3\n")), pipe)
        assert os.read(reader, 1000) == b"t,x,y,z\n0.0,1.0,2.0,3.0\n"
    finally:
        os.close(reader)
    assert stat.S_ISFIFO(pipe.stat().st_mode)


def _rows(n: int = 2, **columns: object) -> Recording:
    return Recording(time=np.arange(n, dtype=float), position=np.zeros((n, 3)), **columns)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("recording", "message"),
    [
        (_rows(extra={"a": ("x", "y\nz")}), r"row 1, column 'a': expected text on one line"),
        (_rows(extra={"a": ("x", "\0")}), r"row 1, column 'a'.*remove its line breaks and NUL"),
        (_rows(extra={"a": ("\ud800", "")}), r"row 0, column 'a'"),
        (_rows(extra={" t": ("1", "2")}), r"' t' is no name.*rename it"),
        (_rows(part=("door", " ")), r"row 1, column 'part': the name of the part is empty; name the part"),
        (_rows(action=np.full((2, 3), np.nan)), r"row 0, column 'ax': the action is empty"),
        (_rows(n=0), r"expected rows of measurements, found none"),
        (Recording(time=np.zeros(2), position=np.zeros((2, 3))), r"row 1, column 't': time stands still"),
    ],
)
def test_the_writer_refuses_what_the_reader_would_refuse(tmp_path: Path, recording: Recording, message: str) -> None:
    for name in ("r.csv", "r.npz"):
        with pytest.raises(InputError, match=rf"{name}.*{message}"):
            write_recording(recording, tmp_path / name)
    assert not list(tmp_path.iterdir())


EXPECTED_ROWS = {
    "demonstrations/microwave_with_grasp.csv": 126,
    "demonstrations/drawer_no_grasp.csv": 160,
    "demonstrations/stapler.csv": 143,
    "executions/drawer.csv": 50,
    "executions/doors/ikea_cabinet.csv": 129,
    "executions/doors/lab_cabinet.csv": 133,
    "executions/arm/joint_1.csv": 1001,
    "executions/arm/joint_4.csv": 1001,
}


@pytest.mark.parametrize(("name", "rows"), EXPECTED_ROWS.items())
def test_measured_recordings_have_the_rows_that_are_stated(shared_data: Path, name: str, rows: int) -> None:
    r = read_recording(shared_data / name)
    assert len(r) == rows
    assert r.has_actions


def test_every_measured_recording_is_read_completely_and_survives_a_round_trip(
    shared_data: Path, tmp_path: Path
) -> None:
    files = sorted(shared_data.rglob("*.csv"))
    assert len(files) >= len(EXPECTED_ROWS)
    for file in files:
        r = read_recording(file, minimum_rows=10)
        assert len(r) == len(file.read_text().splitlines()) - 1, file
        write_csv(r, tmp_path / "copy.csv")
        assert read_csv(tmp_path / "copy.csv").digest() == r.digest(), file


def test_the_measured_drawer_runs_keep_the_planners_belief_as_text(shared_data: Path) -> None:
    r = read_recording(shared_data / "executions" / "drawer.csv")
    assert r.runs == (1, 2, 3, 4, 5)
    assert r.extra["belief_x"][0] == "-0.0119782883"
    assert r.action is not None
    assert np.isnan(r.action[:, 0]).sum() == 5
