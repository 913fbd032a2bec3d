"""Every kind of bad recording gets one line with the file, the line in it and what to do."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

from micah_plan import files
from micah_plan.errors import InputError
from micah_plan.recording.npz_file import write_npz
from micah_plan.recording.read import read_recording, write_recording
from micah_plan.recording.value import Recording

H = "t,x,y,z\n"
ROW = "0,1,2,3\n"
Q = "t,x,y,z,qx,qy,qz,qw\n"
A = "t,x,y,z,ax,ay,az\n"
F = "t,x,y,z,fx,fy,fz\n"
BAD = {
    "missing column": ("t,x,z\n0,1,2\n", "line 1", "column 'y' is missing", "the first line names the columns"),
    "colons": ("t:x:y:z\n0:1:2:3\n", "line 1", "'t' is missing", "the first line names the columns"),
    "only comments": ("# t,x,y,z\n# nothing\n", "line 2", "the file has only comments", "at least one row"),
    "no time": (H + "noon,1,2,3\n", "line 2, column 't'", "expected a number, found 'noon'", "decimal number"),
    "no header": (ROW + ROW, "line 1", "expected a header line, found '0,1,2,3'", "put the names"),
    "text": (H + ROW + "1,abc,2,3\n", "line 3, column 'x'", "expected a number, found 'abc'", "such as 0.25"),
    "underscore": (H + "0,1_0,2,3\n", "line 2, column 'x'", "expected a number, found '1_0'", "decimal number"),
    "other digits": (H + "0,١,2,3\n", "line 2, column 'x'", "expected a number", "decimal number"),
    "first of two": (H + ROW + "1,1,2,b\n2,a,2,3\n", "line 3, column 'z'", "found 'b'", "decimal number"),
    "nothing": (H + ROW + "1,,2,3\n", "line 3, column 'x'", "expected a number, found none", "fill in the value"),
    "nan": (H + ROW + "1,1,NaN,3\n", "line 3, column 'y'", "expected a number, found none", "fill in the value"),
    "inf": (H + "0,1,2,-inf\n", "line 2, column 'z'", "finite number, found '-inf'", "fill in the value"),
    "nan action": (A + "0,1,2,3,nan,nan,nan\n", "line 2, column 'ax'", "finite number", "fill in the value"),
    "overflow": (H + "0,1e999,2,3\n", "line 2, column 'x'", "a number in range, found '1e999'", "SI units"),
    "absurd": (H + ROW + "1,1,2,3e9\n", "line 3, column 'z'", "at most 1e+06 in size, found 3e+09", "SI units"),
    "backwards": (H + "1,0,0,0\n0.5,0,0,0\n", "line 3, column 't'", "time goes backwards: 0.5 s after 1.0 s", "sort"),
    "standing still": (H + ROW + ROW, "line 3, column 't'", "time stands still", "drop repeated rows"),
    "backwards in run 2": (
        "run,t,x,y,z\n1,0,0,0,0\n2,5,0,0,0\n1,1,0,0,0\n2,4,0,0,0\n",
        "line 5, column 't'",
        "(run 2)",
        "sort the rows by time",
    ),
    "standing still in a part": (
        "part,t,x,y,z\na,0,0,0,0\nb,0,0,0,0\nb,1,0,0,0\na,0,0,0,0\n",
        "line 5, column 't'",
        "stands still: 0.0 s after 0.0 s (part 'a')",
        "sort the rows by time",
    ),
    "two headers": (H + ROW + H + "1,1,2,3\n", "line 3, column 't'", "a second header line", "keep one header line"),
    "header only": (H, "line 1", "the header is followed by no rows", "record at least one row"),
    "empty": ("", "line 1", "the file is empty", "write a recording into it"),
    "blank": ("\ufeff \n\n", "line 1", "the file is empty", "write a recording into it"),
    "binary": (b"\x7fELF\n\x01\0\0\0", "line 2", "expected text, found a binary file", "choose the text file"),
    "not UTF-8": (b"t,x,y,z\r\n0,1,2,3\r\n1,\xe9,2,3\r\n", "line 3", "the byte 0xe9", "save the file as UTF-8"),
    "UTF-16": ("t,x,y,z\n".encode("utf-16"), "line 1", "found UTF-16", "save the file as UTF-8"),
    "short row": (H + ROW + "1,2,3\n", "line 3", "expected 4 fields as in the header, found 3", "separate by commas"),
    "long row": (H + "0,5,1,2,3\n", "line 2", "expected 4 fields as in the header, found 5", "numbers with a point"),
    "no z": ("t,x,y,q\n0,1,2,3\n", "line 1", "column 'z' is missing", "the first line names the columns"),
    "no qw": ("t,x,y,z,qx,qy,qz\n", "line 1", "'qw' is missing although 'qx' is there", "qx,qy,qz,qw"),
    "no ay": ("t,x,y,z,ax\n", "line 1", "'ay' is missing although 'ax' is there", "remove all of ax,ay,az"),
    "no fx": ("t,x,y,z,fy,fz\n", "line 1", "'fx' is missing although 'fy' is there", "remove all of fx,fy,fz"),
    "action partly empty": (A + "0,0,0,0,1,1,1\n1,0,0,0,1,,1\n", "line 3, column 'ay'", "only 'ay' empty", "fill in"),
    "action mostly empty": (A + "0,0,0,0,,1,\n", "line 2, column 'ax'", "only some of them filled", "empty all three"),
    "force partly empty": (F + "0,0,0,0,1,1,\n", "line 2, column 'fz'", "only 'fz' empty", "fill in"),
    "action empty inside": (
        A + "0,0,0,0,1,1,1\n1,0,0,0,,,\n2,0,0,0,,,\n",
        "line 3, column 'ax'",
        "only allowed in the last row of a run",
        "0 without a command",
    ),
    "quaternion of norm 0": (Q + "0,0,0,0,0,0,0,0\n", "line 2, column 'qx'", "found the norm 0", "scalar last"),
    "long quaternion": (
        Q + "0,0,0,0,0,0,0,1\n1,0,0,0,0,0,0,1.011\n",
        "line 3, column 'qx'",
        "unit quaternion, found the norm 1.011",
        "remove qx,qy,qz,qw if it was not measured",
    ),
    "column twice": ("t,x,y,z, x\n0,1,2,3,4\n", "line 1", "column 'x' appears twice", "rename or remove"),
    "extra twice": ("t,x,y,z,a,a\n0,1,2,3,4,5\n", "line 1", "column 'a' appears twice", "rename or remove"),
    "run 1.5": ("run,t,x,y,z\n1.5,0,0,0,0\n", "line 2, column 'run'", "expected an integer", "number the runs"),
    "run too long": ("run,t,x,y,z\n1,0,0,0,0\n" + "9" * 5000 + ",1,0,0,0\n", "line 3, column 'run'", "18", "number"),
    "no part name": ("part,t,x,y,z\n,0,0,0,0\n", "line 2, column 'part'", "name of the part is empty", "name the part"),
    "newline in quotes": ('t,x,y,z,n\n0,1,2,3,"a\nb"\n', "line 2", "does not end on its line", "keep it on one line"),
    "broken quotes": ('t,x,y,z,n\n0,1,2,3,"a"b\n', "line 2", "is malformed", "double the quotes in it"),
}


def _message(path: Path, **options: int) -> str:
    with pytest.raises(InputError) as caught:
        read_recording(path, **options)
    message = str(caught.value)
    assert len(message.splitlines()) == 1
    assert str(path) in message
    return message


@pytest.mark.parametrize("kind", BAD)
def test_bad_csv(tmp_path: Path, kind: str) -> None:
    content, where, problem, remedy = BAD[kind]
    path = tmp_path / "bad.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    message = _message(path)
    assert message.startswith(f"{path}, {where}: ")
    assert problem in message
    assert remedy in message.split("; ", 1)[1]


@pytest.mark.parametrize(
    ("content", "where", "problem", "remedy"),
    [
        ("# only\n# comments\n", "line 3", "has no poses", "record at least one pose"),
        ("# c\n0 1 2 3 0 0 0\n", "line 2", "the 8 numbers t x y z qx qy qz qw, found 7 fields", "extension .csv"),
        ("# c\n\n0 1 2 a 0 0 0 1\n", "line 3, column 'z'", "found 'a'", "decimal number"),
        ("0 1 2 3 0 0 0 nan\n", "line 1, column 'qw'", "finite number", "fill in"),
        ("0 1 2 3 0 0 0 0\n", "line 1, column 'qx'", "norm 0", "scalar last"),
        ("1 1 2 3 0 0 0 1\n# c\n1 1 2 3 0 0 0 1\n", "line 3, column 't'", "stands still", "drop repeated rows"),
        (b"0 1 2 3 0 0 0 1\n\0", "line 2", "binary", "choose the text file"),
    ],
)
def test_bad_tum(tmp_path: Path, content: str | bytes, where: str, problem: str, remedy: str) -> None:
    path = tmp_path / "bad.tum"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    message = _message(path)
    assert message.startswith(f"{path}, {where}: ")
    assert problem in message
    assert remedy in message.split("; ", 1)[1]


def test_fewer_rows_than_a_fit_needs(tmp_path: Path) -> None:
    path = tmp_path / "short.csv"
    path.write_text(H + ROW + "1,1,2,3\n")
    assert len(read_recording(path, minimum_rows=2)) == 2
    message = _message(path, minimum_rows=3)
    assert message.startswith(f"{path}, line 3, column 't': expected at least 3 rows, found 2; record a longer motion")
    path.write_text("run,part,t,x,y,z\n1,a,0,0,0,0\n1,b,0,0,0,0\n1,a,1,0,0,0\n1,b,1,0,0,0\n2,b,0,0,0,0\n")
    assert "line 6, column 't': expected at least 2 rows, found 1 (run 2, part 'b')" in _message(path, minimum_rows=2)


@pytest.mark.parametrize("suffix", [".csv", ".tum", ".txt", ".npz", ".yaml", ""])
def test_no_file_and_a_directory(tmp_path: Path, suffix: str) -> None:
    assert "the file does not exist; check the path" in _message(tmp_path / f"none{suffix}")
    (tmp_path / f"folder{suffix}").mkdir()
    assert "expected a file, found a directory; name a file in it" in _message(tmp_path / f"folder{suffix}")


def test_a_path_that_no_system_can_open() -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_recording("a\0b.csv")


def test_an_unknown_extension_lists_the_known_ones(tmp_path: Path) -> None:
    (tmp_path / "r.yaml").write_text(H + ROW)
    assert "found the extension '.yaml'; use .csv (recording)" in _message(tmp_path / "r.yaml")
    r = Recording(time=np.zeros(1), position=np.zeros((1, 3)))
    with pytest.raises(InputError, match=r"found no extension; use \.csv"):
        write_recording(r, tmp_path / "r")
    with pytest.raises(InputError, match=r"cannot be written.*directory that exists"):
        write_recording(r, tmp_path / "none" / "r.csv")


def test_a_file_that_is_too_large_is_not_read_whole(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    path.write_text(H + ROW * 10)
    with pytest.raises(InputError, match="found a larger file; split it"):
        files.read_bytes(path, limit=20)


def _npz(path: Path, **arrays: object) -> Path:
    base = {"time": np.arange(3.0), "position": np.zeros((3, 3))}
    kept = {name: array for name, array in (base | arrays).items() if array is not None}
    np.savez(path, **kept)  # type: ignore[arg-type]
    return path


@pytest.mark.parametrize(
    ("arrays", "problem", "remedy"),
    [
        ({"time": None}, "array 'time' is missing", "store time (n,)"),
        ({"part": np.array(["a", 1, None], dtype=object)}, "holds Python objects", "store numbers and text only"),
        ({"time": np.array(["a"] * 3)}, "array 'time' to hold numbers in 1 dimensions", "convert it"),
        ({"run": np.arange(3.0)}, "array 'run' to hold integers", "convert it"),
        ({"run": np.full(3, 2**64 - 1, dtype=np.uint64)}, "at most 63 bits", "number the runs"),
        ({"position": np.zeros((2, 3))}, "expected 3 rows in array 'position'", "write it again"),
        ({"position": np.zeros((3, 2))}, "Recording.position must have shape (3, 3)", ""),
        ({"speed": np.zeros(3)}, "found the array 'speed'", "rename or remove it"),
        ({"extra": np.array([["a", "b", "c"]])}, "extra and extra_names together", "add the other"),
        ({"extra": np.array([["a"] * 3] * 2), "extra_names": np.array(["n", "n"])}, "one name of its own", "rename"),
        ({"time": np.array([0.0, np.nan, 1])}, "row 1, column 't': expected a finite number", "SI units"),
        ({"time": np.zeros(3)}, "row 1, column 't': time stands still", "sort the rows"),
        ({"quaternion": np.zeros((3, 4))}, "row 0, column 'qx': expected a unit quaternion", "scalar last"),
        ({"time": np.zeros(0), "position": np.zeros((0, 3))}, "found none", "record at least one row"),
    ],
)
def test_bad_npz(tmp_path: Path, arrays: dict[str, object], problem: str, remedy: str) -> None:
    message = _message(_npz(tmp_path / "bad.npz", **arrays))
    assert problem in message
    assert remedy in message


@pytest.mark.parametrize("content", [b"", b"text", b"PK\x03\x04 broken", b"PK\x05\x06" + b"\0" * 18])
def test_npz_that_is_no_archive(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "bad.npz"
    path.write_bytes(content)
    assert ";" in _message(path)


@pytest.mark.slow
def test_npz_that_unpacks_to_too_much_is_refused_before_unpacking(tmp_path: Path) -> None:
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("time.npy", "w") as member:
        chunk = bytes(2**20)
        for _ in range(257):
            member.write(chunk)
    assert path.stat().st_size < 1_000_000
    assert "MiB of arrays, found" in _message(path)


def test_npz_whose_header_promises_more_than_there_is(tmp_path: Path) -> None:
    content = io.BytesIO()
    np.lib.format.write_array_header_1_0(content, {"descr": "<f8", "fortran_order": False, "shape": (10**12,)})
    path = tmp_path / "liar.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("time.npy", content.getvalue())
    assert "array 'time' is cut off or has a wrong header" in _message(path)


@pytest.mark.parametrize(
    ("columns", "found"),
    [
        ({}, "needs orientations, found none"),
        ({"run": np.arange(2)}, "found several runs"),
        ({"part": ("a", "b"), "has_part": True}, "found several parts"),
        ({"action": np.zeros((2, 3)), "force": np.zeros((2, 3))}, "found actions, forces"),
        ({"extra": {"note": ("", "")}}, "found columns 'note'"),
    ],
)
def test_a_trajectory_file_takes_nothing_that_it_would_lose(
    tmp_path: Path, columns: dict[str, object], found: str
) -> None:
    r = Recording(time=np.arange(2.0), position=np.zeros((2, 3)), **columns)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=rf"r\.txt: .*{found}; write a \.csv or \.npz file"):
        write_recording(r, tmp_path / "r.txt")


@pytest.mark.slow
def test_arrays_too_large_for_a_reader_are_not_written(tmp_path: Path) -> None:
    long = "x" * 70_000_000
    r = Recording(time=np.zeros(1), position=np.zeros((1, 3)), extra={"note": (long,)})
    with pytest.raises(InputError, match=r"more than a reader accepts; write a \.csv"):
        write_npz(r, tmp_path / "r.npz")
