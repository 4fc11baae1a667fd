"""Drives the base on the port named by the first argument until it is killed; then hangs if told.

What it does is told by the second argument: ``drive`` services the base for ever, ``hang`` stops
servicing after half a second, ``rest`` opens it and stands, ``leave`` drives and ends in order.
"""

import sys
import time

from scan3d_twin.devices.create.device import CREATE2
from scan3d_twin.devices.create.driver import open_create
from scan3d_twin.devices.links.guard import ProcessGuard
from scan3d_twin.devices.links.transport import SerialTransport
from scan3d_twin.real.clock import RealClock

port, what = sys.argv[1:]
clock = RealClock()
link = SerialTransport(port)
guard = ProcessGuard(link.fileno(), CREATE2.farewell, clock)
base = open_create(link, clock, guard)
if what != "rest":
    base.set_velocity(0.2, 0.0)
print("ready", flush=True)
started = clock.now()
while what in ("drive", "rest") or clock.now() < started + 0.5:
    clock.sleep(0.005)
    base.service(clock.now())
if what == "hang":
    time.sleep(60)
base.close()
guard.close()
link.close()
print("closed", flush=True)
