"""Results as a Parquet file: whole or not at all, and read within limits."""

import pytest
from full_disk import full_disk

from scan3d_twin.bench.store import read_results, write_parquet
from scan3d_twin.core.errors import FileError

pytest.importorskip("duckdb", reason="needs the extra bench")


def test_results_come_back(make, tmp_path):
    records = [make(seed=seed) for seed in range(3)]
    write_parquet(records, tmp_path / "results.parquet")
    assert read_results(tmp_path) == records


@pytest.mark.parametrize("room", [100, 8192])
def test_nothing_is_left_of_results_that_do_not_fit(make, tmp_path, room):
    """Neither where the lines do not fit that are converted, nor where the file does not."""
    records = [make(seed=seed, stop=f"{seed:0200}") for seed in range(20)]
    write_parquet(records[:1], tmp_path / "results.parquet")
    before = (tmp_path / "results.parquet").read_bytes()
    with (
        full_disk(room),
        pytest.raises(FileError, match=r"cannot write .*results\.parquet") as error,
    ):
        write_parquet(records, tmp_path / "results.parquet")
    assert len(str(error.value).splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["results.parquet"]
    assert (tmp_path / "results.parquet").read_bytes() == before


def test_repeated_values_are_not_expanded_without_limit(make, tmp_path, monkeypatch):
    write_parquet([make(stop="x" * 3000)] * 50, tmp_path / "results.parquet")
    monkeypatch.setattr("scan3d_twin.limits.FREE_EXPANSION", 0)
    monkeypatch.setattr("scan3d_twin.limits.EXPANSION", 1)
    with pytest.raises(FileError, match="expands to far more than its size; if you trust it, set"):
        read_results(tmp_path)
