"""The documentation's site, as ``make docs`` built it, in a browser that may ask nobody else."""

from pathlib import Path

import pytest

SITE = Path(__file__).resolve().parents[1] / "build" / "docs"
OWN = ("file:", "data:", "blob:")
"""Addresses that are no requests to another host."""


@pytest.mark.skipif(not (SITE / "index.html").is_file(), reason="needs the site: make docs")
def test_no_page_of_the_site_asks_another_host(browser):
    page, asked = browser.new_page(), []
    page.on("request", lambda request: asked.append(request.url))
    pages = sorted(path for path in SITE.rglob("*.html") if "_static" not in path.parts)
    assert len(pages) > 20
    for path in pages:
        page.goto(path.as_uri(), wait_until="load")
    page.close()
    assert sum(url.startswith(OWN) for url in asked) > 3 * len(pages)
    assert [url for url in asked if not url.startswith(OWN)] == []
