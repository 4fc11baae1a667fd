"""lds2d reads four revolutions of a lidar; prints the points of all but the first."""

import json
import sys
from itertools import islice

from lds2d import Lidar

lidar = Lidar.open(sys.argv[1], sys.argv[2])
scans = list(islice(lidar.scans(), 4))[1:]
rows = [[[p.angle_deg, p.dist_mm, p.quality] for p in scan] for scan in scans]
print(json.dumps([scans[-1].scan_freq_hz, rows]), flush=True)
