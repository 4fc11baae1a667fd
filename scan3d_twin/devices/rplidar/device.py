"""Descriptions of the RPLIDAR A1, C1 and S2 for the device registry.

The errors of the twin: an A1 triangulates, so that its noise grows with the distance; a C1 and an
S2 measure the time of flight. A value without a source is an assumption.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from scan3d_twin.core.hal import Clock, Lidar
from scan3d_twin.devices.device import LidarDevice, LidarSensor, Wiring
from scan3d_twin.devices.links.line_format import BITS_PER_BYTE
from scan3d_twin.devices.links.transport import Transport
from scan3d_twin.devices.rplidar import model as rplidar
from scan3d_twin.devices.rplidar.capsules import CAPSULE_LENGTH
from scan3d_twin.devices.rplidar.driver import RplidarLidar, line_spec
from scan3d_twin.devices.rplidar.emulator import RplidarEmulator
from scan3d_twin.devices.rplidar.model import SAMPLES, RplidarModel
from scan3d_twin.devices.rplidar.probe import PROBE

BLACK = 0.1
"""Reflectance of what the data sheets call black."""
CP2102 = {"10c4:ea60": "Slamtec (CP210x)"}
"""USB id of the adapter that comes with each of them."""

# What the firmware of the URG-04LX does to its readings, these do not.
_PLAIN: Mapping[str, float | bool] = {
    "running_median": False,
    "neighbours": 0.0,
    "repeats": 0.0,
    "glitch": 0.0,
    "bias": 0.0,
    "stamp_step": 0.0,
    "period_error": 0.0,
    # Jitter of a turn: S3, 3180 to 3208 samples a turn, .3 % (rplidar_ros#104).
    "jitter": 0.0003,
    # Assumption: what a weak return adds to the noise is in sigma.
    "sigma_weak": 0.0,
    # What is lost is too dark or too far: dark walls lose a third of an A2's (rplidar_ros#13).
    "dropout": 0.0,
    "saturation": 1e12,
    # The offset of a unit, which does not decay; its size is stated below.
    "warm_up_time": 1e6,
}


def _threshold(black_reach: float) -> float:
    """Return the weakest power that is detected, so that black is seen up to a distance [m]."""
    return BLACK / math.pi / black_reach**2


_A1_ERRORS = {
    # One A1M8 on a flat board 1181 mm away: 6 mm too far, one unit (donkeycar#914); within the 1 %
    # of the data sheet.
    "warm_up": 0.006,
    # Assumption, as of the URG-04LX.
    "surface_bias": 0.003,
    # Angle corrections come in steps of 1/8 deg: a uniform error of that width.
    "pointing": math.radians(0.125) / math.sqrt(12.0),
    # A white surface of 90 % is seen to the 12 m of the data sheet: black to 4 m.
    "threshold": _threshold(12.0 * math.sqrt(BLACK / 0.9)),
    # Assumption: a spot of 12 mm at 2 m.
    "footprint_along": 0.003,
    "footprint_across": 0.003,
    # Assumption; the motor has no controller, its speed depends on voltage and wear.
    "revolution": 0.01,
}
_TOF_ERRORS = {
    # Shares of the +-30 mm of the data sheets, see TOF_NOISE.
    "warm_up": 0.005,
    "surface_bias": 0.003,
    # Assumption.
    "pointing": 0.001,
    "footprint_along": 0.0045,
    "footprint_across": 0.0045,
    # A motor with a controller; .9 % of the length of turns of an S3 (rplidar_ros#104).
    "revolution": 0.005,
}
_ERRORS: Mapping[str, Mapping[str, float | bool]] = {
    rplidar.A1.name: _A1_ERRORS,
    # Data sheet: 6 m on black.
    rplidar.C1.name: {**_TOF_ERRORS, "threshold": _threshold(6.0)},
    # kaiaai/awesome-2d-lidars: 10 m on black.
    rplidar.S2.name: {**_TOF_ERRORS, "threshold": _threshold(10.0)},
}


def _line_latency(model: RplidarModel) -> float:
    """Return the time from the beginning of a turn to the arrival of its line [s].

    The last capsule of a turn is known when it and the head of the next one have been sent.
    """
    mode = next(iter(model.modes.values()))
    frame = SAMPLES[mode.reply] * mode.sample_us * 1e-6
    return 1.0 / model.turns + 2 * frame + CAPSULE_LENGTH * BITS_PER_BYTE / model.baud


def _describe(model: RplidarModel, summary: str) -> LidarDevice:
    """Return the description of a ``model``."""

    def open_driver(
        open_transport: Callable[[], Transport], clock: Clock, link: str | None = None
    ) -> RplidarLidar:
        wanted = model.modes.values() if link is None else (model.modes[link],)
        return RplidarLidar(open_transport, clock, model, tuple(wanted))

    def emulate(lidar: Lidar, wiring: Wiring) -> RplidarEmulator:
        return RplidarEmulator(lidar, model)

    noise = {"sigma": model.noise.constant, "sigma_per_metre": model.noise.per_metre}
    errors = {**_PLAIN, **noise, **_ERRORS[model.name], "latency": _line_latency(model)}
    return LidarDevice(
        name=model.name,
        summary=summary,
        links=tuple(model.modes),
        spec=lambda link: line_spec(model, model.modes[link]),
        sensor=LidarSensor(
            min_range_mm=model.min_range_mm, max_range_mm=model.max_range_mm, drops_isolated=False
        ),
        open_driver=open_driver,
        emulate=emulate,
        # A USB adapter with a real serial line behind it.
        usb_links=(),
        usb_ids=CP2102,
        bauds=(model.baud,),
        sample_rate=lambda link: model.modes[link].sample_rate,
        probe=PROBE,
        describe=describe_rplidar,
        # No log of one tells the noise of single readings.
        options={"lidar": errors, "registration": {"reading_sigma": 0.0}},
    )


def describe_rplidar(lidar: RplidarLidar) -> str:
    """Return model, firmware, serial number, scan mode and health in one line."""
    device, mode = lidar.info.device, lidar.info.mode
    major, minor = device.firmware
    known = rplidar.MODELS.get(device.major_id)
    title = f"model {device.model:#x}" if known is None else known.title
    health = ("good", "warning", "error")[lidar.info.health.status]
    return (
        f"{title}, firmware {major}.{minor:02d}, hardware {device.hardware}, serial number "
        f"{device.serial.hex().upper()}, scan mode {mode.name} at {mode.sample_rate:.0f} Hz, "
        f"health {health}"
    )


RPLIDAR_A1 = _describe(
    rplidar.A1, "Slamtec RPLIDAR A1: 3937 readings/s all round at 7.4 Hz, 0.15 to 12 m"
)
RPLIDAR_C1 = _describe(
    rplidar.C1, "Slamtec RPLIDAR C1: 5000 readings/s all round at 10 Hz, 0.05 to 12 m"
)
RPLIDAR_S2 = _describe(
    rplidar.S2, "Slamtec RPLIDAR S2: 32000 readings/s all round at 10 Hz, 0.05 to 30 m"
)
