"""create-serial drives a Create 2 straight and turns it; prints the pose it integrates."""

import json
import sys
import time

from create_serial import create

bot = create.Create(sys.argv[1])


def look():
    """Return pose [mm, rad], mode and voltage [mV]."""
    readings = bot.sensors(
        [create.ENCODER_LEFT, create.ENCODER_RIGHT, create.OI_MODE, create.VOLTAGE]
    )
    return [*bot.getPose(dist="mm"), readings[create.OI_MODE], readings[create.VOLTAGE]]


rows = [look()]
for left, right in ((20, 20), (-5, 5)):
    bot.setWheelVelocities(left, right)
    time.sleep(1.0)
    bot.setWheelVelocities(0, 0)
    time.sleep(0.2)
    rows.append(look())
print(json.dumps(rows), flush=True)
