"""From the Parquet file to the page: the numbers, the pictures, and what a browser says to them."""

from __future__ import annotations

import csv
import json
import math
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import pytest
from accessible import MAX_PAGE, SCHEMES, WIDTHS, find_violations, tab_stops

from scan3d_twin.bench.execute import picture_path
from scan3d_twin.bench.reporting.compare import compare_variants, compare_with_oracle, views_to
from scan3d_twin.bench.reporting.figures import draw_figures, draw_pareto
from scan3d_twin.bench.reporting.files import write_report
from scan3d_twin.bench.reporting.measures import MEASURES, format_table, summarise
from scan3d_twin.bench.reporting.plot import MAX_LINKED_DOTS, TOP
from scan3d_twin.bench.reporting.run_list import name_run, run_command
from scan3d_twin.bench.reporting.step_figures import steps_of
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
    kinds = ("pareto", "calibration", "overlap", "features", "lambda", "success")
    coverage = {f"coverage-{along}-{scene}" for along in ("views", "metres", "seconds")}
    assert names == {f"{kind}-{scene}" for kind in kinds} | coverage
    for name in names:
        root = ET.parse(report / "figures" / f"{name}.svg").getroot()
        assert root.tag.endswith("svg")
        numbers = list(csv.reader((report / "figures" / f"{name}.csv").read_text().splitlines()))
        assert len(numbers) > 1
        assert len({len(row) for row in numbers}) == 1


def test_the_pareto_figure_has_a_dot_a_run(records):
    (figure,) = [f for f in draw_figures(records) if f.kind == "pareto"]
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


@pytest.mark.parametrize("place", ["figures", "runs", "runs/{name}"])
def test_nothing_is_written_through_a_linked_folder(records, tmp_path, place):
    mine = tmp_path / "mine"
    mine.mkdir()
    link = tmp_path / "report" / place.format(name=name_run(records[0]))
    link.parent.mkdir(parents=True)
    link.symlink_to(mine)
    with pytest.raises(FileError, match=f"{link} is a link to another place"):
        write_report(records, "an example", tmp_path, tmp_path / "report")
    assert not list(mine.iterdir())


def test_the_page_asks_for_nothing_from_outside(report):
    text = (report / "report.html").read_text()
    assert not re.search(r"<script[^>]* src", text)
    addresses = set(re.findall(r'(?:src|href)="([^"]{0,200})', text))
    assert all(a.startswith(("data:", "figures/", "runs/", "#")) for a in addresses)
    for path in (a for a in addresses if a.startswith(("figures/", "runs/"))):
        assert (report / path).exists()
    ids = set(re.findall(r' id="([^"]+)"', text))
    assert {a[1:] for a in addresses if a.startswith("#")} <= ids


def test_each_dot_leads_to_its_run_and_its_files(report, records):
    text = (report / "report.html").read_text()
    for record in records:
        name = name_run(record)
        settings = report / "runs" / name / "settings.toml"
        assert settings.read_text() == record.settings
        assert json.loads((settings.parent / "record.json").read_text())["seed"] == record.seed
        assert run_command(record) in text
        assert text.count(f'href="#run-{name}"') >= (record.status != "lost")
    assert len({name_run(record) for record in records}) == len(records)


def test_the_names_of_runs_are_not_mixed_up(make):
    one, two = (
        replace(make(), scene=scene, variant=variant, key=key)
        for scene, variant, key in (("a-b", "c", "3f0a"), ("a", "b-c", "91c2"))
    )
    assert name_run(one) != name_run(two)


def test_many_dots_are_no_longer_links(make):
    many = [make("a", seed) for seed in range(MAX_LINKED_DOTS + 5)]
    figure = draw_pareto("scene", {"a": many}, {"a": "#000000"})
    assert figure.svg.count("<a href") == MAX_LINKED_DOTS
    assert figure.svg.count("<circle") == len(many)


def test_pictures_take_no_more_room_than_the_page_has(records, tmp_path):
    """Of three of 3 MB two fit, as text of 8 MB; the page says that one is left out."""
    for k, record in enumerate(records[:3]):
        path = picture_path(tmp_path, record)
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b"<svg xmlns='http://www.w3.org/2000/svg'>" + b" " * (3_000_000 + k))
    page = write_report(records, "large", tmp_path, tmp_path)
    assert page.stat().st_size < MAX_PAGE
    text = page.read_text()
    assert text.count("data:image/svg+xml") == 2
    assert "1 more in top_views/" in text


def test_figures_are_numbered_without_gaps(report, make, tmp_path):
    bare = write_report([make("a"), make("a", 1)], "no choice", tmp_path, tmp_path)
    for page, least in ((report / "report.html", 9), (bare, 5)):
        numbers = [int(n) for n in re.findall(r"<b>Figure (\d+)\.</b>", page.read_text())]
        assert numbers == list(range(1, len(numbers) + 1))
        assert len(numbers) >= least


def test_what_is_not_known_is_no_number(make, tmp_path):
    """A variant of one run, one without registrations, and steps without a spread."""
    few = [make("a"), make("b", errors=()), make("c", errors=(0.004,)), make("d", max_error=None)]
    page = write_report(few, "few", tmp_path, tmp_path)
    for path in (page, *tmp_path.glob("figures/*"), *tmp_path.glob("*.csv")):
        words = re.sub(r"<(style|script).*?</\1>", "", path.read_text(), flags=re.DOTALL)
        assert not re.search(r"\bnan\b", words, flags=re.IGNORECASE), path
    assert not re.search(r"<small>([^,<]+), \1\]?</small>", page.read_text())


