import json
import re
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from accessible import MAX_PAGE, SCHEMES, WIDTHS, find_violations
from pixels import share_of

from scan3d_twin.core.model.evaluation import Comparison, Distances, Evaluation
from scan3d_twin.core.model.fused_cloud import Model, build_model, build_view_clouds
from scan3d_twin.core.model.mesh import build_mesh
from scan3d_twin.core.model.pose_errors import PairError
from scan3d_twin.recording.colours import view_colour
from scan3d_twin.run.report import Effort, Journey, build_report
from scan3d_twin.run.settings import Settings, settings_toml
from scan3d_twin.viz.pages.model_section import MISSING
from scan3d_twin.viz.pages.packing import show_run
from scan3d_twin.viz.pages.report_page import Pictures, render_report_page
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
PLACES = """() => {
  const meta = JSON.parse(document.getElementById("meta").textContent);
  const text = atob(document.getElementById("cloud").textContent.trim());
  const bytes = Uint8Array.from(text, (letter) => letter.charCodeAt(0));
  const camera = makeCamera(meta.camera, document.querySelector("#model canvas"));
  return [0, 2].map((view) => {
    const places = placesOf(meta, bytes, meta.ranges.views[view]);
    const middle = 3 * (places.length >> 3);
    return camera.project([...places.slice(middle, middle + 3)]).slice(0, 2);
  });
}"""
"""Places on the canvas of a point of the first and of the last view."""
PNG = b"\x89PNG\r\n\x1a\n not a real picture"


def compared_with_itself(model):
    """Return a comparison by which the model is off by 0 to 20 mm, and its left end is missing."""
    distances = np.linspace(0.0, 0.02, len(model))
    left = model.points[model.points[:, 1] > 0.9] + [0.0, 0.3, 0.0]
    return Comparison(distances, np.zeros(0), model.points, left)


def cloud_box(points):
    """Return the corners of the box around ``points`` (n, 3)."""
    return [points.min(axis=0), points.max(axis=0)]


def page_of(session, evaluation=EVALUATION, scene=b"", model=None):
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
    cloud = model or cloud
    mesh = build_mesh(session, build_view_clouds(session))
    shown = show_run(session, cloud, mesh, compared_with_itself(cloud) if evaluation else None)
    return render_report_page(report, options, session, shown, pictures, evaluation)


def settle(page):
    """Wait until ``page`` has drawn what was asked of it."""
    page.evaluate(
        "() => new Promise((go) => requestAnimationFrame(() => requestAnimationFrame(go)))"
    )


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
    rows = re.findall(r"<tr><td.*?</tr>", page)
    assert len(rows) == 3
    assert "4.2 mm" in rows[1]
    assert ' class="over">14.2 mm</td>' in rows[2]
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


def test_the_scene_is_shown_where_it_is_not_a_real_one(page, session):
    assert "The scene with the robot at its start" in page_of(session, scene=PNG)
    assert "<h2>Scene" not in page


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
    settle(page)
    without = model.screenshot()
    assert share_of(without, view_colour(0)) < 0.3 * share_of(before, view_colour(0))
    page.locator("#upto").fill("1")
    settle(page)
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
    assert len(meta["colours"]) == len(meta["ranges"]["views"]) == 3
    firsts = [first for first, _ in meta["ranges"]["views"]]
    assert firsts == sorted(firsts)
    assert json.loads(re.search(r'id="report">(.*?)</script>', page, re.S)[1])["scene"] == "boxes"


def test_points_are_coloured_by_what_is_known_of_them(open_page, url):
    shown = open_page(url)
    names = shown.page.locator("#colouring option").all_inner_texts()
    assert names == [
        "view", "height", "views that saw it", "expected error", "distance to the truth"
    ]  # fmt: skip
    shown.page.locator("#colouring").select_option("distance to the truth")
    settle(shown.page)
    legend = shown.page.locator("#legend")
    assert legend.inner_text().split() == ["0", "20", "mm"]
    assert share_of(shown.page.locator("#model").screenshot(), "#fac738") > 0.002


