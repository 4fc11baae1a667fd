"""Fails the build when a page would fetch anything from another host.

The site is read on robots without a network, and no visit should be reported to others: fonts,
scripts and styles come from the site itself. A link that a reader may follow is no request.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx

ELSEWHERE = re.compile(r"\s*(?:[a-z][a-z0-9+.-]*:)?//", re.IGNORECASE)
"""An address with a host of its own; ``data:`` has none."""
IN_STYLE = re.compile(
    r"""(?:url\(\s*["']?|@import\s+["'])((?:[a-z]+:)?//[^"')\s]*)""", re.IGNORECASE
)
FETCHED = {"src", "srcset", "poster", "data", "action"}
FOLLOWED = {
    "alternate",
    "author",
    "bookmark",
    "canonical",
    "help",
    "index",
    "license",
    "next",
    "prev",
    "search",
    "up",
}
"""Relations of ``<link>`` that a browser does not load by itself."""


class _Requests(HTMLParser):
    """Collects the addresses on other hosts that a browser loads to show a page."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []
        self.style = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attrs}
        self.style = tag == "style"
        loaded = {name for name in FETCHED if name in values}

        # What a link loads depends on its relation
        followed = set(values.get("rel", "").lower().split()) <= FOLLOWED
        if tag == "link" and not followed:
            loaded.add("href")
        if tag in {"image", "use"}:
            loaded |= {"href", "xlink:href"} & set(values)

        # A srcset holds several addresses
        for name in sorted(loaded):
            each = values.get(name, "").split(",") if name == "srcset" else [values.get(name, "")]
            self.found += [address.strip() for address in each if ELSEWHERE.match(address)]
        self.found += IN_STYLE.findall(values.get("style", ""))

    def handle_data(self, data: str) -> None:
        if self.style:
            self.found += IN_STYLE.findall(data)

    def handle_endtag(self, tag: str) -> None:
        self.style = False


def requests_of_page(html: str) -> list[str]:
    """Return the addresses on other hosts that showing ``html`` requests."""
    parser = _Requests()
    parser.feed(html)
    return parser.found


def requests_of_site(folder: Path) -> Iterator[str]:
    """Yield a line per request to another host in the pages and styles below ``folder``."""
    for path in sorted(folder.rglob("*")):
        if path.suffix == ".html":
            found = requests_of_page(path.read_text(encoding="utf-8"))
        elif path.suffix in {".css", ".svg"}:
            found = IN_STYLE.findall(path.read_text(encoding="utf-8"))
        else:
            continue
        yield from (f"{path.relative_to(folder)} requests {address}" for address in found)


def refuse_requests(app: Sphinx, exception: Exception | None) -> None:
    """Raise ``SphinxError`` if the finished site requests anything from another host."""
    from sphinx.errors import SphinxError

    if exception is None and (found := list(requests_of_site(Path(app.outdir)))):
        raise SphinxError("\n".join(["the site must not load anything from other hosts:", *found]))


def setup(app: Sphinx) -> dict[str, Any]:
    """Connect the check to the end of the build."""
    app.connect("build-finished", refuse_requests)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
