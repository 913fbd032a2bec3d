"""Other people's tables: each convention planted in a file and undone by its option, beside what must be refused."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from micah_plan import load
from micah_plan.cli.conventions import ConventionOptions
from micah_plan.errors import InputError
from micah_plan.exchange.load import load_recording
from micah_plan.recording.columns import recording_of_columns
from micah_plan.recording.conventions import ColumnSource, Conventions, source_of
from micah_plan.recording.messages import rows_left_out
from micah_plan.recording.read import read_recording, write_recording
from micah_plan.recording.value import Recording

ROWS = 12
# z upwards is what a recording has; the axes of the other frame, as columns in ours.
FRAMES = {
    "x": Rotation.from_euler("y", -90, degrees=True),
    "-x": Rotation.from_euler("y", 90, degrees=True),
    "y": Rotation.from_euler("x", 90, degrees=True),
    "-y": Rotation.from_euler("x", -90, degrees=True),
    "-z": Rotation.from_euler("x", 180, degrees=True),
}


@pytest.fixture
def truth() -> Recording:
    rng = np.random.default_rng(3)
    turns = Rotation.from_euler("xyz", rng.uniform(-1.4, 1.4, (ROWS, 3)))
    return Recording(
        time=0.02 * np.arange(ROWS),
        position=rng.uniform(-1, 1, (ROWS, 3)),
        quaternion=turns.as_quat(),
        action=np.concatenate([rng.uniform(-0.01, 0.01, (ROWS - 1, 3)), np.full((1, 3), np.nan)]),
        part=("door",) * ROWS,
    )


def table(path: Path, columns: Mapping[str, Any]) -> Path:
    """A CSV of columns of numbers; NaN is an empty field."""
    rows = zip(*(np.asarray(values, dtype=float).tolist() for values in columns.values()), strict=True)
    lines = [",".join("" if value != value else repr(value) for value in row) for row in rows]
    path.write_text("\n".join([",".join(columns), *lines]) + "\n")
    return path


def columns_of(
    truth: Recording, length: float = 1.0, time: float = 1.0, frame: Rotation | None = None
) -> dict[str, Any]:
    """What a laboratory with these units and this frame logs of the truth."""
    frame = Rotation.identity() if frame is None else frame.inv()
    assert truth.action is not None
    position, action = (frame.apply(length * vectors) for vectors in (truth.position, truth.action))
    quaternion = (frame * Rotation.from_quat(truth.quaternion)).as_quat()
    names = ("x", "y", "z", "qx", "qy", "qz", "qw", "ax", "ay", "az")
    numbers = np.hstack([position, quaternion, action]).T
    return {"t": time * truth.time, **dict(zip(names, numbers, strict=True))}


def same(read: Recording, truth: Recording) -> None:
    assert_allclose(read.time, truth.time, atol=1e-12)
    assert_allclose(read.position, truth.position, atol=1e-12)
    assert read.quaternion is not None
    turned = Rotation.from_quat(read.quaternion) * Rotation.from_quat(truth.quaternion).inv()
    assert_allclose(turned.magnitude(), 0.0, atol=1e-7)
    if truth.action is not None:
        assert read.action is not None
        assert_allclose(read.action, truth.action, atol=1e-12)


@pytest.mark.parametrize(("unit", "factor"), [("m", 1.0), ("cm", 100.0), ("mm", 1000.0), ("in", 1 / 0.0254)])
def test_units_of_length(truth: Recording, tmp_path: Path, unit: str, factor: float) -> None:
    path = table(tmp_path / "r.csv", columns_of(truth, length=factor))
    read = read_recording(path, conventions=Conventions(length=unit))
    same(read, truth)
    assert read.conventions == {"length": unit}


@pytest.mark.parametrize(("unit", "factor"), [("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_units_of_time(truth: Recording, tmp_path: Path, unit: str, factor: float) -> None:
    path = table(tmp_path / "r.csv", columns_of(truth, time=factor))
    same(read_recording(path, conventions=Conventions(time=unit)), truth)


@pytest.mark.parametrize("up", FRAMES)
def test_the_upward_axis(truth: Recording, tmp_path: Path, up: Any) -> None:
    path = table(tmp_path / "r.csv", columns_of(truth, frame=FRAMES[up]))
    same(read_recording(path, conventions=Conventions(up=up)), truth)
    upward = np.eye(3)["xyz".index(up[-1])] * (-1.0 if up[0] == "-" else 1.0)
    assert_allclose(FRAMES[up].apply(upward), [0, 0, 1], atol=1e-12)


@pytest.mark.parametrize("up", FRAMES)
def test_the_upward_axis_of_other_formats(truth: Recording, tmp_path: Path, up: Any) -> None:
    theirs = read_recording(table(tmp_path / "r.csv", columns_of(truth, frame=FRAMES[up])))
    write_recording(theirs, tmp_path / "r.npz")
    same(read_recording(tmp_path / "r.npz", conventions=Conventions(up=up)), truth)


def test_the_scalar_of_a_quaternion_first(truth: Recording, tmp_path: Path) -> None:
    columns = columns_of(truth)
    first = dict(zip(("qx", "qy", "qz", "qw"), [columns[name] for name in ("qw", "qx", "qy", "qz")], strict=True))
    path = table(tmp_path / "r.csv", columns | first)
    same(read_recording(path, conventions=Conventions(quaternion="wxyz")), truth)


@pytest.mark.parametrize("angle", ["rad", "deg"])
@pytest.mark.parametrize("kind", ["rx,ry,rz", "roll,pitch,yaw"])
def test_orientations_that_are_no_quaternions(truth: Recording, tmp_path: Path, kind: str, angle: str) -> None:
    columns = {name: values for name, values in columns_of(truth).items() if not name.startswith("q")}
    rotation = Rotation.from_quat(truth.quaternion)
    degrees = angle == "deg"
    turns = rotation.as_rotvec(degrees=degrees) if kind == "rx,ry,rz" else rotation.as_euler("xyz", degrees=degrees)
    names = kind.split(",")
    path = table(tmp_path / "r.csv", columns | dict(zip([f"r_{n}" for n in names], turns.T, strict=True)))
    meant = Conventions(columns={name: f"r_{name}" for name in names}, angle=angle)
    read = read_recording(path, conventions=meant)
    same(read, truth)
    assert not read.extra


def test_names_of_columns_with_factors(truth: Recording, tmp_path: Path) -> None:
    columns = columns_of(truth)
    theirs = {"Time": "t", "X [m]": "x", "-Y": "y", "Zneg": "z", "ax_mm": "ax", "ay_mm": "ay", "az_mm": "az"}
    renamed = {name: columns.pop(ours) for name, ours in theirs.items()}
    renamed["Zneg"] = -renamed["Zneg"]
    renamed |= {name: 1000 * renamed[name] for name in ("ax_mm", "ay_mm", "az_mm")}
    path = table(tmp_path / "r.csv", renamed | columns | {"x": np.ones(ROWS)})
    names = {"t": "Time", "x": "X [m]", "y": "-Y", "z": "-Zneg"}  # a column that is called -Y is itself
    names |= {f"a{axis}": f"0.001 * a{axis}_mm" for axis in "xyz"}
    read = read_recording(path, conventions=Conventions(columns=names))
    same(read, truth)
    assert list(read.extra) == ["x of the file"]


def test_rows_at_a_rate(truth: Recording, tmp_path: Path) -> None:
    columns = columns_of(truth)
    frames = table(tmp_path / "frames.csv", columns | {"t": 100.0 + np.arange(ROWS)})
    same(read_recording(frames, conventions=Conventions(rate=50.0)).rows(slice(None)), _later(truth, 2.0))
    del columns["t"]
    same(read_recording(table(tmp_path / "none.csv", columns), conventions=Conventions(rate=50.0)), truth)
    # Rows are counted for each run and part.
    (tmp_path / "two.csv").write_text("part,run,x,y,z\na,0,0,0,0\nb,0,1,0,0\na,0,0,1,0\nb,0,1,1,0\na,1,0,0,0\n")
    two = read_recording(tmp_path / "two.csv", conventions=Conventions(rate=10.0))
    assert_allclose(two.time, [0, 0, 0.1, 0.1, 0])


def _later(recording: Recording, seconds: float) -> Recording:
    from dataclasses import replace

    return replace(recording, time=recording.time + seconds)


def test_lost_rows_are_gaps_and_their_actions_are_kept(truth: Recording, tmp_path: Path) -> None:
    columns = columns_of(truth)
    for name in ("x", "y", "z", "qx", "qy", "qz", "qw"):
        columns[name][4:7] = np.nan
    read = load_recording(table(tmp_path / "r.csv", columns))
    assert len(read) == ROWS - 3
    assert read.notes == (rows_left_out(3, ROWS, 3),)
    assert read.action is not None
    assert truth.action is not None
    # What was commanded from row 3 to row 7 is all that was commanded in between.
    assert_allclose(read.action[3], truth.action[3:7].sum(axis=0))
    assert_allclose(read.action[[2, 4]], truth.action[[2, 7]])


def test_a_pose_of_which_one_number_is_missing_is_refused(truth: Recording, tmp_path: Path) -> None:
    columns = columns_of(truth)
    columns["y"][4] = np.nan
    with pytest.raises(
        InputError, match="line 6, column 'y': expected a number, found none although the pose has others"
    ):
        read_recording(table(tmp_path / "r.csv", columns))
    for name in ("x", "y", "z"):
        columns[name][:] = np.nan
    with pytest.raises(InputError, match="no row has a pose; check the names of the columns"):
        read_recording(table(tmp_path / "r.csv", columns))


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"t": "Tiem"}, "there is no column 'Tiem' to read as t; did you mean 'Time'?"),
        ({"t": "seconds"}, "there is no column 'seconds' to read as t; choose one of Time, x, y, z"),
        ({"t": "Time", "ax": "x"}, "column 'x' is missing, found 't,ax,y,z'"),
        ({"t": "Time", "x": "y"}, "column 'y' is missing, found 't,x of the file,x,z'"),
        ({"t": "Time", "x": "y", "z": "-y"}, "column 'y' is read as x and as z"),
    ],
)
def test_names_that_are_not_there(tmp_path: Path, columns: dict[str, str], message: str) -> None:
    (tmp_path / "r.csv").write_text("Time,x,y,z\n0,1,2,3\n")
    read_recording(tmp_path / "r.csv", conventions=Conventions(columns={"t": "Time"}))
    with pytest.raises(InputError) as refused:
        read_recording(tmp_path / "r.csv", conventions=Conventions(columns=columns))
    assert message in str(refused.value)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"length": "km"}, "length: expected one of m, cm, mm, in, found 'km'"),
        ({"up": "w"}, "up: expected one of x, y, z, -x, -y, -z"),
        ({"rate": 0.0}, "rate: expected rows per second, found 0"),
        ({"columns": {"time": "t"}}, "columns: a recording has no column 'time'; choose among run, part, t"),
        ({"columns": {"roll": "R", "yaw": "Y"}}, "columns: expected all of roll,pitch,yaw"),
    ],
)
def test_conventions_that_there_are_not(given: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as refused:
        Conventions(**given)
    assert message in str(refused.value)


WRITINGS = {
    "as ours": "t,x,y,z,note\n0,1,2,3,a\n0.5,1,2.5,3,a\n",
    "semicolons": "t;x;y;z;note\n0;1;2;3;a\n0.5;1;2.5;3;a\n",
    "decimal commas": "t;x;y;z;note\n0;1;2;3;a\n0,5;1;2,5;3;a\n",
    "tabs": "t\tx\ty\tz\tnote\n0\t1\t2\t3\ta\n5e-1\t1\t2,5\t3\ta\n",
    "comments": "# of the third day\n\n# by me, here\nt,x,y,z,note\n0,1,2,3,a\n0.5,1,2.5,3,a\n",
    "lost": "t,x,y,z,note\n0,1,2,3,a\n0.25,,,,\n0.5,1,2.5,3,a\n",
    "nan": "t,x,y,z,note\n0,1,2,3,a\n0.25,nan,NaN,nan,\n0.5,1,2.5,3,a\n",
}


@pytest.mark.parametrize("writing", WRITINGS)
def test_one_table_in_many_writings(tmp_path: Path, writing: str) -> None:
    (tmp_path / "r.csv").write_text(WRITINGS[writing])
    read = read_recording(tmp_path / "r.csv")
    assert_allclose(read.time, [0, 0.5])
    assert_allclose(read.position, [[1, 2, 3], [1, 2.5, 3]])
    assert read.extra["note"] == ("a", "a")


def test_names_that_numpy_writes_as_a_comment(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "r.csv", [[0, 1, 2, 3], [0.5, 1, 2.5, 3]], delimiter=",", header="t,x,y,z")
    assert_allclose(read_recording(tmp_path / "r.csv").position, [[1, 2, 3], [1, 2.5, 3]])
    # Without names there is none, and rows that begin with # are rows.
    np.savetxt(tmp_path / "none.csv", [[0, 1, 2, 3]], delimiter=",")
    with pytest.raises(InputError, match="expected a header line"):
        read_recording(tmp_path / "none.csv")
    (tmp_path / "numbers.csv").write_text("part,t,x,y,z\n#1,0,1,2,3\n#2,0,1,2,3\n")
    assert read_recording(tmp_path / "numbers.csv").parts == ("#1", "#2")


@pytest.mark.parametrize("zone", ["", "Z", "+02:00"])
def test_times_of_day(tmp_path: Path, zone: str) -> None:
    stamps = [f"2026-11-25T12:00:0{k}.250{zone}" for k in range(4)]
    (tmp_path / "r.csv").write_text("t,x,y,z\n" + "".join(f"{stamp},0,0,0\n" for stamp in stamps))
    begin = datetime.fromisoformat(f"2026-11-25T12:00:00.250{zone or 'Z'}").timestamp()
    for conventions in (Conventions(), Conventions(time="ms")):
        assert_allclose(
            read_recording(tmp_path / "r.csv", conventions=conventions).time, begin + np.arange(4), rtol=1e-15
        )


def test_rows_with_a_quaternion_of_zeros_are_gaps(truth: Recording, tmp_path: Path) -> None:
    columns = columns_of(truth)
    for name in ("x", "y", "z", "qx", "qy", "qz", "qw"):
        columns[name][2:4] = 0.0
    read = read_recording(table(tmp_path / "r.csv", columns))
    assert len(read) == ROWS - 2
    assert "2 rows of 12 have no pose" in read.notes[0]


def test_a_file_next_to_the_recording_is_equivalent_to_options_and_keywords(truth: Recording, tmp_path: Path) -> None:
    columns = {"x": "TX", "y": "TY", "z": "TZ"}
    theirs = {columns.get(name, name): values for name, values in columns_of(truth, 1000.0, frame=FRAMES["y"]).items()}
    path = table(tmp_path / "door.csv", theirs)
    beside = tmp_path / "door.conventions.yaml"
    beside.write_text(
        "format: micah-plan/conventions/1\ncolumns: {x: TX, y: TY, z: TZ}\nlength: mm\nup: y\nname: door\n"
    )
    by_file = load(path)
    assert isinstance(by_file, Recording)
    same(by_file, truth)
    assert by_file.parts == ("door",)
    beside.unlink()
    by_keywords = load(path, columns=columns, length="mm", up="y", name="door")
    assert isinstance(by_keywords, Recording)
    assert by_keywords.digest() == by_file.digest()
    assert by_keywords.conventions == by_file.conventions
    with pytest.raises(InputError, match="conventions have no 'units'; choose among columns, length"):
        load(path, units="mm")


def test_options_are_equivalent_to_conventions() -> None:
    said = ConventionOptions("t=Time, x=-TX", "mm,deg", 120.0, "y", "wxyz", "door", ["/door/pose"], "map").conventions()
    names = {"t": "Time", "x": "-TX"}
    assert said == Conventions(names, "mm", "deg", None, 120.0, "y", "wxyz", "door", ("/door/pose",), "map")
    assert ConventionOptions().conventions() is None


@pytest.mark.parametrize(
    ("columns", "units", "message"),
    [
        ("t", None, "--columns: expected OURS=THEIRS, each once, found 't'"),
        ("t=A,t=B", None, "--columns: expected OURS=THEIRS, each once, found 't=B'"),
        (
            None,
            "mm,cm",
            "--units: expected one unit each of length, angle and time, found 'mm,cm'; e.g. --units mm,deg",
        ),
        (None, "furlong", "--units: expected one unit each of length, angle and time, found 'furlong'"),
    ],
)
def test_options_that_cannot_be_used(columns: str | None, units: str | None, message: str) -> None:
    with pytest.raises(InputError) as refused:
        ConventionOptions(columns, units).conventions()
    assert message in str(refused.value)


def test_the_shipped_log_of_a_laboratory_is_the_shut_microwave(repository: Path) -> None:
    examples = repository / "examples"
    log = load_recording(examples / "logs" / "laboratory.csv")
    original = load_recording(examples / "demonstrations" / "microwave.csv")
    assert log.parts == original.parts
    assert_allclose(log.position, original.position, atol=1e-6)  # six digits were logged
    assert_allclose(log.action, original.action, atol=1e-6)
    assert log.quaternion is not None
    turned = Rotation.from_quat(log.quaternion) * Rotation.from_quat(original.quaternion).inv()
    assert turned.magnitude().max() < 1e-5


def motive(rows: list[str], first: str = "Length Units,Millimeters,Coordinate Space,Global") -> str:
    """As Motive exports two rigid bodies with a marker: seven header lines, the frame and time, poses scalar last."""
    head = [
        f"Format Version,1.23,Take Name,Take 1,Capture Frame Rate,100.000000,Rotation Type,Quaternion,{first}",
        "",
        ",Type" + ",Rigid Body" * 8 + ",Rigid Body Marker" * 3 + ",Rigid Body" * 7,
        ",Name" + ",door" * 8 + ",door:Marker1" * 3 + ",frame" * 7,
        ",ID" + ',"1"' * 8 + ',"2"' * 3 + ',"3"' * 7,
        ",,"
        + ",".join(
            ["Rotation"] * 4 + ["Position"] * 3 + ["Mean Marker Error"] + ["Position"] * 3 + ["Rotation"] * 4
            + ["Position"] * 3
        ),
        "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,,X,Y,Z,X,Y,Z,W,X,Y,Z",
    ]  # fmt: skip
    return "\n".join([*head, *rows]) + "\n"


def test_a_motive_export(tmp_path: Path) -> None:
    lost = ",".join([""] * 7)
    (tmp_path / "take.csv").write_text(
        motive(
            [
                "0,0.000000,0,0,0,1,100,200,300,0.1,1,2,3,0,0,0,1,1000,0,0",
                f"1,0.010000,{lost},,,,,0,0,0,1,1000,0,0",
                "2,0.020000,0,0.6,0,0.8,110,200,300,0.1,1,2,3,0,0,0,1,1000,0,0",
            ]
        )
    )
    read = read_recording(tmp_path / "take.csv")
    assert read.parts == ("door", "frame")
    door = read.select(part="door")
    assert_allclose(door.time, [0.0, 0.02])
    # y upwards: (x, y, z) is (x, -z, y) here.
    assert_allclose(door.position, [[0.1, -0.3, 0.2], [0.11, -0.3, 0.2]])
    assert door.quaternion is not None
    turned = Rotation.from_quat(door.quaternion[1]) * Rotation.from_quat(door.quaternion[0]).inv()
    assert_allclose(turned.as_rotvec(), [0, 0, 2 * np.arcsin(0.6)], atol=1e-12)
    assert "y is taken to point upwards" in read.notes[0]
    assert "1 row of 6 have no pose" in read.notes[1]
    for given in (Conventions(rate=100.0), Conventions(columns={"t": "Frame"})):
        with pytest.raises(InputError, match="an export of Motive or Vicon names its own columns and times; leave out"):
            read_recording(tmp_path / "take.csv", conventions=given)
    upright = read_recording(tmp_path / "take.csv", conventions=Conventions(up="z"))
    assert not any("point upwards" in note for note in upright.notes)  # it was said
    assert_allclose(upright.select(part="door").position[0], [0.1, 0.2, 0.3])


def test_motive_exports_without_bodies_or_with_angles(tmp_path: Path) -> None:
    text = motive(["0,0.0" + ",0" * 18])
    (tmp_path / "markers.csv").write_text(text.replace("Rigid Body", "Marker"))
    with pytest.raises(InputError, match="expected positions of a rigid body, found none"):
        read_recording(tmp_path / "markers.csv")
    (tmp_path / "angles.csv").write_text(text.replace("Rotation Type,Quaternion", "Rotation Type,XYZ"))
    with pytest.raises(InputError, match="line 1: rotations are exported as 'XYZ'; export them as quaternions"):
        read_recording(tmp_path / "angles.csv")


def test_a_vicon_export(tmp_path: Path) -> None:
    head = [
        "Objects",
        "200",
        ",,Global Angle door:door,,,,,,Global Angle frame:frame,,,,,",
        "Frame,Sub Frame,RX,RY,RZ,TX,TY,TZ,RX,RY,RZ,TX,TY,TZ",
        ",,rad,rad,rad,mm,mm,mm,rad,rad,rad,mm,mm,mm",
    ]
    rows = [
        "10,0,0,0,0,100,200,300,0,0,0,500,0,0",
        "11,0,0,0,0.5,110,200,300,,,,,,",
        "12,0,0,0,1,120,200,300,0,0,0,500,0,0",
    ]
    (tmp_path / "vicon.csv").write_text("\n".join([*head, *rows]) + "\n")
    read = read_recording(tmp_path / "vicon.csv")
    assert read.parts == ("door", "frame")
    door, frame = (read.select(part=name) for name in read.parts)
    assert_allclose(door.time, [0.05, 0.055, 0.06])
    assert_allclose(door.position[:, 0], [0.1, 0.11, 0.12])
    assert door.quaternion is not None
    assert_allclose(Rotation.from_quat(door.quaternion).as_rotvec()[:, 2], [0, 0.5, 1], atol=1e-12)
    assert len(frame) == 2
    (tmp_path / "no_rate.csv").write_text("\n".join(["Objects", "fast", *head[2:], *rows]) + "\n")
    with pytest.raises(InputError, match=r"line 2: expected the rate \[Hz\]"):
        read_recording(tmp_path / "no_rate.csv")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("pos", ColumnSource("pos")),
        ("-pos", ColumnSource("pos", -1.0)),
        ("0.5*pos", ColumnSource("pos", 0.5)),
        ("pos-2048", ColumnSource("pos", 1.0, -2048.0)),
        ("0.5 * (pos + 3.5)", ColumnSource("pos", 0.5, 3.5)),
        ("-(pos-1e3)", ColumnSource("pos", -1.0, -1e3)),
        ("joint-1", ColumnSource("joint-1")),
        ("0.5*joint-1", ColumnSource("joint-1", 0.5)),
        ("0.5*(joint-1+2)", ColumnSource("joint-1", 0.5, 2.0)),
        ("lost-7", ColumnSource("lost-7")),
    ],
)
def test_columns_have_factors_and_offsets_unless_a_name_looks_like_one(text: str, expected: ColumnSource) -> None:
    assert source_of(text, ["t", "pos", "joint-1"]) == expected


def test_counts_of_an_encoder_are_metres(tmp_path: Path) -> None:
    rows = [f"{0.1 * k},{2048 + 100 * k},0,0" for k in range(4)]
    (tmp_path / "log.csv").write_text("\n".join(["t,pos,y,z", *rows]) + "\n")
    read = read_recording(tmp_path / "log.csv", conventions=Conventions(columns={"x": "0.001*(pos-2048)"}))
    np.testing.assert_allclose(read.position[:, 0], [0.0, 0.1, 0.2, 0.3], atol=1e-12)


def test_stamps_in_nanoseconds_of_formats_that_check_their_rows(tmp_path: Path) -> None:
    stamps = [1_600_000_000_000_000_000 + 50_000_000 * k for k in range(4)]
    rows = [f"{stamp} 0.1 0.2 {0.1 * k} 0 0 0 1" for k, stamp in enumerate(stamps)]
    (tmp_path / "ns.tum").write_text("\n".join(rows) + "\n")
    np.savez(tmp_path / "ns.npz", time=np.array(stamps, dtype=float), position=np.zeros((4, 3)))
    for name in ("ns.tum", "ns.npz"):
        read = read_recording(tmp_path / name, conventions=Conventions(time="ns"))
        np.testing.assert_allclose(np.diff(read.time), 0.05, atol=1e-6)
        with pytest.raises(InputError, match="expected a finite number of at most 1e\\+12"):
            read_recording(tmp_path / name)


def test_times_of_day_in_tables_that_come_as_columns() -> None:
    columns = {"t": ["2026-11-28T10:00:00.5", "2026-11-28T10:00:01.0"], "x": [0.0, 0.1], "y": [0, 0], "z": [0, 0]}
    read = recording_of_columns({name: tuple(v) if name == "t" else np.array(v) for name, v in columns.items()})
    assert np.diff(read.time) == pytest.approx(0.5)
    for texts, message in (
        (("soon", "later"), "row 1, column 't'"),
        (("0.1", "0.2"), "expected numbers in the column 't'"),
    ):
        with pytest.raises(InputError, match=message):
            recording_of_columns({"t": texts, "x": np.zeros(2), "y": np.zeros(2), "z": np.zeros(2)})


def test_blanks_separate_columns_without_other_separators(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("t x  y z note\n0.0 1 2 3 a\n0.1 1.5 2 3 b\n")
    read = read_recording(tmp_path / "log.csv")
    np.testing.assert_array_equal(read.position, [[1.0, 2.0, 3.0], [1.5, 2.0, 3.0]])
    assert read.extra == {"note": ("a", "b")}
    (tmp_path / "log.csv").write_text("t,x,y,z,my note\n0.0,1,2,3,a b\n")
    assert read_recording(tmp_path / "log.csv").extra == {"my note": ("a b",)}
    (tmp_path / "log.csv").write_text("t x y z\n0.0 1 2\n")
    with pytest.raises(InputError, match="line 2: expected 4 fields as in the header, found 3"):
        read_recording(tmp_path / "log.csv")


def test_columns_without_a_header_are_named_by_their_numbers(tmp_path):
    path = tmp_path / "plain.txt.csv"
    path.write_text("".join(f"{0.1 * k:.1f} 7 {10.0 * k:.1f} 200 300\n" for k in range(8)))
    meant = Conventions(columns={"t": "1", "x": "0.001*3", "y": "4", "z": "5"})
    recording = read_recording(path, conventions=meant)
    assert len(recording) == 8
    assert recording.time[-1] == pytest.approx(0.7)
    assert recording.position[-1].tolist() == pytest.approx([0.07, 200.0, 300.0])
    with pytest.raises(InputError, match=r"line 1: expected a header line.*give them by number: --columns t=1"):
        read_recording(path)
    with pytest.raises(InputError, match="no column '9'"):
        read_recording(path, conventions=Conventions(columns={"t": "1", "x": "9", "y": "4", "z": "5"}))
