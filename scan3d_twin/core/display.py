"""How values show themselves in a notebook: by a renderer that is named from outside.

The core draws nothing and knows nobody who does. The front door of the package names a renderer,
as an entry point names a planner; it is loaded when a notebook first asks for it.
"""

from __future__ import annotations

from collections.abc import Callable

_installed: list[str] = []


def install_renderer(place: str) -> None:
    """Let the function at ``place`` draw what notebooks show, instead of any other.

    Args:
        place: Where it is, such as ``package.module:function``. It returns HTML that fetches
            nothing.
    """
    _installed[:] = [place]


def render_html(value: object) -> str | None:
    """Return ``value`` as HTML; None, for which a notebook shows its text, without a renderer."""
    if not _installed:
        return None
    from pkgutil import resolve_name  # not for every import of the package

    renderer: Callable[[object], str] = resolve_name(_installed[-1])
    return renderer(value)
