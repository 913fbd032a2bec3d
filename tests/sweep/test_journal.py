"""The journal keeps every finished case through any cut of the file, and refuses what it did not write."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from micah_plan.errors import InputError
from micah_plan.sweep.journal import Journal, read_journal, run_of
from micah_plan.sweep.result import NUMBERS, CaseResult, CaseRun

FINITE = st.floats(allow_nan=False, allow_infinity=False)
RUNS = st.builds(
    CaseRun,
    st.builds(
        CaseResult,
        outcome=st.sampled_from(["solved", "no_plan", "worker_died"]),
        reason=st.text(),
        modes=st.lists(st.text(), max_size=3).map(tuple),
        **{name: st.none() | FINITE for name in NUMBERS if name != "successes"},
        successes=st.none() | st.integers(0, 100),
    ),
    st.dictionaries(st.sampled_from(["solve", "total"]), FINITE),
    st.integers(1, 3),
)


@given(RUNS)
def test_a_run_comes_back_to_the_last_bit(run: CaseRun) -> None:
    assert run_of(json.loads(json.dumps(asdict(run)))) == run


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A journal of three cases."""
    path = tmp_path_factory.mktemp("journal") / "r.csv.journal"
    with Journal(path) as journal:
        for i in range(3):
            journal.append(f"key {i}", CaseRun(CaseResult("solved", f"reason {i}", cost=i / 3)))
    return path.read_bytes()


@settings(max_examples=60)
@given(data=st.data())
def test_after_a_kill_anywhere_whole_lines_stay_and_the_rest_is_done_again(
    written: bytes, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    cut = data.draw(st.integers(0, len(written)))
    path = tmp_path_factory.mktemp("cut") / "r.csv.journal"
    path.write_bytes(written[:cut])
    whole = max(0, written[:cut].count(b"\n") - 1)
    with Journal(path) as journal:
        assert list(journal.finished) == [f"key {i}" for i in range(whole)]
        for i in range(whole, 3):
            journal.append(f"key {i}", CaseRun(CaseResult("solved", f"reason {i}", cost=i / 3)))
    assert path.read_bytes() == written


def test_looking_changes_nothing(written: bytes, tmp_path: Path) -> None:
    path = tmp_path / "j"
    assert read_journal(path) == {}
    assert not path.exists()
    path.write_bytes(written[:-5])
    assert len(read_journal(path)) == 2
    assert path.read_bytes() == written[:-5]


@pytest.mark.parametrize(
    "content",
    [b"t,part,x\n", b"a", b'{"format": "micah-plan/sweep-journal/2"}\n', b"\x00" * 50 + b"\n", b"\n"],
)
def test_a_file_that_is_no_journal_is_left_alone(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "mine.journal"
    path.write_bytes(content)
    with pytest.raises(InputError, match="is no journal of a sweep; write the results elsewhere"):
        Journal(path)
    assert path.read_bytes() == content


@pytest.mark.parametrize(
    "line",
    [
        b"{}", b"[]", b"\xff\xfe", b'{"key": 3}', b"[" * 100_000,
        b'{"key": "a", "result": {}, "seconds": {}, "attempts": 1}',
        b'{"key": "a", "result": NaN}', b"1" * 10_000, b'""', b"",
    ],
)  # fmt: skip
def test_a_damaged_line_within_is_reported_with_its_number(written: bytes, tmp_path: Path, line: bytes) -> None:
    path = tmp_path / "r.csv.journal"
    path.write_bytes(written.replace(b"reason 1", line) if line == b"\xff\xfe" else written + line + b"\n")
    number = 3 if line == b"\xff\xfe" else 5
    with pytest.raises(InputError, match=f"line {number}: the line is damaged; delete it; its case is then done again"):
        Journal(path)


@settings(max_examples=100)
@given(at=st.integers(0, 600), removed=st.integers(0, 20), put=st.binary(max_size=20))
def test_a_damaged_journal_is_read_or_refused_in_one_line(
    written: bytes, tmp_path_factory: pytest.TempPathFactory, at: int, removed: int, put: bytes
) -> None:
    path = tmp_path_factory.mktemp("damaged") / "r.csv.journal"
    path.write_bytes(written[:at] + put + written[at + removed :])
    try:
        said = f"{len(read_journal(path))} finished"
    except InputError as error:
        said = str(error)
    assert len(said.splitlines()) == 1


def test_numbers_must_be_finite() -> None:
    data = json.loads(json.dumps(asdict(CaseRun(CaseResult("solved", "", cost=1.0)))))
    data["result"]["cost"] = float("inf")
    with pytest.raises(ValueError, match="finite"):
        run_of(data)


def test_two_sweeps_cannot_write_one_journal(tmp_path: Path) -> None:
    path = tmp_path / "r.csv.journal"
    with Journal(path), pytest.raises(InputError, match="another sweep is writing to it"):
        Journal(path)
    with Journal(path):
        pass


def test_a_journal_that_cannot_be_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be opened"):
        Journal(tmp_path)
    with pytest.raises(InputError, match="cannot be opened"):
        Journal(tmp_path / "no" / "such")
    with pytest.raises(InputError, match="is no journal"):
        Journal(Path("/dev/null"))
