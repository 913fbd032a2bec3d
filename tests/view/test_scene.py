"""The scene: MeshCat's commands on paper, without a server, the same bytes every time."""

from __future__ import annotations

import base64
import socket
import subprocess
from typing import Any

import numpy as np
import pytest
import umsgpack
from scipy.spatial.transform import RigidTransform

from micah_plan.automaton.hybrid import Primitive
from micah_plan.errors import InputError
from micah_plan.view.scene import DrawnScene, slug
from micah_plan.view.solids import beads


def decoded(scene: DrawnScene) -> list[dict[str, Any]]:
    return [umsgpack.unpackb(base64.b64decode(text)) for text in scene.encoded()]


def drawn() -> DrawnScene:
    scene = DrawnScene()
    scene.primitive("object/a", Primitive("box", (0.1, 0.2, 0.3), position=(1.0, 2.0, 3.0)))
    scene.primitive("object/b", Primitive("cylinder", (0.1, 0.2)))
    scene.mesh("track/c", beads(np.zeros((1, 3)), 0.1), "#112233", opacity=0.5)
    scene.lines("ground", np.zeros((2, 3)), "#112233")
    poses = RigidTransform.from_translation([[0, 0, 0], [1, 0, 0.0]])
    scene.animate("object", np.array([0.0, 2.0]), poses, scales=np.ones((2, 3)))
    return scene


def test_no_process_and_no_socket_is_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise AssertionError("a server was started")

    monkeypatch.setattr(subprocess, "Popen", refuse)
    monkeypatch.setattr(socket, "socket", refuse)
    assert drawn().encoded()


def test_the_same_drawing_gives_the_same_bytes() -> None:
    assert drawn().encoded() == drawn().encoded()


def test_encoding_twice_does_not_repeat_the_animation() -> None:
    scene = drawn()
    assert scene.encoded() == scene.encoded()
    assert [command["type"] for command in decoded(scene)].count("set_animation") == 1


def test_identifiers_stay_unique_and_consistent() -> None:
    objects = [command["object"] for command in decoded(drawn()) if command["type"] == "set_object"]
    for item in objects:
        assert item["object"]["geometry"] == item["geometries"][0]["uuid"]
        assert item["object"]["material"] == item["materials"][0]["uuid"]
    names = [item["object"]["uuid"] for item in objects]
    assert len(set(names)) == len(names) == 4


def test_shapes_stand_at_their_pose_in_the_part() -> None:
    box = next(c for c in decoded(drawn()) if c["type"] == "set_transform" and c["path"].endswith("object/a"))
    np.testing.assert_allclose(np.array(box["matrix"]).reshape(4, 4).T[:3, 3], [1, 2, 3])


def test_the_viewers_cylinder_is_turned_to_stand_along_z() -> None:
    turn = next(c for c in decoded(drawn()) if c["type"] == "set_transform" and c["path"].endswith("object/b"))
    upright = np.array(turn["matrix"]).reshape(4, 4).T[:3, :3] @ [0, 1, 0]
    np.testing.assert_allclose(np.abs(upright), [0, 0, 1], atol=1e-12)


def test_animation_keys_hold_the_poses_at_their_times() -> None:
    clip = next(c for c in decoded(drawn()) if c["type"] == "set_animation")["animations"][0]["clip"]
    track = next(track for track in clip["tracks"] if track["name"] == ".position")
    assert [key["time"] / clip["fps"] for key in track["keys"]] == [0.0, 2.0]
    assert [key["value"] for key in track["keys"]] == [[0, 0, 0], [1, 0, 0]]


@pytest.mark.parametrize("name", ["../../etc", "a/b", "<img src=x>", "", "tür", "x" * 500])
def test_slugs_are_one_safe_path_entry(name: str) -> None:
    entry = slug(name, 3)
    assert entry.startswith("3_")
    assert len(entry) < 50
    assert all(letter.isascii() and (letter.isalnum() or letter == "_") for letter in entry)


def test_unknown_shapes_and_colours_are_named() -> None:
    with pytest.raises(InputError, match="unknown kind of shape 'cone'"):
        DrawnScene().primitive("object/a", Primitive("cone", (1.0,)))
    with pytest.raises(InputError, match="'red'"):
        DrawnScene().mesh("object/a", beads(np.zeros((1, 3)), 0.1), "red")
