"""What Jupyter shows of a session, a model and a run: drawn in a browser, without asking others."""

import json
import re
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

import scan3d_twin as s3d
from scan3d_twin.api.run import RunOutcome

FRAME = """<!doctype html><html lang="en"><meta charset="utf-8"><title>notebook</title>
<body>{}</body></html>"""


class Frames(HTMLParser):
    """Collects the documents in frames, and what a page loads."""

    def __init__(self, html):
        super().__init__()
        self.documents, self.loaded = [], []
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        self.loaded += [values[name] for name in ("src", "href") if name in values]
        if tag == "iframe":
            assert values["sandbox"] == "allow-scripts allow-downloads"
            assert values["title"]
            self.documents.append(values["srcdoc"])


def loaded(html):
    """Return what ``html`` and the documents in it load."""
    found = Frames(html)
    return found.loaded + [each for inner in found.documents for each in loaded(inner)]


@pytest.fixture
def outcome(session, tmp_path):
    """A run with a page."""
    (tmp_path / "report.html").write_text('<p>the page &amp; its "words"</p>', encoding="utf-8")
    return RunOutcome(tmp_path, {"scene": "three <boxes>"}, session, None)


def test_a_session_shows_its_facts_and_its_pictures(session):
    html = session._repr_html_()
    assert "Session of 3 views</b>: front complete." in html
    kinds = [address.partition(";")[0] for address in loaded(html)]
    assert kinds == ["data:image/svg+xml", "data:image/png"]
    assert "<script" not in html
    assert "<style" not in html


def test_a_session_without_a_view_has_its_facts_only(session):
    html = replace(session, views=(), plans=(), stop_reason="")._repr_html_()
    assert "Session of 0 views</b>: not ended." in html
    assert loaded(html) == []


def test_what_ended_a_session_is_no_markup(session):
    html = session.with_stop_reason("<b>stop</b>")._repr_html_()
    assert "&lt;b&gt;stop" in html


def test_a_model_turns_in_a_frame_without_asking_others(session, open_page, tmp_path):
    model = s3d.build_model(session)
    html = model._repr_html_()
    assert all(address.startswith("data:") for address in loaded(html))
    path = tmp_path / "cell.html"
    path.write_text(FRAME.format(html), encoding="utf-8")
    watched = open_page(path.as_uri())
    inside = watched.page.frames[1]
    inside.wait_for_selector("#model.drawn")
    assert inside.locator("#controls input[data-view]").count() == 3
    assert inside.locator("button[data-file]").all_inner_texts() == ["PLY", "E57", "JSON"]
    with watched.page.expect_download() as download:
        inside.get_by_role("button", name="JSON").click()
    assert json.loads(Path(download.value.path()).read_text())["points"] == len(model)
    assert json.loads(inside.locator("#report").inner_text())["points"] == len(model)
    assert (watched.errors, watched.asked) == ([], [])


def test_an_empty_model_says_so(session):
    nothing = s3d.build_model(session).select(np.zeros(0, dtype=np.int64))
    (document,) = Frames(nothing._repr_html_()).documents
    assert "there is no model" in document


def test_a_run_shows_its_report_and_its_session_once_that_is_gone(outcome):
    found = Frames(outcome._repr_html_())
    assert found.documents == ['<p>the page &amp; its "words"</p>']
    (outcome.folder / "report.html").unlink()
    assert "Session of 3 views" in outcome._repr_html_()


def test_what_draws_is_loaded_when_a_notebook_asks_for_it():
    program = (
        "import sys, scan3d_twin as s3d; s3d.Session; "
        "print(any(name.startswith('scan3d_twin.viz') for name in sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout == "False\n"


def test_the_names_in_the_page_are_as_they_are(outcome):
    assert re.search(r'title="Report of three &lt;boxes&gt;"', outcome._repr_html_())
