"""What every page must keep: nothing asked of others, no error, keyboard, WCAG AA, and its size."""

from __future__ import annotations

from typing import Any

from axe_playwright_python.sync_playwright import Axe

WIDTHS = (1400, 390)
"""Widths at which pages are judged: a desk's and a phone's [px]."""
SCHEMES = ("light", "dark")
MAX_PAGE = 10_000_000
"""Most bytes of a page."""
RULES = {
    "runOnly": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "best-practice"],
    "resultTypes": ["violations"],
}
"""Rules of axe-core: WCAG 2.1 A and AA, with contrast, and the authors' own."""


def find_violations(page: Any) -> list[str]:
    """Return what axe-core finds wrong with ``page``, a line a place."""
    found = Axe().run(page, options=RULES).response["violations"]
    return [f"{rule['id']}: {node['html'][:120]}" for rule in found for node in rule["nodes"]]


def tab_stops(page: Any, most: int = 400) -> list[str]:
    """Return what Tab reaches on ``page``, from its start: the id or the text of each element."""
    page.evaluate("document.activeElement.blur()")
    stops: list[str] = []
    for _ in range(most):
        page.keyboard.press("Tab")
        name = page.evaluate(
            "() => { const e = document.activeElement; return e === document.body ? '' : e.id || "
            "e.getAttribute('aria-label') || e.textContent.trim().slice(0, 40) || e.tagName; }"
        )
        if not name:
            break
        stops.append(name)
    return stops
