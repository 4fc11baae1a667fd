"""The simulated clock: time passes by stepping the physics."""

from __future__ import annotations

import math
from typing import Protocol

from scan3d_twin.sim.world import World


class Device(Protocol):
    """A part of the twin that must be serviced at certain physics steps."""

    @property
    def next_step(self) -> int:
        """The physics step at which ``service`` is due."""
        ...

    def service(self) -> None:
        """Do what is due."""
        ...


class SimClock:
    """A ``Clock`` on the twin; its resolution is one physics step."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._devices: list[Device] = []

    def attach(self, *devices: Device) -> None:
        """Service ``devices`` from now on, in this order."""
        self._devices += devices

    def now(self) -> float:
        """See ``Clock.now``."""
        return self._world.time

    def sleep(self, seconds: float) -> None:
        """See ``Clock.sleep``."""
        self.run_until(self.step_after(seconds))

    def step_after(self, seconds: float) -> int:
        """Return the first physics step at or after ``seconds`` [s] from now."""
        return self._world.steps + max(0, math.ceil(seconds / self._world.timestep - 1e-9))

    def run_until(self, step: int) -> None:
        """Let the physics run up to ``step`` while the devices are serviced.

        Raises:
            HazardError: A device reported a hazard.
        """
        world, devices = self._world, self._devices
        while world.steps < step:
            due = step
            for device in devices:
                due = min(due, device.next_step)
            world.advance(max(1, due - world.steps))
            for device in devices:
                if device.next_step <= world.steps:
                    device.service()
