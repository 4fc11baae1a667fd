from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pixels import SMALL, drawn, pixels, until

from scan3d_twin.viz.served.server import LOOPBACK, open_server
from scan3d_twin.viz.served.session_view import SessionView
from scan3d_twin.viz.served.stage import Stage, _back_off
from scan3d_twin.viz.view_errors import format_view_errors, list_view_errors


def test_a_page_that_comes_while_the_camera_is_aimed_looks_at_the_target(session, open_page):
    with open_server(LOOPBACK, 0, "boxes") as (server, address):
        SessionView(server, "boxes", session)
        aimed = server.initial_camera.look_at
        server.initial_camera.look_at = (0.0, 0.0, 9.0)  # what the page begins with
        shown = open_page(address, **SMALL)
        shown.page.get_by_text("view 2 (3 of 3 views)").wait_for()
        assert drawn(shown.page, {0, 1, 2}) == {0, 1, 2}
        (client,) = server.get_clients().values()
        np.testing.assert_allclose(client.camera.look_at, aimed, atol=1e-3)


def test_a_session_is_shown_by_view_back_and_forth_light_and_dark(session, open_page):
    with open_server(LOOPBACK, 0, "boxes") as (server, address):
        SessionView(server, "boxes", session)
        shown = open_page(address, **SMALL)
        page = shown.page
        page.get_by_text("view 2 (3 of 3 views)").wait_for()
        assert drawn(page, {0, 1, 2}) == {0, 1, 2}

        page.get_by_role("slider").first.focus()
        page.keyboard.press("ArrowLeft")
        page.get_by_text("view 1 (2 of 3 views)").wait_for()
        page.get_by_text("15.0 mm").first.wait_for()  # what its plan predicted
        assert drawn(page, {0, 1}) == {0, 1}

        page.get_by_role("checkbox").nth(1).check(force=True)
        dark = "document.querySelector('[data-mantine-color-scheme=dark]') !== null"
        page.wait_for_function(dark)
        assert (shown.errors, shown.asked) == ([], [])


@pytest.fixture(scope="module")
def moved(session):
    """The session with stamps one after another, and the odometry of a straight way."""
    views = []
    for k, view in enumerate(session.views):
        image = view.observation.image
        stamps = 100.0 * k + 50.0 + 0.1 * np.arange(len(image.stamps))
        observation = replace(view.observation, image=replace(image, stamps=stamps))
        views.append(replace(view, observation=observation))
    stamps = np.arange(0.0, 320.0, 0.5)
    track = np.stack([stamps, -1.0 + stamps / 320, 0 * stamps, 0 * stamps], axis=1)
    return replace(session, views=tuple(views)), track


def shown_points(server, name):
    """Return the points of the cloud ``name``; none if it is not shown."""
    handle = server.scene.get_handle_by_name(name)
    return np.zeros((0, 3)) if handle is None or not handle.visible else handle.points