def test_what_is_missing_is_shown_where_the_truth_is_known(open_page, url, session, tmp_path):
    shown = open_page(url).page
    assert share_of(shown.locator("#model").screenshot(), MISSING) < 0.0005
    shown.locator("#missing").check()
    settle(shown)
    assert share_of(shown.locator("#model").screenshot(), MISSING) > 0.002
    real = tmp_path / "real.html"
    real.write_text(page_of(session, evaluation=None), encoding="utf-8")
    assert open_page(real.as_uri()).page.locator("#missing").count() == 0


def test_the_surface_stands_beside_the_points(open_page, url):
    page = open_page(url).page
    page.locator("#points").uncheck()
    page.locator("#mesh").check()
    settle(page)
    picture = page.locator("#model").screenshot()
    assert all(share_of(picture, view_colour(k)) < 0.003 for k in range(3))
    page.locator("#axis").select_option("z")
    page.locator("#cut").fill("0.0")
    settle(page)
    assert page.locator("#model").screenshot() != picture


def test_a_distance_is_measured_between_two_points(open_page, url):
    page = open_page(url).page
    page.locator("#measure").click()
    seen = page.evaluate(PLACES)
    for column, row in seen:
        page.locator("#model canvas").click(position={"x": column, "y": row})
    settle(page)
    words = page.locator("#distance").inner_text()
    assert re.fullmatch(r"[\d.]+ m?m \(x [\d.]+ m?m, y [\d.]+ m?m, z [\d.]+ m?m\)", words)
    page.locator("#measure").click()
    settle(page)
    assert not page.locator("#distance").is_visible()


def test_the_still_picture_returns_when_the_drawing_is_lost_and_the_drawing_when_it_is_back(
    open_page, url
):
    shown = open_page(url)
    page, model = shown.page, shown.page.locator("#model")
    page.evaluate(
        "window.loss = document.querySelector('#model canvas').getContext('webgl')"
        ".getExtension('WEBGL_lose_context'); loss.loseContext()"
    )
    page.wait_for_function("!document.querySelector('#model').classList.contains('drawn')")
    assert model.locator("img").is_visible()
    assert not page.locator("#controls").is_visible()
    page.evaluate("loss.restoreContext()")
    page.wait_for_function("document.querySelector('#model').classList.contains('drawn')")
    settle(page)
    assert all(share_of(model.screenshot(), view_colour(k)) > 0.005 for k in range(3))


def test_the_page_gives_back_the_files(open_page, url, session):
    page = open_page(url).page
    saved = {}
    for kind in ("ply", "glb", "json", "svg"):
        with page.expect_download() as download:
            page.locator(f"button[data-file={kind}]").click()
        saved[kind] = download.value.path()
        assert download.value.suggested_filename.endswith(f".{kind}")
    cloud, mesh = build_model(session), build_mesh(session, build_view_clouds(session))
    points = trimesh.load(saved["ply"], file_type="ply").vertices
    assert np.allclose([points.min(axis=0), points.max(axis=0)], cloud_box(cloud.points), atol=1e-4)
    surface = trimesh.load(saved["glb"], file_type="glb").to_geometry()
    assert surface.area == pytest.approx(mesh.areas.sum(), rel=0.15)
    assert json.loads(saved["json"].read_text())["views"] == 3
    assert "</svg>" in saved["svg"].read_text(encoding="utf-8")


