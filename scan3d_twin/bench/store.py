"""Collects the records of a folder into one Parquet file, and reads them back."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from scan3d_twin.bench.journal import JOURNAL_PATTERN, read_journals
from scan3d_twin.bench.record import Record, from_row, sql_columns, to_json
from scan3d_twin.core.errors import ConfigError, FileError
from scan3d_twin.limits import expansion_limit, how_to_raise
from scan3d_twin.run.folder import fresh_part

RESULTS_FILE = "results.parquet"
ROWS_AT_ONCE, VALUE_SIZE = 64, 32
"""Rows that are taken at once, and the memory of a value that is no text [bytes]."""


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
            cursor = database.execute("SELECT * FROM read_parquet(?)", [str(path)])
            names = [column[0] for column in cursor.description]
            rows = _fetch(cursor, expansion_limit(path.stat().st_size))
            return [from_row(dict(zip(names, row, strict=True))) for row in rows]
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror or error}") from error
    except (duckdb.Error, KeyError, TypeError, ValueError, AttributeError) as error:
        reason = str(error).partition("\n")[0]
        raise FileError(f"{path} holds no results of `twin bench`: {reason}") from error


def _fetch(cursor: Any, room: int) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of ``cursor`` as long as they fit into ``room`` [bytes].

    Raises:
        ValueError: They do not: repeated values are stored once in a Parquet file.
    """
    while rows := cursor.fetchmany(ROWS_AT_ONCE):
        for row in rows:
            room -= sum(len(each) if isinstance(each, str) else VALUE_SIZE for each in row)
            if room < 0:
                raise ValueError(f"it expands to far more than its size; {how_to_raise()}")
            yield row


def _duckdb() -> Any:
    try:
        import duckdb
    except ImportError:
        raise ConfigError("DuckDB is not installed: pip install duckdb pebble") from None
    return duckdb
