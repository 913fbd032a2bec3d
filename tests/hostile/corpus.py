"""Hostile files, made when they are asked for: what a reader may be given by mistake or on purpose.

`python tests/hostile/corpus.py FOLDER` writes them into a folder.
"""

from __future__ import annotations

import io
import json
import os
import pickle
import struct
import sys
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
MEBIBYTE = 1024 * 1024
PROBLEM, MODEL, SWEEP = (b"format: micah-plan/%s/1\n" % kind for kind in (b"problem", b"model", b"sweep"))
BINARY = bytes(range(256)) * 40


class Opens:
    """Unpickling it would make a file `unpickled` in the working directory."""

    def __reduce__(self) -> tuple[Callable[..., object], tuple[str, int]]:
        return os.open, ("unpickled", os.O_CREAT)


def yaml_files() -> Iterator[tuple[str, bytes]]:
    """Problems, models and sweeps."""
    bomb = b"a: &a [x,x,x,x,x,x,x,x,x]\n"
    for last, name in zip("abcdefgh", "bcdefghi", strict=True):
        bomb += f"{name}: &{name} [{','.join(['*' + last] * 9)}]\n".encode()
    yield "alias_bomb", PROBLEM + bomb
    yield "anchor_loop", PROBLEM + b"a: &a [*a]\n"
    yield "merge_key", PROBLEM + b"<<: {a: 1}\n"
    yield "deep_flow", PROBLEM + b"a: " + b"[" * 200_000
    yield "deep_braces", PROBLEM + b"a: " + b"{a: " * 50_000
    yield "deep_blocks", PROBLEM + b"".join(b" " * i + b"a:\n" for i in range(1500))
    yield "deep_dashes", PROBLEM + b"a: \n  " + b"- " * 100_000 + b"1\n"
    yield "huge_integer", PROBLEM + b"confidence: " + b"9" * 200_000 + b"\n"
    yield "huge_exponent", PROBLEM + b"confidence: 1e999999999\n"
    yield "not_a_number", PROBLEM + b"confidence: .nan\nstart: {mean: {a: .inf}}\n"
    yield "sexagesimal", PROBLEM + b"confidence: 190:20:30\n"
    yield "long_key", PROBLEM + b"? " + b"k" * MEBIBYTE + b"\n: 1\n"
    yield "long_value", PROBLEM + b"model: " + b"m" * 3 * MEBIBYTE + b"\n"
    yield "too_long", PROBLEM + b"#" * 5 * MEBIBYTE
    yield "many_values", PROBLEM + b"a: [" + b"1," * 400_000 + b"1]\n"
    yield "many_keys", PROBLEM + b"".join(b"k%d: 1\n" % i for i in range(60_000))
    yield "many_quotes", PROBLEM + b"a: '" + b"''" * 500_000 + b"'\n"
    yield "many_comments", PROBLEM + b"# x\n" * 400_000
    yield "many_documents", PROBLEM + b"---\na: 1\n" * 20_000
    yield "python_object", PROBLEM + b"model: !!python/object/apply:os.system ['touch ran']\n"
    yield "directive", b"%TAG ! tag:evil,2000:\n---\n" + PROBLEM
    yield "binary", BINARY
    yield "utf16", (PROBLEM.decode() + "model: x\n").encode("utf-16")
    yield "latin1", PROBLEM + "model: t\xfcr.yaml\n".encode("latin-1")
    yield "bidi", PROBLEM + "model: 'a\u202eb\u2028c'\n".encode()
    yield "empty", b""
    yield "nul", PROBLEM + b"model: a\0b\n"
    start = (
        b"start: {mean: {drawer: 0.1}, std: {drawer: 0.01}}\ngoal: {target: {drawer: {value: 0.2, tolerance: 0.01}}}\n"
    )
    for name, model in {
        "model_traversal": "../../../../../../etc/passwd",
        "model_absolute": "/etc/passwd",
        "model_endless": "/dev/zero",
        "model_random": "/dev/urandom",
        "model_pipe": "pipe.yaml",
        "model_itself": "model_itself.yaml",
        "model_folder": ".",
        "model_tilde": "~root/.profile",
        "model_null": "'a\\0b'",
        "model_long": "x" * 5000,
    }.items():
        yield name, PROBLEM + f"model: {model}\n".encode() + start
    good = (ROOT / "problems" / "drawer_open.yaml").read_bytes().replace(b"../models", str(ROOT / "models").encode())
    for name, more in {
        "mesh_traversal": "scene: {s: {shapes: [{kind: mesh, path: ../../../../etc/passwd}]}}",
        "mesh_absolute": "scene: {s: {shapes: [{kind: mesh, path: /dev/zero}]}}",
        "mesh_pipe": "scene: {s: {shapes: [{kind: mesh, path: pipe.stl}]}}",
        "robot_endless": "robot: {path: /dev/zero, tool: t}\ngrasp: {part: drawer}",
        "robot_pipe": "robot: {path: pipe.urdf, tool: t}\ngrasp: {part: drawer}",
        "robot_packages": "robot: {path: r.urdf, tool: t, packages: {p: ../../../..}}\ngrasp: {part: drawer}",
        "huge_size": "scene: {s: {shapes: [{kind: box, size: [1.0e308, 1.0e308, 1.0e308]}]}}",
        "many_shapes": f"scene: {{s: {{shapes: [{','.join(['{kind: sphere, size: [1]}'] * 60_000)}]}}}}",
        "many_knots": "confidence: 0.999999999999",
    }.items():
        yield name, good + more.encode() + b"\n"
    yield from sweep_files()
    yield "wide_model", wide_model(1500, 40)
    yield "many_transitions", wide_model(120, 8000)
    yield (
        "long_expression",
        MODEL + b"coordinates: {a: m}\ninputs: {a: m}\nmodes: {m: {invariant: ['" + b"a + " * 200_000 + b"a >= 1']}}\n",
    )
    yield "deep_expression", wide_model(1, 1).replace(b"c0 >= 0", b"(" * 50_000 + b"c0 >= 0")


