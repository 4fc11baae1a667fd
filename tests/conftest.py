"""What all tests share: fixed arithmetic, ports of a robot, a limit of time, a browser."""

import shutil
import signal
from collections.abc import Generator
from types import FrameType

import hypothesis
import pytest

import scan3d_twin  # noqa: F401 - before NumPy: the tests compare bits with those of the program


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the ports of a real robot, to run the contract on it."""
    group = parser.getgroup("hardware")
    group.addoption("--port", help="Serial port of the real base: run the contract on the robot.")
    group.addoption("--lidar-port", help="Serial port of the real lidar.")
    group.addoption("--robot", help="Base that the contract is run on, instead of both Creates.")
    group.addoption("--lidar", help="Lidar that the contract is run on.")
    parser.addini("cpu_limit", "Processor time that one test may take [s].", default="120")


def pytest_configure() -> None:
    """Let programs obey all signals, where nohup ignores some, and properties meet no luck."""
    hypothesis.settings.register_profile("same", deadline=None, derandomize=True)
    hypothesis.settings.load_profile("same")
    for number in (signal.SIGHUP, signal.SIGINT, signal.SIGQUIT):
        if signal.getsignal(number) is signal.SIG_IGN:
            default = signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL
            signal.signal(number, default)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, None, None]:
    """Fail a test by its own processor time: a busy computer makes it slow, but not wrong.

    What waits for others for ever is left to the ``timeout`` of pytest-timeout.
    """
    limit = float(item.config.getini("cpu_limit"))

    def give_up(number: int, frame: FrameType | None) -> None:
        pytest.fail(f"took more than {limit:g} s of processor time")

    before = signal.signal(signal.SIGPROF, give_up)
    signal.setitimer(signal.ITIMER_PROF, limit)
    try:
        return (yield)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


@pytest.fixture(scope="session")
def browser():
    """A headless Chromium that finds nothing but this machine; Playwright allows one a process."""
    playwright = pytest.importorskip("playwright.sync_api", reason="needs the package playwright")
    path = shutil.which("chromium")
    if path is None:
        pytest.skip("needs Chromium (Debian: apt install chromium)")
    blocked = "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"
    arguments = ["--no-sandbox", "--enable-unsafe-swiftshader", blocked]
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=path, args=arguments)
        yield opened
        opened.close()


class Watched:
    """A page with what went wrong on it and what it asked of other machines."""

    def __init__(self, page):
        self.page, self.errors, self.asked = page, [], []
        page.on("console", lambda m: self.errors.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("request", lambda request: self._note(request.url))

    def _note(self, url):
        local = ("data:", "blob:", "file:", "http://127.0.0.1", "ws://127.0.0.1", "about:")
        if not url.startswith(local):
            self.asked.append(url)


@pytest.fixture
def open_page(browser):
    """Open a page of a size and colour scheme, watched."""
    from pixels import SOON

    contexts = []

    def opening(url, *, width=1000, height=800, **options):
        """Open ``url`` and return the watched page."""
        context = browser.new_context(viewport={"width": width, "height": height}, **options)
        context.set_default_timeout(SOON)
        contexts.append(context)
        watched = Watched(context.new_page())
        watched.page.goto(url)
        return watched

    yield opening
    for context in contexts:
        context.close()
