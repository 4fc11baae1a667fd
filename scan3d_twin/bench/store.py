"""Collects the records of a folder into one Parquet file, and reads them back."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from scan3d_twin.bench.journal import JOURNAL_PATTERN, read_journals
from scan3d_twin.bench.record import Record, from_row, sql_columns, to_json
from scan3d_twin.core.errors import ConfigError, FileError
from scan3d_twin.run.folder import fresh_part

RESULTS_FILE = "results.parquet"


def collect_records(folder: Path) -> list[Record]:
    """Return the last record of each run in the journals of ``folder``, sorted.

    A run is a scene, a variant and a seed: a variant that was run again with other options counts
    once.
    """
    records = read_journals(sorted(folder.glob(JOURNAL_PATTERN))).values()
    runs = {(record.scene, record.variant, record.seed): record for record in records}
    return [runs[run] for run in sorted(runs)]


def write_parquet(records: Iterable[Record], path: Path) -> None:
    """Write ``records`` to ``path`` atomically: the whole file or nothing.

    Raises:
        ConfigError: DuckDB is not installed.
        FileError: The disk is full or read-only.
    """
    duckdb = _duckdb()
    try:
        with (
            tempfile.NamedTemporaryFile("w", suffix=".jsonl", encoding="utf-8") as lines,
            fresh_part(path) as part,
            duckdb.connect() as database,
        ):
            # Write JSON lines, then convert them
            lines.writelines(to_json(record) + "\n" for record in records)
            lines.flush()
            rows = database.read_json(lines.name, columns=sql_columns(), format="newline_delimited")
            rows.write_parquet(str(part), compression="zstd")
    except (OSError, duckdb.Error) as error:
        raise FileError(f"cannot write {path}: {error}") from error


def read_results(path: Path) -> list[Record]:
    """Return the records of a Parquet file, or of a folder with journals or with such a file.

    Raises:
        ConfigError: DuckDB is not installed.
        FileError: There are no results.
    """
    if path.is_dir():
        records = (
            collect_records(path)
            if any(path.glob(JOURNAL_PATTERN))
            else _read_parquet(path / RESULTS_FILE)
        )
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
