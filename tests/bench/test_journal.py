import json
import os
import types
from dataclasses import replace
from typing import Union, get_origin, get_type_hints

import pytest

from scan3d_twin.bench.journal import Journal, journal_path, read_journals
from scan3d_twin.bench.record import Record, Step, from_row, to_json, without_timings
from scan3d_twin.core.errors import FileError


def test_a_record_comes_back_as_it_was(make):
    record = make(stop='a "reason",\nwith µ')
    line = to_json(record)
    assert "\n" not in line
    assert from_row(json.loads(line)) == record


def test_what_is_no_number_is_null_and_what_is_unknown_is_ignored(make):
    row = json.loads(to_json(make(accuracy=float("nan"), max_error=float("inf"))))
    assert row["accuracy"] is None
    assert row["max_error"] is None
    assert from_row({**row, "later": 1}).accuracy is None


def test_what_is_always_measured_is_never_null(make):
    row = json.loads(to_json(make()))
    for cls, place in ((Record, row), (Step, row["steps"][0])):
        for name, hint in get_type_hints(cls).items():
            value, place[name] = place[name], None
            if hint in (bool, float, int, str):
                with pytest.raises(TypeError, match=name):
                    from_row(row)
            elif get_origin(hint) in (Union, types.UnionType):
                from_row(row)
            place[name] = value
    assert from_row(row) == make()


def test_timings_do_not_count(make):
    a, b = make(wall=1.0, plan_cpu=1.0, attempts=1), make(wall=2.0, plan_cpu=2.0, attempts=2)
    assert a != b
    assert without_timings(a) == without_timings(b)
    assert without_timings(make(views=7)) != without_timings(a)


@pytest.mark.parametrize("torn", [1, 20, 300])
def test_a_torn_last_line_counts_for_nothing_and_is_cut(make, tmp_path, torn):
    path = tmp_path / "journal.jsonl"
    with Journal(path) as journal:
        for seed in range(3):
            journal.append(make(seed=seed))
    whole = path.read_bytes()
    path.write_bytes(whole[:-torn])
    assert set(read_journals([path])) == {"a-0", "a-1"}
    with Journal(path) as journal:
        journal.append(make(seed=2))
    assert path.read_bytes() == whole


def test_the_last_line_of_a_task_counts(make, tmp_path):
    path = tmp_path / "journal.jsonl"
    with Journal(path) as journal:
        journal.append(replace(make(), status="lost"))
        journal.append(make())
    assert read_journals([path]) == {"a-0": make()}


@pytest.mark.parametrize("line", [b"{}", b"[1]", b"{'a'", b"\xff\xfe", b'{"steps": 3}'])
def test_a_broken_line_before_the_last_is_told_with_its_number(make, tmp_path, line):
    path = tmp_path / "journal.jsonl"
    record = to_json(make()).encode()
    path.write_bytes(record + b"\n" + line + b"\n" + record + b"\n")
    with pytest.raises(FileError, match="line 2 is no record"):
        read_journals([path])


def test_two_benches_do_not_write_one_journal(tmp_path):
    with Journal(tmp_path / "journal.jsonl"):
        with pytest.raises(FileError, match="another bench"):
            Journal(tmp_path / "journal.jsonl")
        Journal(tmp_path / "journal-1of2.jsonl").__exit__(None, None, None)
    with Journal(tmp_path / "journal.jsonl"):
        pass


def test_an_unwritable_folder_is_told(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(FileError, match="cannot write"):
        Journal(tmp_path / "file" / "journal.jsonl")
    if os.path.exists("/dev/full"):
        journal = Journal(tmp_path / "journal.jsonl")
        full = os.open("/dev/full", os.O_WRONLY)
        os.dup2(full, journal._file)
        with pytest.raises(FileError, match="No space left"):
            journal._write(b"x")
        os.close(full)
        journal.__exit__(None, None, None)


def test_each_shard_has_a_journal_of_its_own(tmp_path):
    names = {journal_path(tmp_path, shard).name for shard in [(1, 1), (1, 2), (2, 2), (1, 3)]}
    assert len(names) == 4


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("seed", "1"), ("seed", 1.5), ("seed", True), ("seed", None), ("views", 10**30),
        ("epsilon", "0.01"), ("epsilon", 1e300), ("status", "over"), ("complete", 1),
        ("scene", None), ("coverage", []), ("steps", {}), ("steps", [1]), ("steps", None),
        ("steps", [{"view": 10**9, "x": 0, "y": 0, "yaw": 0, "path": 0, "turn": 0, "time": 0}]),
    ],
)  # fmt: skip
def test_a_value_of_another_type_or_beyond_reason_is_told(make, tmp_path, name, value):
    path = journal_path(tmp_path, (1, 1))
    row = json.loads(to_json(make("a", 0)))
    path.write_text(json.dumps(row) + "\n")
    assert read_journals([path])
    path.write_text(json.dumps({**row, name: value}) + "\n")
    with pytest.raises(FileError, match="line 1 is no record"):
        read_journals([path])
