import math
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from scan3d_twin.core.types import Pose2
from scan3d_twin.recording.colours import view_colour
from scan3d_twin.viz.top_view import draw_top_view

SVG = "{http://www.w3.org/2000/svg}"
VIEWPOINTS = (Pose2(0.0, 0.0, math.pi / 2), Pose2(0.5, 0.1, math.pi / 2), Pose2(1.0, 0.0, 2.0))


def draw(n=3000, viewpoints=VIEWPOINTS, title="boxes", seed=0, **more):
    """Return the top view of ``n`` random points."""
    rng = np.random.default_rng(seed)
    points = rng.uniform((-0.5, 0.9, 0.0), (1.5, 1.1, 0.7), size=(n, 3))
    view = rng.integers(len(viewpoints), size=n)
    options = {"sweep_width": math.radians(60), "standoff": 1.0, "title": title} | more
    return draw_top_view(points, view, viewpoints, **options)


def of_class(svg, name):
    """Return the elements of a class."""
    return [each for each in ET.fromstring(svg).iter() if each.get("class") == name]


def test_it_is_a_well_formed_picture_with_a_size_and_a_title():
    root = ET.fromstring(draw(title="a < b & c"))
    assert root.tag == SVG + "svg"
    left, top, width, height = map(float, root.get("viewBox").split())
    assert (left, top, width) == (0, 0, 900)
    assert 300 < height < 1400
    assert root.find(SVG + "title").text == "a < b & c"


def test_each_viewpoint_has_a_star_a_number_and_a_dashed_sector():
    svg = draw()
    assert len(of_class(svg, "star")) == len(of_class(svg, "sector")) == 3
    assert [each.text for each in of_class(svg, "label")][:3] == ["0", "1", "2"]
    assert "stroke-dasharray" in svg


def test_points_stars_and_sectors_of_a_view_share_its_colour():
    svg = draw()
    for index in range(3):
        assert of_class(svg, "star")[index].get("fill") == view_colour(index)
        assert of_class(svg, "sector")[index].get("stroke") == view_colour(index)
    dots = [each for each in ET.fromstring(svg).iter(SVG + "path") if each.get("stroke")]
    assert [each.get("stroke") for each in dots] == [view_colour(k) for k in range(3)]


def test_a_metre_is_as_long_upwards_as_sideways_and_y_points_up():
    stars = of_class(draw(viewpoints=(Pose2(), Pose2(1.0, 0.0, 0.0), Pose2(0.0, 1.0, 0.0))), "star")
    tips = [tuple(map(float, each.get("points").split()[0].split(","))) for each in stars]
    (x0, y0), (x1, y1), (x2, y2) = tips
    assert x1 - x0 == pytest.approx(y0 - y2, abs=0.2)
    assert x1 - x0 > 50
    assert (y1, x2) == pytest.approx((y0, x0), abs=0.1)


def test_a_million_points_stay_under_two_megabytes():
    assert 100_000 < len(draw(n=1_000_000)) < 2_000_000


def test_the_same_data_give_the_same_picture():
    assert draw() == draw()
    assert draw() != draw(seed=1)


def test_no_points_and_one_viewpoint_are_a_picture_too():
    assert len(of_class(draw(n=0, viewpoints=(Pose2(),)), "star")) == 1


def test_nothing_is_fetched_from_elsewhere():
    svg = draw().replace("http://www.w3.org/2000/svg", "")
    assert "http" not in svg
    assert "<script" not in svg


def test_it_has_a_dark_side():
    assert "prefers-color-scheme: dark" in draw()


def test_the_way_has_arrows_along_it_and_the_true_shape_is_behind_the_points():
    way = np.array([[0.0, 0.0], [0.5, 0.0], [1.0, 0.0]])
    truth = np.array([[x, y] for x in np.linspace(1.0, 1.3, 61) for y in np.linspace(0.0, 0.2, 41)])
    picture = draw(way=way, truth=truth)
    arrows = re.findall(
        r'class="arrow".*?translate\(([\d.]+) ([\d.]+)\) rotate\((-?\d+)\)', picture
    )
    assert len(arrows) >= 2
    assert {turn for _, _, turn in arrows} == {"0"}
    assert (
        picture.index('class="truth"')
        < picture.index('class="way"')
        < picture.index('class="star"')
    )
    without = draw()
    assert 'class="way"' not in without
    assert 'class="truth"' not in without
