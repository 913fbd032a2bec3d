"""Properties over generated recordings and generated garbage."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from micah_plan.errors import InputError
from micah_plan.recording.checks import KNOWN
from micah_plan.recording.read import read_recording, write_recording
from micah_plan.recording.value import Recording

TEXT = st.text(st.characters(exclude_characters="\0\r\n", exclude_categories=("Cs",)), max_size=6)
LENGTHS = st.floats(-1e6, 1e6)


@st.composite
def recordings(draw: st.DrawFn, *, poses_only: bool = False) -> Recording:
    n = draw(st.integers(1, 6))

    def table(width: int) -> st.SearchStrategy[np.ndarray]:
        row = st.lists(LENGTHS, min_size=width, max_size=width)
        return st.lists(row, min_size=n, max_size=n).map(np.array)

    time = np.array(sorted(draw(st.lists(st.floats(-1e12, 1e12), min_size=n, max_size=n, unique=True))))
    quaternion = None
    if poses_only or draw(st.booleans()):
        raw = np.random.default_rng(draw(st.integers(0, 999))).normal(size=(n, 4))
        quaternion = raw / np.linalg.norm(raw, axis=1)[:, None]
    if poses_only:
        return Recording(time=time, position=draw(table(3)), quaternion=quaternion)
    has_run, has_part = draw(st.booleans()), draw(st.booleans())
    run = np.array(draw(st.lists(st.integers(-3, 3), min_size=n, max_size=n)) if has_run else [0] * n)
    names = st.lists(TEXT.filter(str.strip), min_size=n, max_size=n)
    part = tuple(draw(names)) if has_part else ("part",) * n
    action = draw(st.none() | table(3))
    if action is not None:
        last = {key: row for row, key in enumerate(zip(run.tolist(), part, strict=True))}
        for row in last.values():
            if draw(st.booleans()):
                action[row] = np.nan
    force = draw(st.none() | table(3))
    if force is not None and draw(st.booleans()):
        force[draw(st.integers(0, n - 1))] = np.nan
    extra_names = draw(st.lists(TEXT.filter(lambda name: name.strip() not in KNOWN), max_size=3, unique=True))
    extra = {name: tuple(draw(st.lists(TEXT, min_size=n, max_size=n))) for name in extra_names}
    return Recording(time, draw(table(3)), quaternion, action, force, run, part, has_run, has_part, extra)


def _same(a: Recording, b: Recording) -> bool:
    columns = (a.has_run, a.has_part, list(a.extra)) == (b.has_run, b.has_part, list(b.extra))
    return columns and a.digest() == b.digest()


@pytest.mark.sweep
@pytest.mark.parametrize("suffix", [".csv", ".npz"])
@settings(max_examples=150)
@given(recording=recordings())
def test_reading_what_was_written_gives_the_same_recording(suffix: str, recording: Recording) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"r{suffix}"
        write_recording(recording, path)
        assert _same(read_recording(path), recording)


@pytest.mark.sweep
@pytest.mark.parametrize("suffix", [".tum", ".txt"])
@settings(max_examples=50)
@given(recording=recordings(poses_only=True))
def test_poses_survive_a_trajectory_file(suffix: str, recording: Recording) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"r{suffix}"
        write_recording(recording, path)
        assert _same(read_recording(path), recording)


def _read_or_one_line(content: bytes, suffix: str) -> Recording | None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"r{suffix}"
        path.write_bytes(content)
        try:
            return read_recording(path)
        except InputError as error:
            message = str(error)
            assert message.splitlines() == [message]
            assert message.startswith(str(path))
            return None


FIELDS = st.sampled_from([*KNOWN, "a", "", " ", '"', '""', "0", "1", "-1", "1e999", "nan", "1_0", "\0", "\u2028", "é"])
LINES = st.lists(st.lists(FIELDS, min_size=3, max_size=9).map(",".join), max_size=5)
ENDS = st.sampled_from(["\n", "\r\n", "\r"])


@pytest.mark.slow
@settings(max_examples=300)
@given(content=st.binary(max_size=60) | st.text(max_size=60).map(lambda text: text.encode("utf-8", "surrogatepass")))
@pytest.mark.parametrize("suffix", [".csv", ".txt", ".npz"])
def test_garbage_gets_one_line(suffix: str, content: bytes) -> None:
    _read_or_one_line(content, suffix)


@pytest.mark.slow
@settings(max_examples=400)
@given(header=st.sampled_from(["t,x,y,z", "t,x,y,z,a", "run,t,x,y,z", "part,t,x,y,z", '"', ""]), lines=LINES, end=ENDS)
def test_nearly_recordings_get_one_line_or_are_finite(header: str, lines: list[str], end: str) -> None:
    recording = _read_or_one_line(end.join((header, *lines)).encode(), ".csv")
    if recording is not None:
        assert len(recording) <= len(lines)
        assert np.isfinite(recording.position).all()


@pytest.mark.slow
@settings(max_examples=300)
@given(data=st.data())
def test_damaged_archives_get_one_line(data: st.DataObject) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "r.npz"
        columns = {"time": np.arange(2.0), "position": np.zeros((2, 3)), "part": np.array(["a", "b"])}
        save = data.draw(st.sampled_from([np.savez, np.savez_compressed]))
        save(path, **columns)
        content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    _read_or_one_line(bytes(content[: data.draw(st.integers(0, len(content)))] or content), ".npz")
    _read_or_one_line(bytes(content), ".npz")
