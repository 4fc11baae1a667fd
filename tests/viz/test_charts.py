import math
import xml.etree.ElementTree as ET

import pytest

from scan3d_twin.viz.pages.charts import Chart, Dot, render_chart, round_up


def chart(*dots, **options):
    """Return a chart of ``dots`` with fixed axes."""
    return Chart("t < u", "x [s]", "y", (0.0, 10.0), (0.0, 1.0), dots, **options)


@pytest.mark.parametrize(
    ("value", "rounded"), [(0.9, 1.0), (1.0, 1.0), (1.1, 2.0), (23, 25), (0.031, 0.04), (70, 100)]
)
def test_axes_end_at_round_values(value, rounded):
    assert round_up(value) == pytest.approx(rounded)


def test_nothing_to_show_has_an_axis_too():
    assert round_up(0.0) == round_up(math.nan) == 1.0


def test_it_is_well_formed_and_named():
    root = ET.fromstring(render_chart(chart(Dot(1, 0.5, "#123456", "a&b"))))
    assert root.find("title").text == "t < u"
    assert "a&b" in [each.text for each in root.iter("text")]


def test_dots_lie_where_their_values_are():
    drawn = chart(Dot(0, 0, "#000000"), Dot(10, 1, "#000000"))
    circles = [each for each in ET.fromstring(render_chart(drawn)).iter("circle")]
    places = [(float(each.get("cx")), float(each.get("cy"))) for each in circles]
    assert places == [(drawn.x(0), drawn.y(0)), (drawn.x(10), drawn.y(1))]
    assert drawn.x(5) == pytest.approx((drawn.x(0) + drawn.x(10)) / 2)
    assert drawn.y(0) > drawn.y(1)


def test_a_value_above_the_axis_is_an_arrow_and_an_unknown_one_is_nothing():
    root = ET.fromstring(
        render_chart(chart(Dot(1, math.inf, "#aa0000"), Dot(2, math.nan, "#bb0000")))
    )
    assert [each.get("fill") for each in root.iter("path") if each.get("fill")] == ["#aa0000"]
    assert list(root.iter("circle")) == []


def test_shares_are_written_in_per_cent():
    words = [each.text for each in ET.fromstring(render_chart(chart(percent="y"))).iter("text")]
    assert "20%" in words
    assert "2" in words
