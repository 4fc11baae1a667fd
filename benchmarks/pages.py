"""How long a reader waits for the page of a run, and how large it is.

Run: .venv/bin/python benchmarks/pages.py [--views 20] [--repeats 5] [--run FOLDER]

Makes a run of that many views, unless the folder of one is given, and opens its report.html in a
headless Chromium that draws without a GPU. Prints the size of the page, and as medians the time
from the request to the first content and until the model is drawn in 3D. The first picture is
wanted in under 2 s, the page below 10 MB.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import shutil
import tempfile
from pathlib import Path
from statistics import median
from typing import Any

WIDTHS = (1400, 390)
DRAWN = """() => new Promise((tell) => {
  const look = () => {
    if (!document.querySelector("#model.drawn")) return requestAnimationFrame(look);
    requestAnimationFrame(() => tell(performance.now()));
  };
  look();
})"""
FIRST = """() => new Promise((tell) => new PerformanceObserver((list) => tell(
  list.getEntriesByName("first-contentful-paint")[0].startTime
)).observe({ type: "paint", buffered: true }))"""


def make_run(views: int, folder: Path) -> Path:
    """Return the folder of a run of ``views`` views."""
    from scan3d_twin.cli import main

    # Short steps at a short distance make many views
    many = ["--planner", "fixed80", "--planning.standoff", "0.5", "--tour", "full"]
    many += ["--max-views", str(views)]
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        main(["sim", "--scene", "three_boxes", *many, "--out", str(folder)])
    return folder


def open_page(browser: Any, address: str, width: int) -> tuple[float, float]:
    """Return the time of the first content and of the model in 3D after the request [s]."""
    page = browser.new_page(viewport={"width": width, "height": 900})
    page.goto(address, wait_until="commit")
    drawn, first = page.evaluate(DRAWN), page.evaluate(FIRST)
    page.close()
    return first / 1e3, drawn / 1e3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--run", type=Path)
    arguments = parser.parse_args()
    from playwright.sync_api import sync_playwright

    chromium = shutil.which("chromium")
    if chromium is None:
        raise SystemExit("needs Chromium: apt install chromium")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as driver:
        run = arguments.run or make_run(arguments.views, Path(folder) / "run")
        page = (run / "report.html").resolve()
        count = json.loads((run / "report.json").read_text(encoding="utf-8"))["views"]
        print(f"report.html of {count} views: {page.stat().st_size / 1e6:.1f} MB")
        options = ["--no-sandbox", "--enable-unsafe-swiftshader"]
        browser = driver.chromium.launch(executable_path=chromium, args=options)
        for width in WIDTHS:
            times = [open_page(browser, page.as_uri(), width) for _ in range(arguments.repeats)]
            first, drawn = (median(each) for each in zip(*times, strict=True))
            print(f"{width} px: first content {first:.2f} s, model in 3D {drawn:.2f} s")
        browser.close()


if __name__ == "__main__":
    main()
