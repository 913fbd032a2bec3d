"""Paths and meshes that a file names: what leaves its folder or is no mesh is refused in one line."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from micah_plan.automaton.hybrid import Primitive
from micah_plan.errors import InputError
from micah_plan.files import contained
from micah_plan.task.body import Body, Hull, corners
from micah_plan.task.mesh_file import convex_corners, load_hull

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 2)], dtype=float)


def stl(triangles: np.ndarray) -> bytes:
    rows = b"".join(struct.pack("<12fH", 0, 0, 0, *triangle.ravel(), 0) for triangle in triangles)
    return bytes(80) + struct.pack("<I", len(triangles)) + rows


def test_a_file_in_the_folder_is_found_also_through_a_link_inside(tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "a.obj").touch()
    os.symlink(tmp_path / "meshes", tmp_path / "link")
    assert contained("link/a.obj", tmp_path) == (tmp_path / "meshes" / "a.obj").resolve()
    assert contained("meshes/../meshes/a.obj", tmp_path).name == "a.obj"


@settings(max_examples=200)
@given(name=st.text(st.sampled_from("ab./\\\0:~-"), max_size=12))
def test_no_name_leads_out_of_the_folder(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "ab"
    folder.mkdir(exist_ok=True)
    for file in (folder / "a", tmp_path / "a", tmp_path / "b"):
        file.touch()
    try:
        found = contained(name, folder)
    except InputError:
        found = folder / "a"
    assert found.is_relative_to(folder.resolve())


def test_meshes_of_each_format_become_the_corners_of_their_hull(tmp_path: Path) -> None:
    generator = np.random.default_rng(0)
    points = np.vstack([CUBE, 0.3 + 0.4 * generator.random((30, 3))])
    triangles = points[generator.integers(0, len(points), (200, 3))]
    triangles[:8, 0] = CUBE
    (tmp_path / "b.stl").write_bytes(stl(triangles))
    text = "".join("facet\nouter loop\n" + "".join(f"vertex {x} {y} {z}\n" for x, y, z in t) for t in triangles)
    (tmp_path / "t.stl").write_text(f"solid s\n{text}endsolid\n")
    (tmp_path / "o.obj").write_text("".join(f"v {x} {y} {z}\n" for x, y, z in points) + "vn 0 0 1\n")
    expected = {tuple(row) for row in CUBE * [1, 1, 0.5]}
    for name in ("b.stl", "t.stl", "o.obj"):
        assert set(load_hull(tmp_path / name, (1.0, 1.0, 0.5))) == expected


@pytest.mark.parametrize(
    ("name", "data", "expected"),
    [
        ("m.obj", b"v 1 2\n", "line 1: expected three numbers"),
        ("m.obj", b"v a b c\n", "line 1: expected three numbers"),
        ("m.obj", b"", "at least four corners"),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\n", "at least four corners that span a volume"),
        ("m.obj", b"v 0 0 nan\n" * 5, "no numbers or kilometres away"),
        ("m.stl", b"\0" * 300, "at least four corners"),
        ("m.dae", b"<COLLADA/>", "expected an .stl or .obj mesh, found '.dae'"),
    ],
)
def test_what_is_no_mesh_is_reported(tmp_path: Path, name: str, data: bytes, expected: str) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError) as caught:
        load_hull(tmp_path / name)
    assert expected in str(caught.value)
    assert name in str(caught.value)


def test_hulls_of_too_many_corners_are_refused() -> None:
    points = np.random.default_rng(1).normal(size=(4000, 3))
    with pytest.raises(InputError, match="at most 2000 corners"):
        convex_corners(points / np.linalg.norm(points, axis=1)[:, None])


def test_corners_hold_the_shape_at_its_pose() -> None:
    turned = (0.0, 0.0, float(np.sqrt(0.5)), float(np.sqrt(0.5)))  # x to y
    box = corners(Primitive("box", (0.2, 0.4, 0.6), (1.0, 0.0, 0.0), turned))
    np.testing.assert_allclose(box.min(axis=0), [0.8, -0.1, -0.3], atol=1e-12)
    cylinder = corners(Primitive("cylinder", (0.1, 1.0)))
    np.testing.assert_allclose(np.ptp(cylinder, axis=0), [0.2, 0.2, 1.0])
    hull = corners(Hull(tuple(map(tuple, CUBE)), position=(0.0, 0.0, 1.0)))
    np.testing.assert_allclose([hull.min(axis=0), hull.max(axis=0)], [[0, 0, 1], [1, 1, 3]])
    assert Body("b", (), (1.0, 2.0, 3.0)).pose.translation.tolist() == [1.0, 2.0, 3.0]
