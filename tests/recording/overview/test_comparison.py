"""Runs side by side, from the recordings of sessions without a simulator."""

import json
from dataclasses import replace

import numpy as np
import pytest
from accessible import MAX_PAGE, SCHEMES, WIDTHS, find_violations
from recorded import record

from scan3d_twin.core.types import Pose2
from scan3d_twin.recording.overview.comparison import compare_runs, find_differences, summarise
from scan3d_twin.viz.pages.compare_page import render_compare_page

TURNED = Pose2(0.12, -0.05, 0.08)


@pytest.fixture
def runs(session, tmp_path):
    """The folders of a run, and of the same run in a frame of its own and of another seed."""
    moved = [replace(view, T_world_scan=TURNED @ view.T_world_scan) for view in session.views]
    record(tmp_path / "one" / "run", session)
    record(tmp_path / "two" / "run", replace(session, views=tuple(moved)))
    return [tmp_path / "one" / "run", tmp_path / "two" / "run"]


def test_each_model_is_laid_on_the_first_one(runs):
    first, second = compare_runs(runs)
    assert [first.name, second.name] == ["one/run", "two/run"]
    T = second.T_first_own @ TURNED
    assert (T.x, T.y, T.yaw) == pytest.approx((0.0, 0.0, 0.0), abs=2e-3)
    assert second.in_both == pytest.approx(1.0, abs=0.01)
    assert second.apart.median < 0.005
    assert len(first.distances) == len(first.model)


def test_only_options_that_differ_are_named(runs):
    compared = compare_runs(runs)
    assert find_differences(compared) == {}
    other = replace(compared[1], options={**compared[1].options, "planning.epsilon": 0.005})
    assert find_differences([compared[0], other]) == {"planning.epsilon": [0.01, 0.005]}


def test_without_reports_the_models_are_compared_all_the_same(runs):
    compared = compare_runs(runs)
    told = json.loads(json.dumps(summarise(compared)))
    assert told["runs"][0]["coverage_20mm"] is None
    assert told["runs"][1]["distance_mm"]["median"] < 5.0
    page = render_compare_page(compared)
    assert "Share of the target&" not in page
    assert "outline in top view, as far as the robot knows it" in page


def test_models_that_do_not_fit_are_said_not_to(runs, session, tmp_path):
    flat = [replace(view, target=view.target.select(np.zeros(len(view.target), bool)))
            for view in session.views]  # fmt: skip
    record(tmp_path / "none", replace(session, views=tuple(flat)))
    compared = compare_runs([runs[0], tmp_path / "none"])
    assert [run.apart for run in compared] == [None, None]
    assert "do not fit on each other" in render_compare_page(compared)


def test_the_page_is_accessible(runs, tmp_path, browser):
    text = render_compare_page(compare_runs(runs))
    assert len(text.encode()) < MAX_PAGE
    (tmp_path / "compared.html").write_text(text, encoding="utf-8")
    for width in WIDTHS:
        for scheme in SCHEMES:
            page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
            said, asked = [], []
            page.on(
                "console", lambda m, said=said: said.append(m.text) if m.type == "error" else None
            )
            page.on("pageerror", lambda error, said=said: said.append(str(error)))
            page.on("request", lambda request, asked=asked: asked.append(request.url))
            page.goto((tmp_path / "compared.html").as_uri())
            page.wait_for_selector("#model.drawn")
            assert find_violations(page) == []
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            assert said == []
            assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []
            page.close()
