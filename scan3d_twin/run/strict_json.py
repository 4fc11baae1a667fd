"""JSON from elsewhere: every failure is a ``ValueError``, and all texts can be written again."""

from __future__ import annotations

import json
import re
from typing import Any

_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")
"""Escapes of surrogates: alone, they are no character, and no file or terminal takes them."""


def parse_json(text: str | bytes) -> Any:
    """Return the content of a JSON ``text``.

    Raises:
        ValueError: It is not JSON, holds NaN or an infinity, is nested too deeply, or holds a text
            that UTF-8 cannot hold.
    """
    plain = text.decode("utf-8") if isinstance(text, bytes) else text
    try:
        content = json.loads(plain, parse_constant=_refuse)
    except RecursionError:
        raise ValueError("nested too deeply") from None
    if _SURROGATE.search(plain):
        json.dumps(content, ensure_ascii=False).encode()
    return content


def _refuse(constant: str) -> Any:
    raise ValueError(f"{constant} is not JSON")
