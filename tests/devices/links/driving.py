"""A process that drives the base on the port given as first argument, for tests of the guard.

The second argument chooses what it does: ``drive`` services the base until it is killed, ``hang``
stops servicing after half a second, ``rest`` opens the base and stands, ``leave`` drives and exits
in order.
"""

import sys
import time
from contextlib import ExitStack

from scan3d_twin.core.errors import HazardError
from scan3d_twin.devices.create.device import CREATE2
from scan3d_twin.devices.create.driver import open_create
from scan3d_twin.devices.links.guard import PortGuard
from scan3d_twin.devices.links.transport import SerialTransport
from scan3d_twin.real.clock import RealClock
from scan3d_twin.real.suspension import count_continuations

port, what = sys.argv[1:]
clock = RealClock()
link = SerialTransport(port)
continuations = ExitStack()
guard = PortGuard(CREATE2.farewell, clock, continuations.enter_context(count_continuations()))
guard.watch(link.fileno())
base = open_create(link, clock, guard)
if what != "rest":
    base.set_velocity(0.2, 0.0)
print("ready", flush=True)
started = clock.now()
try:
    while what in ("drive", "rest") or clock.now() < started + 0.5:
        clock.sleep(0.005)
        base.service(clock.now())
except HazardError as error:
    base.set_velocity(0.0, 0.0)
    print(error, flush=True)
if what == "hang":
    time.sleep(60)
base.close()
guard.close()
link.close()
print("closed", flush=True)