def sweep_files() -> Iterator[tuple[str, bytes]]:
    """Sweeps that would never end, or that name what is no problem."""
    drawer = f"problems: [{ROOT}/problems/drawer_open.yaml]\n"
    for name, text in {
        "sweep_itself": "problems: [sweep_itself.yaml]",
        "sweep_endless": "problems: [/dev/zero]",
        "sweep_traversal": "problems: [../../../../../../etc/passwd]",
        "sweep_pipe": "problems: [pipe.yaml]",
        "sweep_many_problems": f"problems: [{','.join(f'p{i}.yaml' for i in range(90_000))}]",
        "sweep_many_seeds": drawer + "seeds: 1000000",
        "sweep_huge_grid": drawer + "grid:\n" + "".join(f"  k{i}: [1, 2]\n" for i in range(10_000)),
        "sweep_many_keys": drawer + "grid:\n" + "".join(f"  start.mean.k{i}: [1]\n" for i in range(20_000)),
        "sweep_many_values": drawer + f"grid: {{confidence: [{','.join('0.6' for _ in range(90_000))}]}}",
        "sweep_deep_value": drawer + "grid: {goal: [" + "{a: " * 15 + "1" + "}" * 15 + "]}",
        "sweep_long_path": drawer + "grid: {" + ".".join("a" * 45) + ": [1]}",
        "sweep_into_text": drawer + "grid: {model.a.b.c: [1]}",
        "sweep_other_model": drawer + "grid: {model: [/etc/passwd]}",
    }.items():
        yield name, SWEEP + text.encode() + b"\n"


