"""From the Parquet file to the page: the numbers, the pictures, and what a browser says to them."""

from __future__ import annotations

import csv
import math
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import pytest

from scan3d_twin.bench.reporting.compare import compare_variants, compare_with_oracle, views_to
from scan3d_twin.bench.reporting.figures import draw_figures, steps_of
from scan3d_twin.bench.reporting.files import write_report
from scan3d_twin.bench.reporting.measures import MEASURES, format_table, summarise
from scan3d_twin.bench.store import RESULTS_FILE, read_results, write_parquet
from scan3d_twin.core.errors import FileError


@pytest.fixture(scope="module")
def records(make):
    """Three variants on twelve seeds; `b` is worse than `a`, `o` is an oracle."""
    good = [make("a", seed) for seed in range(12)]
    bad = [
        make("b", seed, errors=(0.004, 0.030 if seed % 3 else 0.009, 0.005), max_error=0.03)
        for seed in range(12)
    ]
    oracle = [
        make("o", seed, errors=(0.004,), planner="oracle", lambda_=0.05) for seed in range(12)
    ]
    lost = replace(make("b", 12), status="lost")
    return [*good, *bad, *oracle, lost, replace(make("a", 12, lambda_=0.1), variant="a-far")]


@pytest.fixture(scope="module")
def report(records, tmp_path_factory) -> Path:
    """The folder of a written report."""
    folder = tmp_path_factory.mktemp("report")
    write_parquet(records, folder / RESULTS_FILE)
    write_report(read_results(folder), "an example", folder, folder / "report")
    return folder / "report"


def test_parquet_gives_the_records_back(records, tmp_path):
    write_parquet(records, tmp_path / RESULTS_FILE)
    assert read_results(tmp_path / RESULTS_FILE) == records
    assert not list(tmp_path.glob("*.part"))


def test_records_without_a_view_or_a_number_come_back_too(make, tmp_path):
    bare = [replace(make("a", seed), steps=(), max_error=None, path=None) for seed in range(2)]
    write_parquet(bare, tmp_path / RESULTS_FILE)
    assert read_results(tmp_path) == bare


def test_what_holds_no_results_is_told(tmp_path):
    (tmp_path / "text.parquet").write_text("no")
    for path, words in (
        (tmp_path / "text.parquet", "holds no results"),
        (tmp_path, "no file or folder"),
        (tmp_path / "missing", "no file or folder"),
    ):
        with pytest.raises(FileError, match=words):
            read_results(path)


def test_the_table_has_a_row_per_scene_and_variant(records):
    rows = {row.variant: row for row in summarise(records)}
    assert set(rows) == {"a", "a-far", "b", "o"}
    assert (rows["a"].runs, rows["b"].runs, rows["b"].lost) == (12, 13, 1)
    found = rows["b"].figures
    assert found["success"].value == pytest.approx(4 / 12)
    assert found["success"].n == 12
    assert found["violations"].value == pytest.approx(8 / 36)
    assert found["views"].value == 4
    assert found["max_error_mm"].value == 30
    assert found["calibration"].value == pytest.approx(2.0)
    assert found["plan_ms"].value == pytest.approx(20.0)
    assert len(format_table(list(rows.values()))[1]) == 3 + len(MEASURES)


def test_variants_are_compared_on_equal_seeds_with_the_best(records):
    found = {c.variant: c for c in compare_variants(records)}
    assert {c.reference for c in found.values()} == {"a"}
    assert {name: c.pairs for name, c in found.items()} == {"a-far": 0, "b": 12, "o": 12}
    c = found["b"]
    assert c.success == pytest.approx(-8 / 12)
    assert c.success_p == pytest.approx(2 * 0.5**8)
    assert c.views.value == pytest.approx(4 / 3)
    assert c.views_p < 0.01
    assert c.time.value == 1.0


def test_scopes_are_not_mixed(make):
    mixed = [make("a", k, scope="sweep") for k in range(3)] + [make("b", k) for k in range(3)]
    assert compare_variants(mixed) == []


