"""The files of a report: report.html, each figure and table as SVG and CSV, and a folder a run."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

from scan3d_twin.bench.execute import PICTURES_FOLDER, picture_path
from scan3d_twin.bench.record import Record, Step
from scan3d_twin.bench.reporting.compare import compare_variants, compare_with_oracle
from scan3d_twin.bench.reporting.figure import Cells
from scan3d_twin.bench.reporting.figures import draw_figures
from scan3d_twin.bench.reporting.measures import MEASURES, SummaryRow, summarise
from scan3d_twin.bench.reporting.page import comparison_cells, render_bench_page
from scan3d_twin.bench.reporting.run_list import PICTURE_FILE, RUNS_FOLDER, name_run, run_files
from scan3d_twin.run.folder import write_file, write_inside

PAGE_FILE = "report.html"


def write_report(records: Sequence[Record], title: str, pictures: Path, out: Path) -> Path:
    """Write the report of ``records`` into the folder ``out`` and return the page.

    Args:
        records: Records of one experiment.
        title: Name of the experiment.
        pictures: Folder of the bench, which may hold top views.
        out: Folder of the report; files of the same names are replaced.

    Raises:
        FileError: The folder cannot be written.
    """
    # Write the figures
    rows, compared, figures = summarise(records), compare_variants(records), draw_figures(records)
    for figure in figures:
        alone = figure.svg.replace('href="#', f'href="../{PAGE_FILE}#')
        write_inside(out, out / "figures" / f"{figure.file_name}.svg", alone)
        write_inside(out, out / "figures" / f"{figure.file_name}.csv", csv_text(figure.rows))

    # Write the tables
    write_file(out / "summary.csv", csv_text(_summary_rows(rows)))
    write_file(out / "steps.csv", csv_text(_step_rows(records)))
    write_file(out / "comparisons.csv", csv_text(comparison_cells(compared)))

    # Write the folder of each run
    for record in records:
        home = out / RUNS_FOLDER / name_run(record)
        for name, text in run_files(record).items():
            write_inside(out, home / name, text)
        if (picture := picture_path(pictures, record)).is_file():
            write_inside(out, home / PICTURE_FILE, picture.read_bytes())

    # Write the page
    text = render_bench_page(
        title,
        records,
        rows,
        compared,
        compare_with_oracle(records),
        figures,
        _pictures(records, pictures),
    )
    write_file(out / PAGE_FILE, text)
    return out / PAGE_FILE


def csv_text(rows: Cells) -> str:
    """Return ``rows`` as CSV; None and NaN are empty cells."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(
        [None if isinstance(cell, float) and math.isnan(cell) else cell for cell in row]
        for row in rows
    )
    return text.getvalue()


def _summary_rows(rows: Sequence[SummaryRow]) -> Cells:
    # Name the columns
    parts = ("", "_low", "_high")
    names = [measure.name + part for measure in MEASURES for part in parts]
    cells: Cells = [["scene", "variant", "scope", "runs", "failed", "lost", *names]]

    # Fill one line per row
    for row in rows:
        numbers = [
            value
            for measure in MEASURES
            for e in [row.figures[measure.name]]
            for value in (e.value, e.low, e.high)
        ]
        names_of_row: list[str | float | int | None] = [
            row.scene,
            row.variant,
            row.scope,
            row.runs,
            row.failed,
            row.lost,
        ]
        cells.append([*names_of_row, *numbers])
    return cells


def _step_rows(records: Sequence[Record]) -> Cells:
    """Return one row per view of all runs, with a heading."""
    names = [field.name for field in fields(Step)]
    cells: Cells = [["scene", "variant", "seed", *names]]
    for record in records:
        which: list[str | float | int | None] = [record.scene, record.variant, record.seed]
        cells += [[*which, *(getattr(step, name) for name in names)] for step in record.steps]
    return cells


def _pictures(records: Sequence[Record], folder: Path) -> dict[str, bytes]:
    """Return the stored top views by caption; variants named after a preset come first."""
    found: dict[str, bytes] = {}
    ordered = sorted(records, key=lambda r: (r.variant != r.preset, r.scene, r.variant, r.seed))
    for record in ordered if (folder / PICTURES_FOLDER).is_dir() else ():
        path = picture_path(folder, record)
        if path.is_file():
            caption = f"{record.scene}, {record.variant}, seed {record.seed}: {record.stop}"
            found[caption] = path.read_bytes()
    return found
