"""One contract, every backend: a backend is a function that opens a robot in front of a scene."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager

import pytest

from scan3d_twin.core.hal import Robot
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


BACKENDS: dict[str, Opener] = {"sim": _sim, "wired": _wired}


@pytest.fixture(params=BACKENDS)
def open_in(request: pytest.FixtureRequest) -> Iterator[Callable[[str], Robot]]:
    """Open the backend's robot in front of a named scene, closed when the test ends."""
    with ExitStack() as stack:
        yield lambda scene: stack.enter_context(BACKENDS[request.param](scene))


@pytest.fixture
def robot(open_in: Callable[[str], Robot]) -> Robot:
    """A robot with 1.4 m of free floor ahead."""
    return open_in("three_boxes")