def test_regret_is_at_equal_coverage(make):
    run, oracle = (
        make("a", coverage=0.9),
        make("o", errors=(0.004,), coverage=0.6, planner="oracle"),
    )
    assert [views_to(run, c) for c in (0.3, 0.6, 0.9, 0.95)] == [1, 2, 3, None]
    (found,) = compare_with_oracle([run, oracle])
    assert (found.variant, found.oracle, found.regret.value) == ("a", "o", 1.0)
    slow = replace(
        run, steps=tuple(replace(s, coverage=round(0.3 * (s.view // 2 + 1), 6)) for s in run.steps)
    )
    (found,) = compare_with_oracle([slow, oracle])
    assert found.regret.value == pytest.approx(3 / 2)


def test_a_run_that_saw_nothing_has_no_regret(make):
    blind = make("a", coverage=0.0, errors=())
    (found,) = compare_with_oracle([blind, make("o", planner="oracle")])
    assert found.regret.n == 0


def test_steps_know_their_length_and_the_features_before_them(make):
    rows = steps_of(make(errors=(0.004, 0.008)))
    assert [row[0] for row in rows] == pytest.approx([0.0, math.hypot(0.1, 0.5)])
    assert [row[2:] for row in rows] == [
        (pytest.approx(0.3), pytest.approx(0.05)),
        (pytest.approx(0.4), pytest.approx(0.10)),
    ]


def test_all_figures_are_there_with_their_numbers(report, records):
    names = {figure.name for figure in draw_figures(records)}
    scene = "shiny_cylinder"
    kinds = ("F2", "F3", "F4", "F5a", "F5b", "F6", "F7")
    for kind in kinds:
        assert any(name.startswith(f"{kind}-{scene}") for name in names), kind
    for name in names:
        root = ET.parse(report / "figures" / f"{name}.svg").getroot()
        assert root.tag.endswith("svg")
        numbers = list(csv.reader((report / "figures" / f"{name}.csv").read_text().splitlines()))
        assert len(numbers) > 1
        assert len({len(row) for row in numbers}) == 1


def test_the_pareto_figure_has_a_dot_a_run(records):
    (figure,) = [f for f in draw_figures(records) if f.name.startswith("F2")]
    shown = [record for record in records if record.status != "lost"]
    assert figure.svg.count("<circle") == len(shown) == len(figure.rows) - 1


def test_each_view_is_a_row_of_the_steps(report, records):
    rows = list(csv.DictReader((report / "steps.csv").read_text().splitlines()))
    assert len(rows) == sum(len(record.steps) for record in records)
    assert {row["error"] for row in rows if row["view"] == "0"} == {""}


def test_the_same_records_give_the_same_bytes(report, records, tmp_path):
    write_report(records, "an example", tmp_path, tmp_path)
    for path in report.rglob("*"):
        if path.is_file():
            assert path.read_bytes() == (tmp_path / path.relative_to(report)).read_bytes(), path


def test_the_page_asks_for_nothing_from_outside(report):
    text = (report / "report.html").read_text()
    assert "<script" not in text
    addresses = set(re.findall(r'(?:src|href)="([^"]{0,40})', text))
    assert all(a.startswith(("data:", "figures/")) for a in addresses)
    for path in (a for a in addresses if a.startswith("figures/")):
        assert (report / path).is_file()


def test_a_browser_shows_the_page_without_a_word(report, browser):
    page = browser.new_page(viewport={"width": 1200, "height": 900})
    said, asked = [], []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto((report / "report.html").as_uri())
    widths = page.eval_on_selector_all("figure svg", "all => all.map(e => e.clientWidth)")
    over = page.evaluate("document.documentElement.scrollWidth - window.innerWidth")
    page.close()
    assert said == []
    assert [url for url in asked if not url.startswith(("file:", "data:"))] == []
    assert widths
    assert min(widths) > 250
    assert over <= 0
