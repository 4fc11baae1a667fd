"""The console in Chromium, from the start of a run to its model, and what others may not do."""

import json
import re
import shutil
import signal
import subprocess
import sys

import pytest
from accessible import SCHEMES, WIDTHS, find_violations, tab_stops
from pixels import SMALL, SOON

from scan3d_twin.cli.console.form import form_fields

HOSTILE = '<img src=x onerror="globalThis.taken=1"> & {1} **b**'
"""A name of a run that is markup."""
SPY = """<!doctype html><title>spy</title><p id="got">...</p><script>
const got = [];
const tries = ["/state", "/runs", "/stop"].map(path => fetch(path, {
  method: path === "/stop" ? "POST" : "GET", credentials: "include",
  headers: path === "/stop" ? {"Content-Type": "application/json"} : {},
  body: path === "/stop" ? "{}" : undefined,
}).then(a => got.push(path + a.status)).catch(() => got.push("refused")));
try { got.push("cookie" + document.cookie) } catch { got.push("refused") }
try { got.push(opener ? "opener" : "refused") } catch { got.push("refused") }
Promise.all(tries).then(() => document.getElementById("got").textContent = got.join(" "));
</script>"""
"""A report from someone else, which tries to use the console."""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """The folder in which the console was started."""
    return tmp_path_factory.mktemp("console")


@pytest.fixture(scope="module")
def address(place, finished):
    """The address of a console with two earlier runs, one of them someone else's."""
    runs = place / "runs"
    shutil.copytree(finished[0], runs / "earlier")
    hostile = runs / HOSTILE
    hostile.mkdir()
    report = json.loads((finished[0] / "report.json").read_text())
    (hostile / "report.json").write_text(json.dumps({**report, "warnings": [HOSTILE] * 2}))
    (hostile / "report.html").write_text(SPY)
    command = [sys.executable, "-m", "scan3d_twin.cli", "console", "--view-port", "0", "--json"]
    with subprocess.Popen(command, cwd=place, stdout=subprocess.PIPE, text=True) as process:
        yield json.loads(process.stdout.readline())["address"]
        process.send_signal(signal.SIGINT)
        assert process.wait(SOON / 1000) == 0


def row(page, name):
    """Return the row of a run in the list."""
    return page.locator("#runs tbody tr").filter(has=page.get_by_text(name, exact=True))


def state(page, wanted):
    """Wait until the run is in the state ``wanted``."""
    page.locator("#state").get_by_text(wanted, exact=True).wait_for()


@pytest.mark.slow
def test_a_run_is_started_paused_continued_finished_compared_and_exported(
    open_page, address, place
):
    shown = open_page(address, **SMALL)
    page, form = shown.page, shown.page.locator("#sim")

    # An error of the command line is shown; then a run starts
    form.get_by_label("Max views").fill("2.5")
    page.get_by_role("button", name="Start the simulation").click()
    page.locator("#error").get_by_text("--max-views").wait_for()
    form.get_by_label("Max views").fill("2")
    form.get_by_label("Epsilon").fill("100")
    form.get_by_text("More options").click()
    form.get_by_label("Other options").fill("--sweep.width 0.4")
    page.get_by_role("button", name="Start the simulation").click()
    state(page, "running")
    assert shown.errors == []

    # One run at a time
    page.get_by_role("button", name="Start the simulation").click()
    page.get_by_text("a run goes on: wait until it has ended, or stop it").wait_for()
    page.get_by_role("button", name="Close").click()
    assert [each for each in shown.errors if "409" not in each] == []
    shown.errors.clear()

    # The console pauses, and its live view continues
    page.get_by_role("button", name="Pause").click()
    state(page, "paused")
    with page.context.expect_page() as opening:
        page.get_by_role("link", name="Open the live view").click()
    view = opening.value
    view.get_by_text("paused", exact=True).wait_for()
    view.get_by_role("button", name="Continue").click()
    page.locator("#lines", has_text="continuing").wait_for(state="attached")
    view.close()

    # The run ends with a model
    state(page, "finished")
    run = page.locator("#runs tbody tr").filter(has_text="three_boxes-")
    name = run.locator("input").get_attribute("value")
    run.locator("td[data-label=Views]", has_text=re.compile("^2$")).wait_for()
    assert (place / "runs" / name / "model.ply").stat().st_size > 1000

    # It is exported and compared
    page.get_by_label("Export as").select_option("xyz")
    run.get_by_role("button", name="Export").click()
    page.get_by_text(f"{name}: cloud.xyz").wait_for()
    run.locator("summary").click()
    with page.expect_download() as download:
        run.get_by_role("link", name="cloud.xyz").click()
    assert download.value.path().read_bytes() == (place / "runs" / name / "cloud.xyz").read_bytes()
    run.locator("input").check()
    row(page, "earlier").locator("input").check()
    page.get_by_role("button", name="Compare the marked runs").click()
    with page.context.expect_page() as opening:
        page.get_by_role("link", name="Open the comparison").click()
    opening.value.get_by_role("heading", name="2 runs compared").wait_for()

    # Its report has all it has as a file, with an origin of its own
    with page.context.expect_page() as opening:
        run.get_by_role("link", name="Report of").click()
    report = opening.value
    report.locator("#model.drawn").wait_for()
    assert report.evaluate("origin") == "null"
    with report.expect_download() as download:
        report.locator("button[data-file=json]").click()
    assert json.loads(download.value.path().read_text())["views"] == 2
    assert (shown.errors, shown.asked) == ([], [])


def test_what_a_run_of_someone_else_holds_is_text_and_reaches_nothing(open_page, address):
    shown = open_page(address)
    page = shown.page
    other = row(page, HOSTILE)
    other.get_by_text("2 warnings").wait_for()
    with page.context.expect_page() as opening:
        other.get_by_role("link", name="Report of").click()
    spy = opening.value
    spy.get_by_text("refused").wait_for()
    assert spy.locator("#got").inner_text().split() == ["refused"] * 5
    assert page.locator("#runs img").count() == 0
    assert page.evaluate("globalThis.taken") is None
    assert shown.errors == []


@pytest.mark.parametrize("width", WIDTHS)
def test_the_console_is_accessible(open_page, address, width):
    for scheme in SCHEMES:
        watched = open_page(address, width=width, color_scheme=scheme)
        page = watched.page
        row(page, "earlier").wait_for()
        page.get_by_label("Simulated robot" if scheme == "dark" else "Real robot").check()
        for each in page.locator("summary:visible").all():
            each.click()
        assert find_violations(page) == []
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert (watched.errors, watched.asked) == ([], [])


def test_all_of_it_is_reached_by_the_keyboard(open_page, address):
    page = open_page(address).page
    row(page, "earlier").wait_for()
    page.locator("#sim details").evaluate("details => details.open = true")
    stops = tab_stops(page)
    assert {f"sim-{field.name}" for field in form_fields("sim")} <= {*stops}
    assert {"check", "format", "Report of earlier", "Resume earlier", "Files of earlier"} <= {
        *stops
    }
    page.get_by_label("Simulated robot").focus()
    page.keyboard.press("ArrowRight")
    page.get_by_role("button", name="Start: the robot will drive").wait_for()
    page.get_by_role("button", name="Start the simulation").wait_for(state="hidden")
