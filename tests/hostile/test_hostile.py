"""Every reader against hostile and damaged files: one line, bounded time and memory, nothing run, nothing written."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from attack import attack, readers
from corpus import FILES, write_corpus
from extras import module_requires
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from micah_plan import files
from micah_plan.exchange.convert import convert
from micah_plan.recording.read import read_recording, write_recording
from micah_plan.view.figures import save_figure

pytestmark = [module_requires("ros"), module_requires("parquet")]  # the corpus has MCAP and Parquet files
ROOT = Path(__file__).resolve().parents[2]
ATTACK = Path(__file__).with_name("attack.py")
HARMLESS = {
    "many_knots.yaml", "tiny.csv", "formula.csv", "many_runs.csv", "huge_number.urdf", "utf7.urdf", "lists.parquet",
    "mesh_traversal.urdf",  # read without the mesh, which is not looked at
}  # fmt: skip
MOST_SECONDS, MOST_MIB = 20.0, 1024.0


@pytest.fixture(scope="module")
def attacked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[dict[str, Any]]]:
    """A folder of hostile files, and what the readers did with them in a process of their own."""
    folder = tmp_path_factory.mktemp("hostile")
    written = write_corpus(folder)
    before = {path.name for path in folder.iterdir()}
    command = [sys.executable, str(ATTACK), *(path.name for path in written)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=500, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert {path.name for path in folder.iterdir()} == before, "a reader wrote something"
    return folder, [json.loads(line) for line in done.stdout.splitlines()]


@pytest.mark.slow
def test_each_hostile_file_is_one_line_or_harmless(attacked: tuple[Path, list[dict[str, Any]]]) -> None:
    found = attacked[1]
    assert len(found) > 150
    assert [item for item in found if "crashed" in item] == []
    assert {item["file"] for item in found if "read" in item} <= HARMLESS
    for item in found:
        line = item.get("refused", "")
        assert len(line.splitlines()) <= 1
        assert len(line) <= 1000
        assert "root:" not in line, "the content of another file was shown"


@pytest.mark.evidence
def test_time_and_memory_are_bounded(attacked: tuple[Path, list[dict[str, Any]]]) -> None:
    found = attacked[1]
    slowest = max(found, key=lambda item: item["seconds"])
    assert slowest["seconds"] < MOST_SECONDS, slowest
    assert found[-1]["peak_mib"] < MOST_MIB
    inputs = f"{len(found)} inputs, slowest {slowest['file']} {slowest['seconds']:.1f} s"
    print(f"{inputs}, peak {found[-1]['peak_mib']:.0f} MiB")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["alias_bomb.yaml", "zip_bomb.npz", "zstd_bomb.mcap", "deep_lists.json", "pipe.csv"])
def test_the_command_ends_with_code_2_and_one_line(attacked: tuple[Path, list[dict[str, Any]]], name: str) -> None:
    command = [sys.executable, "-m", "micah_plan", "show", name, "-o", "page.html"]
    done = subprocess.run(command, cwd=attacked[0], capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert len(done.stderr.splitlines()) == 1
    assert not (attacked[0] / "page.html").exists()


def good_files() -> dict[str, bytes]:
    """One small good file of every kind."""
    import tempfile

    import pyarrow
    from pyarrow import parquet

    made = {
        "p.yaml": (ROOT / "problems" / "drawer_open.yaml").read_bytes().replace(b"../models", bytes(ROOT / "models")),
        "s.yaml": (ROOT / "problems" / "sweeps" / "drawer.yaml").read_bytes().replace(b"..", bytes(ROOT / "problems")),
        "m.yaml": (ROOT / "models" / "slot.yaml").read_bytes(),
        "r.urdf": (ROOT / "micah_plan" / "templates" / "robot.urdf").read_bytes(),
    }
    with tempfile.TemporaryDirectory() as folder:
        recording = read_recording(ROOT / "examples" / "demonstrations" / "drawer.csv")
        for suffix in ("csv", "npz", "mcap"):
            write_recording(recording.rows(slice(0, 12)), Path(folder, f"r.{suffix}"))
            made[f"r.{suffix}"] = Path(folder, f"r.{suffix}").read_bytes()
        columns = {name: recording.position[:12, i] for i, name in enumerate("xyz")} | {"t": recording.time[:12]}
        parquet.write_table(pyarrow.table(columns), Path(folder, "r.parquet"))
        made["r.parquet"] = Path(folder, "r.parquet").read_bytes()
    made["r.tum"] = b"".join(b"%d.5 0.1 0.2 0.3 0 0 0 1\n" % i for i in range(12))
    return made


GOOD = good_files()
PIECES = [
    b"\0",
    b"\xff",
    b"[",
    b"{",
    b'"',
    b"'",
    b"&a",
    b"*a",
    b"-",
    b"9" * 50,
    b"nan",
    b"1e999",
    b"\n",
    b"\t",
    b": ",
    b"<a>",
    b"PK",
]


@st.composite
def damaged(draw: st.DrawFn) -> tuple[str, bytes]:
    """A good file, cut, with pieces taken out, doubled or put in, or bits flipped."""
    name = draw(st.sampled_from(sorted(GOOD)))
    content = GOOD[name]
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, len(content)))
        length = draw(st.integers(0, 40))
        kind = draw(st.sampled_from(["cut", "remove", "double", "insert", "flip"]))
        middle = content[at : at + length]
        if kind == "cut":
            content = content[:at]
        elif kind == "remove":
            content = content[:at] + content[at + length :]
        elif kind == "double":
            content = content[:at] + middle * 2 + content[at + length :]
        elif kind == "insert":
            content = content[:at] + draw(st.sampled_from(PIECES) | st.binary(max_size=8)) + content[at:]
        elif at < len(content):
            content = content[:at] + bytes([content[at] ^ draw(st.integers(1, 255))]) + content[at + 1 :]
    return name, content


def fuzz(folder: Path, name: str, content: bytes) -> None:
    path = folder / name
    path.write_bytes(content)
    for reader in readers(path):
        found = attack(path, reader)
        assert "crashed" not in found, found
        assert len(found.get("refused", "").splitlines()) <= 1


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


@settings(max_examples=150, suppress_health_check=list(HealthCheck))
@given(case=damaged())
def test_damaged_files_are_one_line_or_good(place: Path, case: tuple[str, bytes]) -> None:
    fuzz(place, *case)


@pytest.mark.evidence
@settings(max_examples=3000, suppress_health_check=list(HealthCheck))
@given(case=damaged())
def test_many_damaged_files_are_one_line_or_good(place: Path, case: tuple[str, bytes]) -> None:
    fuzz(place, *case)


def test_good_files_are_read(place: Path) -> None:
    """The fuzzing begins at files that pass, or it would only see the first check."""
    for name, content in GOOD.items():
        (place / name).write_bytes(content)
        assert "read" in attack(place / name, readers(place / name)[0]), name


@pytest.mark.parametrize("target", ["new.csv", "new.npz", "new.mcap", "new.tum"])
def test_a_disk_that_is_full_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, target: str) -> None:
    (tmp_path / "in.tum").write_bytes(GOOD["r.tum"])
    (tmp_path / target).write_text("old")
    monkeypatch.setattr(os, "fsync", lambda _: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    with pytest.raises(files.InputError, match="no space left"):
        convert(tmp_path / "in.tum", tmp_path / target)
    assert (tmp_path / target).read_text() == "old"
    assert {path.name for path in tmp_path.iterdir()} == {"in.tum", target}


def test_a_figure_is_written_at_once_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from matplotlib.figure import Figure

    (tmp_path / "f.png").write_text("old")
    monkeypatch.setattr(os, "fsync", lambda _: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        save_figure(Figure(), tmp_path / "f.png")
    assert (tmp_path / "f.png").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["f.png"]


@pytest.mark.slow
def test_every_kind_of_file_is_in_the_corpus() -> None:
    assert {f".{name.split('.')[1]}" for name in GOOD} == set(FILES) - {".json"}
    for made in FILES.values():
        assert len({name for name, _ in made()}) >= 7
