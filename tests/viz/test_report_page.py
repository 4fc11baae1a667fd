import json
import re
from dataclasses import replace

import numpy as np
import pytest
from pixels import share_of

from scan3d_twin.core.model.evaluation import Distances, Evaluation, PairError
from scan3d_twin.core.model.fused_cloud import Model, build_model
from scan3d_twin.recording.colours import view_colour
from scan3d_twin.run.report import Effort, Journey, build_report
from scan3d_twin.run.settings import Settings, settings_toml
from scan3d_twin.viz.report_page import Pictures, render_report_page
from scan3d_twin.viz.top_view import draw_top_view

EVALUATION = Evaluation(
    coverage=0.91,
    coverage_by_view=(0.4, 0.7, 0.91),
    accuracy=Distances(0.005, 0.004, 0.011),
    completeness=Distances(0.006, 0.005, 0.021),
    f_score={0.010: 0.7, 0.020: 0.9, 0.030: 0.95},
    coverable_share=0.61,
    pairs=(PairError(1, 0.0042, 0.0051, 0.0301), PairError(2, 0.0142, 0.0151, 0.0301)),
)
PNG = b"\x89PNG\r\n\x1a\n not a real picture"


def page_of(session, evaluation=EVALUATION, scene="no EGL here", model=None):
    """Return the page of ``session`` with a made-up journey and effort."""
    cloud = build_model(session)
    settings, effort = Settings(), Effort(4.0, 0.5, 2e8)
    journey = Journey(2.5, 3.1, 100.0)
    report = build_report("boxes", settings, session, journey, effort, len(cloud), evaluation)
    poses = [each.T_world_scan for each in session.views]
    drawing = draw_top_view(
        cloud.points, cloud.view, poses, sweep_width=1.05, standoff=1.0, title="boxes"
    )
    pictures = Pictures(drawing, scene)
    options = settings_toml(settings)
    return render_report_page(report, options, session, model or cloud, pictures, evaluation)


@pytest.fixture(scope="module")
def page(session):
    """The page of the session."""
    return page_of(session)


@pytest.fixture(scope="module")
def url(page, tmp_path_factory):
    """The address of the page as a file."""
    path = tmp_path_factory.mktemp("page") / "report.html"
    path.write_text(page, encoding="utf-8")
    return path.as_uri()


def test_it_names_no_other_place(page):
    assert not re.findall(r"""(?:src|href)=["'](?!data:)""", page)
    assert not re.findall(r"https?:", page)  # without the colon the letters may be a picture's
    assert "@import" not in page


def test_it_is_small_and_the_same_for_the_same_run(page, session):
    assert 50_000 < len(page) < 10_000_000
    assert page == page_of(session)


def test_a_million_points_still_make_a_page_under_ten_megabytes(session):
    rng = np.random.default_rng(0)
    points, normals = rng.normal(size=(2, 1_000_000, 3))
    view = rng.integers(3, size=len(points))
    many = Model(points, normals, np.full(len(points), 0.005), view)
    assert 3_000_000 < len(page_of(session, model=many)) < 10_000_000


def test_the_table_tells_of_each_view_and_marks_what_is_worse_than_wanted(page):
    rows = re.findall(r"<tr><td>.*?</tr>", page)
    assert len(rows) == 3
    assert "4.2 mm" in rows[1]
    assert '<td class="over">14.2 mm</td>' in rows[2]
    assert "above epsilon" in rows[2]
    assert re.search(r"\d+\.\d mm, \d\.\d\d°", rows[1])


def test_each_step_has_its_curve_with_the_chosen_overlap_filled(page):
    charts = re.findall(r"<h3>(View .*?)</h3>(.*?)</svg>", page)
    assert [title for title, _ in charts] == ["View 0 to 1: 60%", "View 1 to 2: 80% (above ε)"]
    first, second = (svg for _, svg in charts)
    assert first.count("<circle") == 3
    assert first.count('r="4.5"') == 1
    assert "overlap 60%: 8.0 mm" in first
    assert second.count("h10l-5") == 2  # infinite and 90 mm: arrows at the upper edge
    assert "no registration" in second