def wide_model(coordinates: int, transitions: int) -> bytes:
    """A model of one mode with so many coordinates and transitions: matrices grow with their product."""
    names = [f"c{i}" for i in range(coordinates)]
    lines = [MODEL.decode(), f"coordinates: {{{', '.join(f'{n}: m' for n in names)}}}"]
    lines += [f"inputs: {{{', '.join(f'{n}: m' for n in names)}}}", "links:"]
    lines += [f"  - {{parent: base, child: p{n}, coordinate: {n}}}" for n in names]
    noise = ", ".join(f"{n}: 0.1" for n in names)
    lines += [f"noise: {{process_std: {{{noise}}}, observation_std: {{{noise}}}}}", "modes:", "  m:", "    joints:"]
    lines += [f"      p{n}: {{kind: prismatic, position: [0, 0, 0], axis: [1, 0, 0]}}" for n in names]
    lines += [
        f"    step: {{{', '.join(f'{n}: input {n}' for n in names)}}}",
        "    invariant: [c0 >= 0]",
        "transitions:",
    ]
    lines += ["  - {source: m, target: m, guard: [c0 > 1], reset: {c0: 1}}"] * transitions
    return ("\n".join(lines) + "\n").encode()


def json_files() -> Iterator[tuple[str, bytes]]:
    """Plans."""
    yield "deep_lists", b"[" * 500_000
    yield "deep_closed", b"[" * 5_000 + b"]" * 5_000
    yield "deep_objects", b'{"a":' * 100_000
    yield "huge_integer", b'{"seed": ' + b"9" * 200_000 + b"}"
    yield "huge_float", b'{"format": "micah-plan/plan/1", "cost": 1e999}'
    yield "not_a_number", b'{"format": "micah-plan/plan/1", "digest": NaN}'
    yield "many_numbers", b"[" + b"0," * 3_000_000 + b"0]"
    yield "twice", b'{"format": "micah-plan/plan/1", "format": "micah-plan/model/1"}'
    yield "surrogate", b'{"format": "\\ud800"}'
    yield "surrogate_key", b'{"format": "micah-plan/plan/1", "\\udfff": 1}'
    yield "binary", BINARY
    yield "empty", b""
    yield "null", b"null"
    yield "number_as_format", b'{"format": 1e5}'
    yield "cut", json.dumps({"format": "micah-plan/plan/1", "digest": "x" * 1000}).encode()[:-7]


def csv_files() -> Iterator[tuple[str, bytes]]:
    """Recordings as text."""
    yield "one_line", b"t,x,y,z\n" + b"1" * 20 * MEBIBYTE
    yield "many_columns", b",".join(b"c%d" % i for i in range(200_000)) + b"\n1\n"
    yield "many_commas", b"t,x,y,z\n" + b"," * 2_000_000
    yield "open_quote", b't,x,y,z,n\n0,0,0,0,"' + b"a" * 500_000 + b"\n" * 1000
    yield "many_quotes", b"t,x,y,z,n\n0,0,0,0," + b'"' * 500_001 + b"\n"
    yield "huge_number", b"t,x,y,z\n0," + b"9" * 400_000 + b",0,0\n"
    yield "huge_exponent", b"t,x,y,z\n0,1e99999999999999999999,0,0\n"
    yield "huge_run", b"run,t,x,y,z\n99999999999999999999999,0,0,0,0\n"
    yield "tiny", b"t,x,y,z\n" + b"".join(b"%d,1e-320,4.9e-324,0\n" % i for i in range(30))
    yield "not_a_number", b"t,x,y,z\nnan,inf,-inf,0\n"
    yield "hexadecimal", b"t,x,y,z\n0x10,0,0,0\n"
    yield "formula", b't,x,y,z,n\n0,0,0,0,=cmd|"/c calc"!A1\n'
    yield "nul", b"t,x,y,z\n0,0\0,0,0\n"
    yield "binary", BINARY
    yield "empty", b""
    yield "only_ends", b"\r\n" * 500_000
    yield "same_time", b"t,x,y,z\n" + b"0,0,0,0\n" * 1000
    yield "utf16", "t,x,y,z\n0,0,0,0\n".encode("utf-16")
    yield "many_runs", b"run,t,x,y,z\n" + b"".join(b"%d,0,0,0,0\n" % i for i in range(30_000))
    yield "many_parts", b"part,t,x,y,z\n" + b"".join(b"p%d,0,0,0,0\n" % i for i in range(30_000))


