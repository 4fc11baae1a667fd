"""The title and the icon of the pages that viser serves.

viser's page is one file with a title and an icon of its own, and no option for either; they are
replaced in the answer that carries the file.
"""

from __future__ import annotations

import gzip
import html
import re
from urllib.parse import quote

from websockets.http11 import Response

ICON = (
    "<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 32 32'>"
    "<rect width='32' height='32' rx='7' fill='#0b62c4'/>"
    "<circle cx='8' cy='24' r='4' fill='#fff'/>"
    "<path d='M8 14a10 10 0 0 1 10 10M8 6a18 18 0 0 1 18 18' fill='none' stroke='#fff' "
    "stroke-width='3' stroke-linecap='round'/></svg>"
)
"""A scanner and two arcs of its rays."""
_TITLE = re.compile(r"<title>[^<]*</title>")
_ICON = re.compile(r'(<link\s+rel="icon"\s+href=")[^"]*(")')
_DESCRIPTION = re.compile(r'(<meta name="description" content=")[^"]*(")')


class Branding:
    """Puts a title and our icon into the page."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._pages: dict[bool, bytes] = {}

    def apply(self, response: Response) -> None:
        """Change ``response`` if it is the page; anything else stays as it is."""
        headers = response.headers
        if not headers.get("Content-Type", "").startswith("text/html"):
            return
        zipped = headers.get("Content-Encoding") == "gzip"
        if zipped not in self._pages:
            self._pages[zipped] = self._change(bytes(response.body), zipped)
        response.body = self._pages[zipped]
        del headers["Content-Length"]
        headers["Content-Length"] = str(len(response.body))

    def _change(self, body: bytes, zipped: bool) -> bytes:
        page = (gzip.decompress(body) if zipped else body).decode()
        title, icon = html.escape(self._title), "data:image/svg+xml," + quote(ICON)
        # Only the first of each: the rest of the file is a script
        page = _TITLE.sub(lambda _: f"<title>{title}</title>", page, count=1)
        page = _ICON.sub(lambda m: m[1] + icon + m[2], page, count=1)
        page = _DESCRIPTION.sub(lambda m: m[1] + title + m[2], page, count=1)
        return gzip.compress(page.encode(), mtime=0) if zipped else page.encode()