@pytest.mark.parametrize(
    "kind", ["pareto", "coverage", "calibration", "overlap", "lambda", "success"]
)
def test_both_axes_of_a_figure_are_labelled(records, kind):
    for figure in (f for f in draw_figures(records) if f.kind == kind):
        root = ET.fromstring(figure.svg)
        texts = [e for e in root.iter("{http://www.w3.org/2000/svg}text") if not e.get("class")]
        turned = [e.text for e in texts if e.get("transform")]
        middle = [e.text for e in texts if e.get("text-anchor") == "middle"]
        assert len(turned) == 1
        assert len(middle) == 2
        assert all(middle)


def test_the_limit_is_drawn_where_it_is(make):
    """Epsilon is on the axis though every error is far below it."""
    (figure,) = [f for f in draw_figures([make("a", k, errors=(1e-4,)) for k in range(3)])
                 if f.kind == "pareto"]  # fmt: skip
    dots = [float(y) for y in re.findall(r'cy="([\d.]+)"', figure.svg)]
    (line,) = re.findall(r'class="limit" d="M[\d.]+ ([\d.]+)H', figure.svg)
    assert TOP < float(line) < min(dots)


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


@pytest.fixture
def shown(report, browser):
    """Open the page at a width and in a colour scheme."""
    pages = []

    def showing(width=1400, scheme="light"):
        """Return the open page."""
        pages.append(
            browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
        )
        pages[-1].goto((report / "report.html").as_uri())
        return pages[-1]

    yield showing
    for page in pages:
        page.close()


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("width", WIDTHS)
def test_the_page_is_accessible(shown, report, width, scheme):
    page = shown(width, scheme)
    assert find_violations(page) == []
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert (report / "report.html").stat().st_size < MAX_PAGE


def test_on_a_phone_no_table_is_cut(shown):
    hidden = "all => all.filter(e => e.scrollWidth > e.clientWidth).length"
    assert shown(390).eval_on_selector_all(".scroll", hidden) == 0


def test_the_index_leads_to_every_section(shown):
    page = shown()
    listed = page.eval_on_selector_all("nav a", "all => all.map(e => e.hash.slice(1))")
    assert listed == page.eval_on_selector_all("h2", "all => all.map(e => e.id)")
    assert len(listed) >= 8


@pytest.mark.parametrize("width", WIDTHS)
def test_tables_sort_by_any_column_and_keep_what_is_unknown_last(shown, width):
    page = shown(width)
    column = "all => all.map(row => row.cells[{}].innerText)"

    # Text, then numbers with units in both directions
    button = page.locator(".runs th button", has_text="Worst error")
    for state, sign in (("ascending", 1), ("descending", -1)):
        button.click()
        texts = page.eval_on_selector_all(".runs tbody tr", column.format(5))
        numbers = [float(text.removesuffix(" mm")) for text in texts if text != "\N{EN DASH}"]
        assert numbers == sorted(numbers, key=lambda value: sign * value)
        assert len(set(numbers)) > 1
        assert texts[-1] == "\N{EN DASH}"
        assert page.locator(".runs th[aria-sort]").get_attribute("aria-sort") == state
    page.locator(".runs th button", has_text="Variant").press("Enter")
    names = page.eval_on_selector_all(".runs tbody tr", column.format(2))
    assert names == sorted(names)
    assert page.locator(".runs th[aria-sort]").inner_text().startswith("Variant")


def test_a_dot_is_hit_beside_it_and_leads_to_its_run(shown):
    page = shown(390)
    dot = page.locator(".plot svg a").first
    dot.scroll_into_view_if_needed()
    box = dot.locator("circle").bounding_box()
    words, target = dot.locator("title").text_content(), dot.get_attribute("href")

    # A place 10 px off the middle belongs to it, as no other is nearer
    place = (box["x"] + box["width"] / 2 - 10, box["y"] + box["height"] / 2)
    page.mouse.move(*place)
    assert page.locator(".plot .pointed").first.inner_text() in words
    page.mouse.click(*place)
    page.wait_for_function("location.hash.startsWith('#run-')")
    page.wait_for_function("location.hash === '#' + document.activeElement.id")
    assert target.startswith("#run-")


def test_a_figure_is_one_stop_of_tab_and_arrows_go_from_dot_to_dot(shown):
    page = shown()
    figures = page.locator(".plot:has(svg a)").count()
    dots = page.locator(".plot svg a").count()
    stops = [stop for stop in tab_stops(page) if "seed" in stop]
    assert len(stops) == figures < dots
    first = page.locator(".plot svg a[tabindex='0']").first
    first.focus()
    before = page.evaluate("document.activeElement.outerHTML")
    page.keyboard.press("ArrowRight")
    second = page.evaluate("document.activeElement.textContent.trim()")
    assert page.evaluate("document.activeElement.outerHTML") != before
    assert page.locator(".plot .pointed").first.inner_text() == second
    page.keyboard.press("Enter")
    page.wait_for_function("document.activeElement.tagName === 'TR'")
    seed = page.evaluate("document.activeElement.cells[0].innerText")
    variant = page.evaluate("document.activeElement.cells[2].innerText")
    assert second.startswith(f"{variant}, seed {seed}:")
