"""What a package of your own needs for a planner, an export format, a lidar or a base.

These names are public, as those of ``scan3d_twin`` are: documented and versioned. docs/extending.md
shows each of them at work. Robots, configurations and results are in ``scan3d_twin``.
"""

from scan3d_twin.core.errors import (
    ConfigError,
    HazardError,
    LinkError,
    LinkTimeoutError,
)
from scan3d_twin.core.hal import BaseSpec, Clock, DriveBase, Lidar, Turntable, TurntableSpec
from scan3d_twin.core.line_grid import arrange_line, make_full_circle
from scan3d_twin.core.model.mesh import Mesh
from scan3d_twin.core.navigation.odometry import DeadReckoning
from scan3d_twin.core.navigation.wheel_kinematics import split_velocity
from scan3d_twin.core.options import number
from scan3d_twin.core.planning.candidates.hidden_views import termination_plan
from scan3d_twin.core.planning.context import PlanningContext
from scan3d_twin.core.planning.overlap_or_default import plan_with_overlap
from scan3d_twin.core.types import (
    VALID,
    Beams,
    Hazards,
    LidarSpec,
    Odometry,
    ScanLine,
    TableAngle,
    read_only,
)
from scan3d_twin.devices.device import (
    BaseDevice,
    BaseDriver,
    ErrorCodes,
    Finding,
    LidarDevice,
    LidarDriver,
    LidarProbe,
    LidarSensor,
    TurntableDevice,
    TurntableDriver,
    Wiring,
)
from scan3d_twin.devices.links.guard import Guard
from scan3d_twin.devices.links.line_model import Device
from scan3d_twin.devices.links.transport import Transport
from scan3d_twin.devices.rotating import BeamReader, Revolutions, to_elevation
from scan3d_twin.recording.export.format import CloudFormat, MeshFormat, RecordingFormat
from scan3d_twin.recording.export.piece import Piece
from scan3d_twin.wired import open_wired

__all__ = [
    "VALID",
    "BaseDevice",
    "BaseDriver",
    "BaseSpec",
    "BeamReader",
    "Beams",
    "Clock",
    "CloudFormat",
    "ConfigError",
    "DeadReckoning",
    "Device",
    "DriveBase",
    "ErrorCodes",
    "Finding",
    "Guard",
    "HazardError",
    "Hazards",
    "Lidar",
    "LidarDevice",
    "LidarDriver",
    "LidarProbe",
    "LidarSensor",
    "LidarSpec",
    "LinkError",
    "LinkTimeoutError",
    "Mesh",
    "MeshFormat",
    "Odometry",
    "Piece",
    "PlanningContext",
    "RecordingFormat",
    "Revolutions",
    "ScanLine",
    "TableAngle",
    "Transport",
    "Turntable",
    "TurntableDevice",
    "TurntableDriver",
    "TurntableSpec",
    "Wiring",
    "arrange_line",
    "make_full_circle",
    "number",
    "open_wired",
    "plan_with_overlap",
    "read_only",
    "split_velocity",
    "termination_plan",
    "to_elevation",
]
