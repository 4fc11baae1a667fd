from pixels import SMALL, SOON, drawn

from scan3d_twin.viz.server import LOOPBACK, open_server
from scan3d_twin.viz.session_view import SessionView


def test_a_session_is_shown_by_view_back_and_forth_light_and_dark(session, open_page):
    with open_server(LOOPBACK, 0, "boxes") as (server, address):
        SessionView(server, "boxes", session)
        shown = open_page(address, **SMALL)
        page = shown.page
        page.get_by_text("view 2 (3 of 3 views)").wait_for(timeout=SOON)
        assert drawn(page, {0, 1, 2}) == {0, 1, 2}

        page.get_by_role("slider").first.focus()
        page.keyboard.press("ArrowLeft")
        page.get_by_text("view 1 (2 of 3 views)").wait_for(timeout=SOON)
        page.get_by_text("15.0 mm").first.wait_for(timeout=SOON)  # what its plan predicted
        assert drawn(page, {0, 1}) == {0, 1}

        page.get_by_role("checkbox").nth(1).check(force=True)
        dark = "document.querySelector('[data-mantine-color-scheme=dark]') !== null"
        page.wait_for_function(dark, timeout=SOON)
        assert (shown.errors, shown.asked) == ([], [])
