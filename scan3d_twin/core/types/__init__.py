"""The value types of the package: frozen dataclasses in SI units and radians.

Frames are ``world, odom, base, lidar, scan, target, source``; ``T_a_b`` maps coordinates in b to
coordinates in a. The origin of ``base`` is on the floor below the middle of the axle, x ahead, y
left, z up. Each sweep has a frame ``scan``: its origin is where the robot stood, x points along the
middle of the sweep.
"""

from scan3d_twin.core.types.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    SmallIntArray,
    read_only,
    rms,
    wrap,
    wrap_all,
)
from scan3d_twin.core.types.pose import Pose2
from scan3d_twin.core.types.range_image import Observation, RangeImage
from scan3d_twin.core.types.readings import (
    LOST,
    MIXED,
    UNMEASURED,
    VALID,
    Beams,
    Hazards,
    LidarSpec,
    Odometry,
    ScanLine,
    TableAngle,
)
from scan3d_twin.core.types.results import Candidate, Plan, RegistrationResult
from scan3d_twin.core.types.scan import Scan3D

__all__ = [
    "LOST",
    "MIXED",
    "UNMEASURED",
    "VALID",
    "Beams",
    "BoolArray",
    "Candidate",
    "FloatArray",
    "Hazards",
    "IntArray",
    "LidarSpec",
    "Observation",
    "Odometry",
    "Plan",
    "Pose2",
    "RangeImage",
    "RegistrationResult",
    "Scan3D",
    "ScanLine",
    "SmallIntArray",
    "TableAngle",
    "read_only",
    "rms",
    "wrap",
    "wrap_all",
]
