"""All records of a folder as one Parquet file, and back."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from scan3d_twin.bench.journal import PATTERN, read_journals
from scan3d_twin.bench.record import Record, columns, from_row, to_json
from scan3d_twin.core.errors import ConfigError, FileError

RESULTS = "results.parquet"


def collect(folder: Path) -> list[Record]:
    """Return the records of all journals in ``folder``: of each run the last one, in order.

    A run is a scene, a variant and a seed: what was run anew with other options under the same
    name counts once.
    """
    records = read_journals(sorted(folder.glob(PATTERN))).values()
    runs = {(record.scene, record.variant, record.seed): record for record in records}
    return [runs[run] for run in sorted(runs)]


def write_parquet(records: Iterable[Record], path: Path) -> None:
    """Write ``records`` to ``path`` so that it is there as a whole or not at all.

    Raises:
        ConfigError: DuckDB is not installed.
        FileError: The disk is full or read-only.
    """
    duckdb = _duckdb()
    part = path.with_name(path.name + ".part")
    with tempfile.NamedTemporaryFile("w", suffix=".jsonl", encoding="utf-8") as lines:
        lines.writelines(to_json(record) + "\n" for record in records)
        lines.flush()
        try:
            with duckdb.connect() as database:
                rows = database.read_json(lines.name, columns=columns(), format="newline_delimited")
                rows.write_parquet(str(part), compression="zstd")
            os.replace(part, path)
        except (OSError, duckdb.Error) as error:
            raise FileError(f"cannot write {path}: {error}") from error


def read_results(path: Path) -> list[Record]:
    """Return the records of a Parquet file, or of a folder with journals or with such a file.

    Raises:
        ConfigError: DuckDB is not installed.
        FileError: There are none.
    """
    if path.is_dir():
        records = collect(path) if any(path.glob(PATTERN)) else _read_parquet(path / RESULTS)
    else:
        records = _read_parquet(path)
    if not records:
        raise FileError(f"{path} holds no results of `twin bench`")
    return records


def _read_parquet(path: Path) -> list[Record]:
    duckdb = _duckdb()
    if not path.is_file():
        raise FileError(f"no file or folder {path}")
    try:
        with duckdb.connect() as database:
            table = database.read_parquet(str(path))
            rows = table.fetchall()
            return [from_row(dict(zip(table.columns, row, strict=True))) for row in rows]
    except (duckdb.Error, KeyError, TypeError) as error:
        raise FileError(f"{path} holds no results of `twin bench`: {error}") from error


def _duckdb() -> Any:
    try:
        import duckdb
    except ImportError:
        raise ConfigError("DuckDB is not installed: pip install duckdb pebble") from None
    return duckdb