def npz_files() -> Iterator[tuple[str, bytes]]:
    """Recordings as arrays."""

    def archive(members: dict[str, bytes], compression: int = zipfile.ZIP_DEFLATED) -> bytes:
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w", compression) as made:
            for name, content in members.items():
                made.writestr(name, content)
        return buffer.getvalue()

    def array(header: str, content: bytes = b"") -> bytes:
        text = header.encode().ljust(118) + b"\n"
        return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + content

    yield "zip_bomb", archive({"time.npy": bytes(300 * MEBIBYTE)})
    yield "bomb_in_bomb", archive({"time.npy": archive({"time.npy": bytes(50 * MEBIBYTE)})})
    yield "bzip_bomb", archive({"time.npy": bytes(300 * MEBIBYTE)}, zipfile.ZIP_BZIP2)
    yield (
        "lying_shape",
        archive({"time.npy": array("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,)}")}),
    )
    yield "negative_shape", archive({"time.npy": array("{'descr': '<f8', 'fortran_order': False, 'shape': (-1,)}")})
    yield (
        "many_dimensions",
        archive({"time.npy": array("{'descr': '<f8', 'fortran_order': False, 'shape': (" + "1," * 20 + ")}")}),
    )
    yield "no_size", archive({"time.npy": array("{'descr': '|S0', 'fortran_order': False, 'shape': (10000000000,)}")})
    yield "code_as_header", archive({"time.npy": array("__import__('os').system('touch ran')")})
    yield "deep_header", archive({"time.npy": array("(" * 100)})
    pickled = io.BytesIO()
    np.save(pickled, np.array([Opens()], dtype=object), allow_pickle=True)
    yield "pickle", archive({"time.npy": pickled.getvalue()})
    yield "bare_pickle", pickle.dumps(Opens())
    yield "traversal", archive({"../../../evil.npy": b"x", "time.npy": b"x"})
    yield "absolute", archive({"/evil.npy": b"x"})
    yield "many_members", archive({f"{i}.npy": b"" for i in range(5_000)})
    good = io.BytesIO()
    np.savez(good, time=np.arange(9.0), position=np.zeros((9, 3)))
    yield "cut", good.getvalue()[:-40]
    lying = bytearray(good.getvalue())
    at = lying.find(b"PK\x01\x02")
    lying[at + 24 : at + 28] = struct.pack("<I", 10)
    yield "lying_directory", bytes(lying)
    yield "binary", BINARY
    yield "empty", b""


def tum_files() -> Iterator[tuple[str, bytes]]:
    """Trajectories."""
    yield "words", b"a b c d e f g h\n"
    yield "one_line", b"1 " * 5_000_000
    yield "huge_number", b"0 " + b"9" * 400_000 + b" 0 0 0 0 0 1\n"
    yield "zero_turn", b"0 0 0 0 0 0 0 0\n"
    yield "comments", b"# x\n" * 300_000
    yield "binary", BINARY
    yield "empty", b""