def test_the_time_slider_goes_through_the_lines_of_a_sweep(moved):
    session, track = moved
    with open_server(LOOPBACK, 0, "boxes") as (server, _):
        view = SessionView(server, "boxes", session, track=track)
        stamps, target = session.views[1].observation.image.stamps, session.views[1].target

        # Half of view 1, and its place on the slider of the views
        view._time.value = float(stamps[len(stamps) // 2])
        read = target.points[target.lines <= len(stamps) // 2]
        np.testing.assert_allclose(shown_points(server, "/sweep/target"), read, atol=1e-6)
        assert len(read) not in (0, len(target.points))
        assert view._views.value == 1
        shown = [len(shown_points(server, f"/views/00{k}/target")) > 0 for k in range(3)]
        assert [server.scene.get_handle_by_name(f"/views/00{k}").visible for k in range(3)] == [
            True, False, False,
        ]  # fmt: skip
        assert shown[0]

        # Between the views: the robot on its way, nothing of a sweep
        view._time.value = 149.0
        assert len(shown_points(server, "/sweep/target")) == 0
        expected = view._timeline.pose_at(149.0)
        assert server.scene.get_handle_by_name("/robot").position[0] == pytest.approx(expected.x)
        path = server.scene.get_handle_by_name("/path").points
        assert path[-1, 1, :2] == pytest.approx((expected.x, expected.y), abs=1e-3)

        # Before all views, and back to the end
        view._time.value = 0.0
        assert "no view (0 of 3 views)" in view._words.content
        view._views.value = 3
        assert view._time.value >= view._timeline.end
        assert "front complete" in view._words.content


def test_the_lines_of_a_panorama_are_shown_as_they_were_read(moved):
    session, track = moved
    observation = session.views[0].observation  # a sweep will do
    stamps = 0.1 * np.arange(len(observation.image.stamps))
    early = replace(observation, image=replace(observation.image, stamps=stamps))
    with_panorama = replace(session, panoramas=((0, early),))
    with open_server(LOOPBACK, 0, "boxes") as (server, _):
        view = SessionView(server, "boxes", with_panorama, track=track)
        counts = []
        for time in (stamps[40], stamps[90], stamps[-1] + 1.0):
            view._time.value = float(time)
            counts.append(len(shown_points(server, "/sweep/background")))
        assert 0 < counts[0] < counts[1]
        assert counts[2] == 0


def test_a_view_whose_target_has_grown_shows_more_of_it(session):
    grown = session.views[0]
    small = replace(grown, target=grown.target.select(grown.target.lines < 40))
    with open_server(LOOPBACK, 0, "boxes") as (server, _):
        stage = Stage(server)
        stage.show_views(replace(session, views=(small, *session.views[1:])))
        stage.show_background(False)
        before = len(shown_points(server, "/views/000/target"))
        stage.show_views(session)
        assert 0 < before < len(shown_points(server, "/views/000/target"))
        assert len(shown_points(server, "/views/000/background")) == 0


def test_the_points_are_coloured_by_height(session):
    with open_server(LOOPBACK, 0, "boxes") as (server, _):
        stage = Stage(server)
        stage.show_views(session)
        stage.set_colouring("height")
        handle = server.scene.get_handle_by_name("/views/000/target")
        heights, colours = handle.points[:, 2], handle.colors
        low, high = colours[np.argmin(heights)], colours[np.argmax(heights)]
        assert low[2] > low[0]
        assert high[0] > high[2]  # from blue to yellow
        stage.set_colouring("view")
        assert server.scene.get_handle_by_name("/views/000/target").colors.shape == (3,)


def test_predicted_errors_stand_beside_the_realised_ones(session):
    errors = list_view_errors(session, {2: 17.5})
    assert [each.view for each in errors] == [1, 2]
    assert format_view_errors(errors, 0.010).splitlines()[2:] == [
        "| 1 | 8.0 mm | unknown |",
        "| 2 | **15.0 mm** | **17.5 mm** |",
    ]
    unknown = format_view_errors(list_view_errors(session, {}), 0.010)
    assert "realised" not in unknown
    assert format_view_errors((), 0.010) == ""


def test_a_window_higher_than_wide_looks_from_farther_away():
    class Window:
        fov, aspect = np.radians(60.0), 0.46

    wide, high = Window(), Window()
    wide.aspect = 1.6
    assert _back_off(wide) == 1.0
    half = np.arctan(np.tan(high.fov / 2) * high.aspect)  # what it sees to either side
    reach = _back_off(high) * np.tan(half)
    assert reach == pytest.approx(np.tan(np.radians(17.5)) * 1200 / 720)


def test_a_recording_plays_fits_and_is_saved_as_a_picture(moved, open_page):
    session, track = moved
    triangle = np.array([[[0.5, -1.0, 0.0], [0.5, 1.0, 0.0], [0.5, 0.0, 1.0]]])
    with open_server(LOOPBACK, 0, "boxes - scan3d_twin") as (server, address):
        view = SessionView(server, "boxes", session, track=track, truth=lambda: triangle)
        shown = open_page(address, **SMALL)
        page = shown.page
        page.get_by_role("status").get_by_text("finished").wait_for()
        assert page.title() == "boxes - scan3d_twin"

        # The true surface
        assert server.scene.get_handle_by_name("/truth") is None
        page.get_by_role("checkbox").nth(3).check(force=True)
        assert until(page, lambda: server.scene.get_handle_by_name("/truth") is not None)
        assert len(server.scene.get_handle_by_name("/truth").vertices) == 3

        # The camera
        (client,) = server.get_clients().values()
        before, middle = client.camera.position, client.camera.look_at
        client.camera.position = before + 1.0
        page.get_by_role("button", name="Fit to target").click()
        assert until(page, lambda: np.allclose(client.camera.position, before, atol=1e-3))
        assert until(page, lambda: np.allclose(client.camera.look_at, middle, atol=1e-3))

        # A picture
        with page.expect_download() as download:
            page.get_by_role("button", name="Screenshot").click()
        picture = pixels(Path(download.value.path()).read_bytes())
        assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 10

        # From the beginning to the first view, and no further once paused
        page.get_by_role("combobox", name="Speed").click()
        page.get_by_role("option", name="30x").click()
        page.get_by_role("button", name="Play").click()
        page.get_by_text("no view (0 of 3 views)").wait_for()
        page.get_by_text("view 0 (1 of 3 views)").wait_for()
        page.get_by_role("button", name="Pause").click()
        page.get_by_role("button", name="Play").wait_for()
        stopped = view._time.value
        assert stopped < view._timeline.end
        page.wait_for_timeout(300)
        assert view._time.value == stopped
        assert (shown.errors, shown.asked) == ([], [])
