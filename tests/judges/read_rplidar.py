"""One of five clients reads an RPLIDAR; prints its model, health and points as a line of JSON.

Usage: read_rplidar.py CLIENT PORT BAUD MODE; points are (angle [deg], distance [mm]).
"""

import json
import math
import sys
import time
from itertools import islice

POINTS = 1500


def read_pyrplidarsdk(port, baud, mode):
    from pyrplidarsdk import RplidarDriver

    lidar = RplidarDriver(port=port, baudrate=baud)
    assert lidar.connect()
    info, health = lidar.get_device_info(), lidar.get_health()
    assert lidar.start_scan()
    points, until = [], time.monotonic() + 10.0
    while len(points) < POINTS and time.monotonic() < until:
        if scan := lidar.get_scan_data():
            angles, metres, _ = scan
            points += zip(map(math.degrees, angles), (1000 * r for r in metres), strict=True)
    lidar.stop_scan()
    lidar.disconnect()
    return info.model, (health.status, health.error_code), points


def read_pyrplidar(port, baud, mode):
    from pyrplidar import PyRPlidar

    lidar = PyRPlidar()
    lidar.connect(port=port, baudrate=baud, timeout=3)
    info, health = lidar.get_info(), lidar.get_health()
    scan = lidar.start_scan() if mode == 0 else lidar.start_scan_express(mode)
    points = [(p.angle, p.distance) for p in islice(scan(), POINTS)]
    lidar.stop()
    lidar.disconnect()
    return info.model * 16, (health.status, health.error_code), points


def read_rplidar(port, baud, mode):
    from rplidar import RPLidar

    lidar = RPLidar(port, baud)
    info, health = lidar.get_info(), lidar.get_health()
    scan = lidar.iter_measures("normal" if mode == 0 else "express", max_buf_meas=False)
    points = [(angle, mm) for _, _, angle, mm in islice(scan, POINTS)]
    lidar.stop()
    lidar.stop_motor()
    return info["model"], health, points


def read_adafruit_rplidar(port, baud, mode):
    from adafruit_rplidar import RPLidar

    lidar = RPLidar(None, port, baudrate=baud, timeout=3)
    info, health = lidar.info, lidar.health
    scan = lidar.iter_measurements(max_buf_meas=0)
    points = [(angle, mm) for _, _, angle, mm in islice(scan, POINTS)]
    lidar.stop()
    return info["model"], health, points


def read_rplidarc1(port, baud, mode):
    import asyncio

    from rplidarc1 import RPLidar

    lidar = RPLidar(port, baud)
    points = []

    async def scan():
        reading = asyncio.create_task(lidar.simple_scan())
        while len(points) < POINTS:
            each = await lidar.output_queue.get()
            points.append((each["a_deg"], each["d_mm"] or 0))
        lidar.stop_event.set()
        await reading

    asyncio.run(scan())
    lidar.shutdown()
    return None, None, points


def ignore_modem_lines():
    """A pseudo-terminal has none; what the clients do with them cannot be judged here."""
    import serial

    serial.Serial._update_dtr_state = serial.Serial._update_rts_state = lambda self: None


client, port, baud, mode = sys.argv[1:]
ignore_modem_lines()
model, health, points = globals()[f"read_{client}"](port, int(baud), int(mode))
# A pipe holds 64 KiB
points = [(round(angle, 3), round(mm, 2)) for angle, mm in points[-POINTS:]]
print("\n" + json.dumps({"model": model, "health": health, "points": points}), flush=True)