def parquet_files() -> Iterator[tuple[str, bytes]]:
    """Tables."""
    import pyarrow
    from pyarrow import parquet

    def table(**columns: Any) -> bytes:
        buffer = io.BytesIO()
        parquet.write_table(pyarrow.table(columns), buffer)
        return buffer.getvalue()

    places = {axis: [0.0, 1.0] for axis in "xyz"}
    good = table(t=[0.0, 1.0], **places)
    nested: Any = 1.0
    for _ in range(50):
        nested = {"a": nested}
    yield "bomb", table(t=pyarrow.array(np.zeros(40_000_000, dtype=np.int8)))
    yield "lists", table(t=[0.0, 1.0], **places, x1=[[0.0] * 9, [0.0]], y1=[None, [1.0]], z1=[[], []])
    yield "nested", table(t=[nested, nested])
    yield "texts", table(t=["0", "1"], **places)
    yield "nothing", table(t=pyarrow.array([], pyarrow.float64()), **dict.fromkeys("xyz", pyarrow.array([], "f8")))
    yield "no_numbers", table(t=[0.0, None], **places)
    yield "large_runs", table(t=[0.0, 1.0], **places, run=pyarrow.array([0, 2**64 - 1], pyarrow.uint64()))
    yield "flags", table(t=[True, False], **places)
    yield "vectors", table(t=[[0.0], [1.0]], **places)
    yield "episodes", table(timestamp=["a", "b"], episode_index=[0, 0])
    yield "no_time", table(episode_index=[0, 0], **{"observation.state": [[1.0], [2.0]]})
    yield "cut", good[: len(good) // 2] + b"PAR1"
    yield "footer", good[:-8] + struct.pack("<I", 2**31 - 1) + b"PAR1"
    yield "binary", BINARY
    yield "empty", b""


def mcap_files() -> Iterator[tuple[str, bytes]]:
    """Logs, made byte by byte."""
    magic = b"\x89MCAP0\r\n"

    def record(opcode: int, content: bytes, length: int | None = None) -> bytes:
        return bytes([opcode]) + struct.pack("<Q", len(content) if length is None else length) + content

    def text(value: str) -> bytes:
        return struct.pack("<I", len(value.encode())) + value.encode()

    def chunk(data: bytes, compression: str, size: int) -> bytes:
        return record(6, struct.pack("<QQQI", 0, 0, size, 0) + text(compression) + struct.pack("<Q", len(data)) + data)

    header = magic + record(1, text("ros2") + text("x"))
    tail = record(15, struct.pack("<I", 0)) + record(2, struct.pack("<QQI", 0, 0, 0)) + magic
    kind = "tf2_msgs/msg/TFMessage"
    schema = record(3, struct.pack("<H", 1) + text(kind) + text("ros2msg") + struct.pack("<I", 0))
    channel = record(4, struct.pack("<HH", 1, 1) + text("/tf") + text("cdr") + struct.pack("<I", 0))

    def message(data: bytes) -> bytes:
        return record(5, struct.pack("<HIQQ", 1, 0, 0, 0) + data)

    import lz4.frame
    import zstandard

    yield "zstd_bomb", header + chunk(zstandard.compress(bytes(600 * MEBIBYTE)), "zstd", 10) + tail
    yield "lz4_bomb", header + chunk(lz4.frame.compress(bytes(400 * MEBIBYTE)), "lz4", 10) + tail
    yield "many_chunks", header + chunk(zstandard.compress(bytes(MEBIBYTE)), "zstd", MEBIBYTE) * 400 + tail
    yield "lying_size", header + chunk(zstandard.compress(b"x"), "zstd", 2**63) + tail
    yield "unknown_packing", header + chunk(b"x", "middle-out", 1) + tail
    yield "endless_record", header + record(5, b"", 2**62) + tail
    yield (
        "lying_chunk",
        header + record(6, struct.pack("<QQQI", 0, 0, 1, 0) + text("") + struct.pack("<Q", 2**40)) + tail,
    )
    yield "endless_text", header + record(3, struct.pack("<HI", 1, 2**32 - 1)) + tail
    yield "endless_sequence", header + schema + channel + message(b"\0\1\0\0" + struct.pack("<I", 2**32 - 1)) + tail
    yield (
        "endless_frame",
        header + schema + channel + message(b"\0\1\0\0" + struct.pack("<IiII", 1, 0, 0, 2**31)) + tail,
    )
    yield "no_data", header + schema + channel + message(b"") + tail
    yield (
        "bad_text",
        header + schema + channel + message(b"\0\1\0\0" + struct.pack("<IiII", 1, 0, 0, 4) + b"\xff\xfe\xff\0") + tail,
    )
    yield "no_channel", header + schema + message(b"\0\1\0\0\0\0\0\0") + tail
    yield (
        "hostile_schema",
        header + record(3, struct.pack("<H", 1) + text(kind) + text("ros2msg") + text("x" * 10_000)) + channel + tail,
    )
    yield "nothing", header + tail
    yield "cut", header + schema[:9]
    yield "magic_only", magic
    yield "binary", BINARY
    yield "empty", b""


def urdf_files() -> Iterator[tuple[str, bytes]]:
    """Robots."""

    def links(count: int) -> bytes:
        return b"".join(b'<link name="l%d"/>' % i for i in range(count))

    def chain(count: int) -> bytes:
        ends = b'<parent link="l%d"/><child link="l%d"/><limit lower="0" upper="1"/>'
        joint = b'<joint name="j%d" type="revolute">' + ends + b"</joint>"
        return (
            b"<robot name='r'>" + links(count + 1) + b"".join(joint % (i, i, i + 1) for i in range(count)) + b"</robot>"
        )

    laughs = b'<!DOCTYPE r [<!ENTITY a "ha">' + b"".join(
        b'<!ENTITY %c "%s">' % (98 + i, b"&%c;" % (97 + i) * 10) for i in range(9)
    )
    yield "billion_laughs", laughs + b"]><robot name='&j;'/>"
    yield "external_entity", b'<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]><robot name="&x;"/>'
    yield "external_type", b'<!DOCTYPE robot SYSTEM "http://localhost/x.dtd"><robot/>'
    yield "deep", b"<robot>" + b"<a>" * 200_000
    yield "many_links", b"<robot name='r'>" + links(60_000) + b"</robot>"
    yield "long_chain", chain(6_000)
    yield "wide_chain", chain(400)
    yield (
        "cycle",
        b"<robot name='r'>"
        + links(2)
        + b'<joint name="a" type="fixed"><parent link="l0"/><child link="l1"/></joint>'
        + b'<joint name="b" type="fixed"><parent link="l1"/><child link="l0"/></joint></robot>',
    )
    yield (
        "itself",
        b"<robot name='r'>"
        + links(1)
        + b'<joint name="a" type="continuous"><parent link="l0"/><child link="l0"/></joint></robot>',
    )
    yield "not_a_number", chain(2).replace(b'upper="1"', b'upper="nan"')
    yield "huge_number", chain(2).replace(b'upper="1"', b'upper="1e308"')
    yield "huge_attribute", b"<robot name='" + b"x" * 3 * MEBIBYTE + b"'/>"
    yield "many_attributes", b"<robot " + b" ".join(b"a%d='1'" % i for i in range(50_000)) + b"/>"
    yield (
        "mesh_traversal",
        chain(1).replace(
            b'<link name="l0"/>',
            b'<link name="l0"><visual><geometry><mesh filename="package://../../../../etc/passwd"/></geometry></visual></link>',
        ),
    )
    yield "too_large", b"<robot>" + b" " * 9 * MEBIBYTE + b"</robot>"
    yield "utf7", b"<?xml version='1.0' encoding='UTF-7'?><robot/>"
    yield "processing", b"<?xml-stylesheet href='file:///etc/passwd'?>" * 10_000 + b"<robot/>"
    yield "binary", BINARY
    yield "empty", b""


FILES: dict[str, Callable[[], Iterator[tuple[str, bytes]]]] = {
    ".yaml": yaml_files,
    ".json": json_files,
    ".csv": csv_files,
    ".npz": npz_files,
    ".parquet": parquet_files,
    ".tum": tum_files,
    ".mcap": mcap_files,
    ".urdf": urdf_files,
}


def write_corpus(folder: Path) -> list[Path]:
    """Write all hostile files, and the pipes that some of them name; returns the files."""
    written = []
    for suffix, made in FILES.items():
        for name, content in made():
            path = folder / f"{name}{suffix}"
            path.write_bytes(content)
            written.append(path)
    for name in ("pipe.yaml", "pipe.stl", "pipe.urdf", "pipe.csv"):
        if not (folder / name).exists():
            os.mkfifo(folder / name)
    return [*written, folder / "pipe.yaml", folder / "pipe.csv", folder / "pipe.urdf"]


if __name__ == "__main__":
    print(f"wrote {len(write_corpus(Path(sys.argv[1])))} files")
