"""What all tests share: the arithmetic of the program, the robot's ports, and a limit of time."""

from scan3d_twin.cli.arithmetic import fix_arithmetic

fix_arithmetic()  # before anything loads NumPy: the tests compare bits with those of the program

import signal  # noqa: E402
from collections.abc import Generator  # noqa: E402
from types import FrameType  # noqa: E402

import pytest  # noqa: E402


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the ports of a real robot, to run the contract on it."""
    group = parser.getgroup("hardware")
    group.addoption("--port", help="Serial port of the real base: run the contract on the robot.")
    group.addoption("--lidar-port", help="Serial port of the real lidar.")
    group.addoption("--robot", help="Base that the contract is run on, instead of both Creates.")
    group.addoption("--lidar", help="Lidar that the contract is run on.")
    parser.addini("cpu_limit", "Processor time that one test may take [s].", default="120")


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
