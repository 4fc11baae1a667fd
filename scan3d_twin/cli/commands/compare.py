"""``twin compare``: several runs side by side."""

from __future__ import annotations

import json as json_module
import sys
from pathlib import Path

from scan3d_twin.cli.output import say


def compare(*runs: Path, out: Path = Path("compare.html"), json: bool = False) -> None:
    """Compare runs: options that differ, results, and how far the models are apart.

    Writes one page: a table of results, the options that differ, the models over each other in 3D
    coloured by run or by distance to the first one, both tops, and coverage over time. Each run has
    a frame of its own: the models are laid on the first one by registration.

    Args:
        runs: Folders of runs, or session files; the first one is the reference.
        out: The page to write.
        json: Print the comparison as JSON instead, and write no page.
    """
    from scan3d_twin.recording.overview.comparison import compare_runs, summarise

    compared = compare_runs(runs)
    if json:
        print(json_module.dumps(summarise(compared), indent=2, ensure_ascii=False))
        return
    from scan3d_twin.cli.summary import format_cell, format_table
    from scan3d_twin.run.folder import write_file
    from scan3d_twin.viz.pages.compare_page import render_compare_page

    write_file(out, render_compare_page(compared))
    header = ["views", "worst", "covered", "time", "apart"]
    rows = [
        [
            format_cell(each["views"], "{}"),
            format_cell(each["max_registration_error_mm"], "{:.1f} mm"),
            format_cell(each["coverage_20mm"], "{:.1%}"),
            format_cell(each["sim_time_s"], "{:.0f} s"),
            format_cell((each["distance_mm"] or {}).get("median"), "{:.1f} mm"),
            f" {each['name']}",
        ]
        for each in summarise(compared)["runs"]
    ]
    say("\n".join([*format_table(header, rows), str(out)]), sys.stdout)
