"""The title and icon of the served pages, and the precision of what they show."""

import gzip
import urllib.request

import numpy as np

from scan3d_twin.viz.served.server import LOOPBACK, open_server
from scan3d_twin.viz.served.stage import Stage

TITLE = "</title><b>boxes & co"


def fetch(address, encoding):
    """Return the page at ``address`` as it comes, and what its headers state of it."""
    request = urllib.request.Request(address, headers={"Accept-Encoding": encoding})
    with urllib.request.urlopen(request, timeout=20) as answer:
        body = answer.read()
        assert int(answer.headers["Content-Length"]) == len(body)
        assert answer.headers["Content-Encoding"] == encoding
    return body


def test_the_page_has_our_title_and_icon_compressed_or_not():
    with open_server(LOOPBACK, 0, TITLE) as (_, address):
        pages = [fetch(address, "identity").decode(), gzip.decompress(fetch(address, "gzip"))]
    assert pages[1].decode() == pages[0]
    head = pages[0][: pages[0].index("<script")]
    assert "<title>&lt;/title&gt;&lt;b&gt;boxes &amp; co</title>" in head
    assert 'href="data:image/svg+xml,%3Csvg%20' in head
    assert "viser" not in head.lower()


def test_points_reach_the_page_as_they_are(session):
    with open_server(LOOPBACK, 0, "boxes") as (server, _):
        Stage(server).show_views(session)
        for k, view in enumerate(session.views):
            sent = server.scene.get_handle_by_name(f"/views/{k:03d}/target").points
            np.testing.assert_allclose(sent, view.target.points, atol=1e-6)