def test_coverage_is_the_evaluations_or_else_what_the_robot_knows(page, session):
    assert "after view 1: 70.0%" in page
    blind = page_of(session, evaluation=None)
    assert "as far as the robot knows it" in blind
    assert "Realised error" not in blind


def test_warnings_are_said_in_words(page):
    assert "Before you trust this model" in page
    assert "View 2: registered 14.2 mm off its predecessor" in page
    assert "View 2: no viewpoint was predicted to meet 10 mm (best 15.0 mm)" in page


def test_the_scene_is_shown_or_the_reason_why_not(page, session):
    assert "No picture of the scene: no EGL here." in page
    assert "The scene with the robot at its start" in page_of(session, scene=PNG)
    assert "<h2>Scene" not in page_of(session, scene="")


def test_what_users_name_is_no_markup(session):
    page = page_of(session.with_stop_reason("<script>alert(1)</script>"))
    assert "<script>alert" not in page.casefold()


def test_a_run_of_no_target_points_has_a_page_too(session):
    nothing = session.views[0].target.select(session.views[0].target.lines < 0)
    empty = replace(session, views=(replace(session.views[0], target=nothing),))
    assert "there is no model" in page_of(empty, evaluation=None)


def test_the_model_is_drawn_in_the_colours_of_its_views_without_asking_others(open_page, url):
    shown = open_page(url)
    model = shown.page.locator("#model")
    assert model.get_attribute("class") == "frame drawn"
    assert shown.page.locator("#model canvas").is_visible()
    picture = model.screenshot()
    assert all(share_of(picture, view_colour(k)) > 0.005 for k in range(3))
    assert (shown.errors, shown.asked) == ([], [])


def test_its_buttons_work(open_page, url):
    shown = open_page(url)
    page, model = shown.page, shown.page.locator("#model")
    before = model.screenshot()
    page.locator("#controls input[data-view='0']").uncheck()
    page.wait_for_timeout(100)
    without = model.screenshot()
    assert share_of(without, view_colour(0)) < 0.3 * share_of(before, view_colour(0))
    page.locator("#upto").fill("1")
    page.wait_for_timeout(100)
    assert page.locator("#shown").inner_text() == "2 of 3"
    assert share_of(model.screenshot(), view_colour(2)) < 0.001
    page.locator("#colouring").select_option("height")
    page.locator("#around").check()
    page.locator("#model canvas").drag_to(model, source_position={"x": 300, "y": 200})
    page.locator("#reset").click()
    assert shown.errors == []


@pytest.mark.parametrize("width", [360, 1280])
def test_nothing_is_wider_than_the_screen(open_page, url, width):
    page = open_page(url, width=width).page
    assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_it_is_dark_where_the_reader_wants_it(open_page, url):
    dark = open_page(url, color_scheme="dark").page
    assert dark.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(13, 17, 23)"


def test_in_print_the_model_is_a_still_picture(open_page, url):
    page = open_page(url, width=760).page
    page.emulate_media(media="print")
    assert page.locator("#model img").is_visible()
    assert not page.locator("#model canvas").is_visible()
    assert not page.locator("#controls").is_visible()
    picture = page.locator("#model").screenshot()
    assert all(share_of(picture, view_colour(k)) > 0.005 for k in range(3))
    assert page.evaluate("document.documentElement.scrollWidth") <= 760


def test_without_webgl_the_still_picture_stays(open_page, url, browser):
    context = browser.new_context()
    page = context.new_page()
    page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    page.goto(url)
    assert page.locator("#model img").is_visible()
    assert not page.locator("#controls").is_visible()
    context.close()


def test_what_the_script_reads_is_json(page):
    meta = json.loads(re.search(r'id="meta">(.*?)</script>', page)[1])
    assert len(meta["colours"]) == len(meta["ranges"]) - 1 == 3
    firsts = [first for first, _ in meta["ranges"]]
    assert firsts == sorted(firsts)
