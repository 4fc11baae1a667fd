"""PyRoombaAdapter drives a Create 2 and reads it; prints what it read."""

import json
import sys
import time

from pyroombaadapter import PyRoombaAdapter

bot = PyRoombaAdapter(sys.argv[1])
bot.change_mode_to_safe()
before = bot.request_encoder_counts()
bot.send_drive_direct(200, 200)
time.sleep(1.0)
bot.send_drive_direct(0, 0)
time.sleep(0.2)
after = bot.request_encoder_counts()
print(json.dumps([before, after, bot.request_oi_mode(), bot.request_voltage()]), flush=True)
