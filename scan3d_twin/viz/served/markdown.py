"""Text for the live view's Markdown, shown letter by letter.

viser renders Markdown with HTML, images and expressions in braces. Names and reasons come from
files, so that none of their characters may mean anything.
"""

from __future__ import annotations

import re

_MARKUP = re.compile(r"[^\w ]|_")


def as_text(text: str) -> str:
    """Return ``text`` on one line as Markdown that shows it and nothing else.

    >>> as_text("<b>1*2</b>")
    '&#60;b&#62;1&#42;2&#60;&#47;b&#62;'
    """
    line = " ".join(text.split())
    return _MARKUP.sub(lambda match: f"&#{ord(match[0])};", line)
