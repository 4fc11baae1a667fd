"""One contract, every backend: a backend is a function that opens a robot in front of a scene."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager

import pytest

from scan3d_twin.core.hal import Robot
from scan3d_twin.real.ports import choose_ports
from scan3d_twin.real.robot import open_real
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.wired import open_wired

Opener = Callable[[str], AbstractContextManager[Robot]]


@contextmanager
def _sim(scene: str) -> Iterator[Robot]:
    with open_sim(scene, seed=7) as (robot, _):
        yield robot


@contextmanager
def _wired(scene: str) -> Iterator[Robot]:
    with open_wired(scene, seed=7) as (robot, _):
        yield robot


@contextmanager
def _wired_create1(scene: str) -> Iterator[Robot]:
    with open_wired(scene, seed=7, config=TwinConfig(robot="create1")) as (robot, _):
        yield robot


BACKENDS: dict[str, Opener] = {"sim": _sim, "wired": _wired, "wired_create1": _wired_create1}


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run everything on each backend; on the real robot too if its port is given."""
    if "open_in" in metafunc.fixturenames:
        real = [pytest.param("hardware", marks=pytest.mark.hardware)]
        backends = [*BACKENDS, *(real if metafunc.config.getoption("--port") else [])]
        metafunc.parametrize("open_in", backends, indirect=True)


@pytest.fixture
def open_in(request: pytest.FixtureRequest) -> Iterator[Callable[[str], Robot]]:
    """Open the backend's robot in front of a named scene, closed when the test ends.

    The real robot stands where it stands: give it 1.4 m of free floor, and a wall behind that.
    """
    given = [request.config.getoption(name) for name in ("--port", "--lidar-port")]

    def real(_: str) -> AbstractContextManager[Robot]:
        return open_real(*choose_ports(*given))

    opener = {**BACKENDS, "hardware": real}[request.param]
    with ExitStack() as stack:
        yield lambda scene: stack.enter_context(opener(scene))


@pytest.fixture
def robot(open_in: Callable[[str], Robot]) -> Robot:
    """A robot with 1.4 m of free floor ahead."""
    return open_in("three_boxes")