def test_the_e57_file_of_the_page_holds_its_points(open_page, url, session):
    """libE57 checks the sum of each page of the file, and reads its records."""
    pye57 = pytest.importorskip("pye57")
    page, saved = open_page(url).page, []
    for kind in ("e57", "e57", "ply"):
        with page.expect_download() as download:
            page.locator(f"button[data-file={kind}]").click()
        saved.append(download.value.path())
    wanted = trimesh.load(saved[2], file_type="ply")
    file = pye57.E57(str(saved[0]))
    header = file.get_header(0)
    found = file.read_scan(0, colors=True, ignore_missing_fields=True)
    points = np.column_stack([found[f"cartesian{axis}"] for axis in "XYZ"])
    colours = np.column_stack([found[f"color{name}"] for name in ("Red", "Green", "Blue")])
    assert file.scan_count == 1
    assert len(points) == header.point_count > 4000  # more than a packet holds
    assert np.array_equal(points, wanted.vertices.astype(np.float32))
    assert np.array_equal(colours, wanted.colors[:, :3])
    bounds = [getattr(header, f"{axis}{end}imum") for end in ("Min", "Max") for axis in "xyz"]
    assert bounds == [*points.min(axis=0), *points.max(axis=0)]
    assert saved[0].read_bytes() == saved[1].read_bytes()


def test_the_table_folds_on_a_phone(open_page, url):
    page = open_page(url, width=390).page
    assert not page.locator("thead").is_visible()
    cells = page.locator("tbody tr:nth-child(2) td:not(:empty)")
    lefts = {round(cell.bounding_box()["x"]) for cell in cells.all()}
    assert len(lefts) == 1
    name = "getComputedStyle(document.querySelector('td:nth-child(4)'), '::before').content"
    assert page.evaluate(name) == '"Predicted error"'


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("width", WIDTHS)
def test_the_page_is_accessible(open_page, url, page, width, scheme):
    watched = open_page(url, width=width, color_scheme=scheme)
    settle(watched.page)
    assert find_violations(watched.page) == []
    assert (watched.errors, watched.asked) == ([], [])
    assert len(page.encode()) < MAX_PAGE


def test_every_control_is_reached_by_the_keyboard(open_page, url):
    page = open_page(url).page
    settle(page)
    wanted = page.eval_on_selector_all(
        "button, select, input, summary, canvas",
        "all => all.filter(e => e.checkVisibility() && !e.disabled).length",
    )
    reached = set()
    for _ in range(2 * wanted):
        page.keyboard.press("Tab")
        reached.add(page.evaluate(
            "() => [...document.querySelectorAll('button, select, input, summary, canvas')]"
            ".indexOf(document.activeElement)"
        ))  # fmt: skip
    assert len(reached - {-1}) == wanted > 10


def test_in_print_nothing_lies_on_the_still_picture(open_page, url):
    page = open_page(url).page
    page.select_option("#colouring", "height")
    settle(page)
    assert page.locator("#model .scale").is_visible()
    assert page.locator("#model .legend").is_visible()
    page.emulate_media(media="print")
    for name in (".scale", ".legend", ".distance", "canvas"):
        assert not page.locator(f"#model {name}").is_visible()


def test_on_a_phone_the_colour_of_a_view_stands_at_its_number(open_page, url):
    page = open_page(url, width=390).page
    cell = page.locator("tbody tr:nth-child(2) td:first-child")
    swatch, whole = cell.locator(".swatch").bounding_box(), cell.bounding_box()
    assert swatch["x"] > whole["x"] + 0.8 * whole["width"]


def test_on_a_phone_the_numbers_of_a_chart_can_be_read(open_page, url):
    page = open_page(url, width=390).page
    boxes = """all => all.map((each) => {
      const box = each.getBoundingClientRect();
      return [box.x, box.right, box.height];
    })"""
    ticks = page.eval_on_selector_all(".wide .chart .tick[text-anchor=end]", boxes)
    (label,) = page.eval_on_selector_all(".wide .chart text[transform]", boxes)
    (chart,) = page.eval_on_selector_all(".wide .chart", boxes)
    assert min(height for _, _, height in ticks) > 10
    assert chart[0] <= label[0]
    assert label[1] <= min(left for left, _, _ in ticks)
