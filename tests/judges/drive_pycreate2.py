"""pycreate2 reads a Create 2, drives it straight and turns it; prints what it read."""

import json
import sys
import time

from pycreate2 import Create2

bot = Create2(sys.argv[1])
bot.start()
bot.safe()
before = bot.get_sensors()
bot.drive_direct(200, 200)
time.sleep(1.0)
bot.drive_direct(0, 0)
time.sleep(0.2)
middle = bot.get_sensors()
bot.drive_direct(50, -50)
time.sleep(1.0)
bot.drive_stop()
after = bot.get_sensors()
names = (
    "encoder_counts_left",
    "encoder_counts_right",
    "distance",
    "angle",
    "open_interface_mode",
    "voltage",
)
rows = [{name: getattr(each, name) for name in names} for each in (before, middle, after)]
print(json.dumps(rows), flush=True)
