"""Files are replaced whole, together, and with the permissions that they had."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from micah_plan.errors import InputError
from micah_plan.files import replace_file, replace_files


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


@pytest.mark.parametrize("permissions", [0o600, 0o640, 0o664, 0o755])
def test_permissions_stay(tmp_path: Path, permissions: int) -> None:
    file = tmp_path / "plan.json"
    file.write_text("old")
    file.chmod(permissions)
    replace_file(file, b"new")
    assert (file.read_bytes(), mode(file)) == (b"new", permissions)


def test_a_new_file_has_the_permissions_of_any_new_file(tmp_path: Path) -> None:
    (tmp_path / "usual").touch()
    replace_file(tmp_path / "new", b"new")
    assert mode(tmp_path / "new") == mode(tmp_path / "usual")


def test_a_link_keeps_pointing_to_its_file(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("old")
    (tmp_path / "file").chmod(0o600)
    (tmp_path / "link").symlink_to("file")
    replace_file(tmp_path / "link", b"new")
    assert (tmp_path / "link").is_symlink()
    assert ((tmp_path / "file").read_bytes(), mode(tmp_path / "file")) == (b"new", 0o600)


def test_no_file_is_replaced_before_all_are_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = [tmp_path / name for name in ("plan.json", "plan.html", "plan.png")]
    for file in files:
        file.write_text("old")
    written = iter([None, None, OSError(28, "No space left on device")])

    def fsync(_: int) -> None:
        error = next(written)
        if error is not None:
            raise error

    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(InputError, match=r"plan\.png: cannot be written \(no space left on device\)"):
        replace_files(dict.fromkeys(files, b"new"))
    assert [file.read_text() for file in files] == ["old"] * 3
    assert sorted(tmp_path.iterdir()) == sorted(files)


def test_files_that_belong_together_are_replaced_together(tmp_path: Path) -> None:
    files = [tmp_path / "plan.json", tmp_path / "plan.html"]
    replace_files(dict(zip(files, (b"1", b"2"), strict=True)))
    assert [file.read_bytes() for file in files] == [b"1", b"2"]
    assert sorted(tmp_path.iterdir()) == sorted(files)


def test_a_pipe_without_a_reader_is_an_error_and_no_wait(tmp_path: Path) -> None:
    pipe = tmp_path / "plan.json"
    os.mkfifo(pipe)
    with pytest.raises(InputError, match=r"plan\.json: cannot be written \(nobody reads this pipe\)"):
        replace_file(pipe, b"new")
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    replace_file(pipe, b"new")
    assert os.read(reader, 10) == b"new"
    os.close(reader)
    assert stat.S_ISFIFO(pipe.stat().st_mode)
