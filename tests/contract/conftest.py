"""One contract, every backend: a backend is a function that opens a robot in front of a scene."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import replace
from typing import Any

import pytest

from scan3d_twin.core.hal import Robot
from scan3d_twin.devices.registry import DEFAULT_BASE, DEFAULT_LIDAR, Devices
from scan3d_twin.real.ports import choose_ports
from scan3d_twin.real.robot import open_real
from scan3d_twin.sim.config import DEFAULT_WORLD, TwinConfig
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.wired import open_wired

Opener = Callable[[str], AbstractContextManager[Robot]]


def openers(robot: str, lidar: str) -> tuple[Opener, Opener]:
    """Return what opens these devices in the twin, and their drivers on their emulators."""

    @contextmanager
    def sim(scene: str) -> Iterator[Robot]:
        with open_sim(scene, 7, TwinConfig.of(DEFAULT_WORLD, robot, lidar)) as (opened, _):
            yield opened

    @contextmanager
    def wired(scene: str) -> Iterator[Robot]:
        with open_wired(scene, 7, TwinConfig.of(DEFAULT_WORLD, robot, lidar)) as (opened, _):
            yield opened

    return sim, wired


ROTATING = "ld19"
"""A lidar that turns all round and measures by a clock of its own."""


@pytest.fixture
def lidar_name(request: pytest.FixtureRequest) -> str:
    """Return the name of the lidar of the backend of a test."""
    backend: str = request.node.callspec.params["open_in"]
    asked: str | None = request.config.getoption("--lidar")
    return ROTATING if backend.endswith(f"_{ROTATING}") else asked or DEFAULT_LIDAR


def backends(config: pytest.Config, *, every_lidar: bool = False) -> dict[str, Opener]:
    """Return what to hold to the contract: by default our own bases, else what is asked for.

    With ``every_lidar`` a lidar of each kind is among our own, else a Roomba.
    """
    robot, lidar = config.getoption("--robot"), config.getoption("--lidar") or DEFAULT_LIDAR
    sim, wired = openers(robot or DEFAULT_BASE, lidar)
    both = {"sim": sim, "wired": wired}
    if robot:
        return both
    both["wired_create1"] = openers("create1", lidar)[1]
    if not every_lidar:
        both["wired_roomba800"] = openers("roomba800", lidar)[1]
    elif lidar != ROTATING:
        names = f"sim_{ROTATING}", f"wired_{ROTATING}"
        both.update(zip(names, openers(DEFAULT_BASE, ROTATING), strict=True))
    return both


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run everything on each backend; on the real robot too if its port is given."""
    if "open_in" in metafunc.fixturenames:
        real = [pytest.param("hardware", marks=pytest.mark.hardware)]
        names = [*_backends_of(metafunc), *(real if metafunc.config.getoption("--port") else [])]
        metafunc.parametrize("open_in", names, indirect=True)


def _backends_of(test: pytest.Metafunc | pytest.FixtureRequest) -> dict[str, Opener]:
    assert test.module is not None
    return backends(test.config, every_lidar=test.module.__name__.endswith("test_lidar"))


@pytest.fixture
def open_in(request: pytest.FixtureRequest) -> Iterator[Callable[[str], Robot]]:
    """Open the backend's robot in front of a named scene, closed when the test ends.

    The real robot stands where it stands: give it 1.4 m of free floor, and a wall behind that.
    """
    option = request.config.getoption
    devices = Devices(option("--robot") or DEFAULT_BASE, option("--lidar") or DEFAULT_LIDAR)

    def real(_: str) -> AbstractContextManager[Robot]:
        ports = choose_ports(option("--port"), option("--lidar-port"), devices)
        return open_real(*ports, base=option("--robot"), lidar=devices.lidar)

    opener = {**_backends_of(request), "hardware": real}[request.param]
    with ExitStack() as stack:
        yield lambda scene: stack.enter_context(opener(scene))


def with_turntable(opener: Any, robot: str, pattern: str) -> Opener:
    """Return what opens ``robot`` with a servo, by ``open_sim`` or ``open_wired``."""

    @contextmanager
    def opening(scene: str) -> Iterator[Robot]:
        config = replace(TwinConfig.of(DEFAULT_WORLD, robot), pattern=pattern)
        with opener(scene, 7, config) as (opened, _):
            yield opened

    return opening


TURNTABLE_BACKENDS: dict[str, Opener] = {
    "sim": with_turntable(open_sim, DEFAULT_BASE, "yaw"),
    "wired": with_turntable(open_wired, DEFAULT_BASE, "yaw"),
    "wired_stand": with_turntable(open_wired, "stand", "pitch"),
}
"""What opens a robot with a turntable."""


@pytest.fixture(params=TURNTABLE_BACKENDS)
def open_with_turntable(request: pytest.FixtureRequest) -> Iterator[Callable[[str], Robot]]:
    """Open the robot of a backend that has a turntable, closed when the test ends."""
    with ExitStack() as stack:
        yield lambda scene: stack.enter_context(TURNTABLE_BACKENDS[request.param](scene))


@pytest.fixture(params=["yaw", "pitch", "roll"])
def pattern(request: pytest.FixtureRequest) -> str:
    """A pattern by a turntable."""
    return str(request.param)


@pytest.fixture(params=[open_sim, open_wired], ids=["sim", "wired"])
def robot_of_pattern(request: pytest.FixtureRequest, pattern: str) -> Iterator[Robot]:
    """A stand whose servo turns the lidar as ``pattern`` does, in the twin and by its drivers."""
    with with_turntable(request.param, "stand", pattern)("plain_wall") as robot:
        yield robot


@pytest.fixture
def robot(open_in: Callable[[str], Robot]) -> Robot:
    """A robot with 1.4 m of free floor ahead."""
    return open_in("three_boxes")
