"""Register two scans
==================

Registration alone, with a covariance that says how far to believe the result.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

import scan3d_twin as s3d

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp(prefix="scan3d_twin-"))

# %%
# Two views of a wavy box. Sweeps, clouds (``Scan3D``) and arrays of points (n, 3) can be
# registered.

with s3d.open_sim("sine_box", seed=0) as (robot, _):
    session = s3d.digitize(robot, s3d.Config(max_views=2))
first, second = session.views
print(f"{len(first.target)} and {len(second.target)} points on the target")

# %%
# The first guess is off by 3 cm and 1 degree.

known = (first.T_world_scan.inverse() @ second.T_world_scan).matrix()
guess = known @ s3d.Pose2(0.03, -0.02, np.radians(1.0)).matrix()
result = s3d.register(first.image, second.image, init_T_target_source=guess)
print("converged:", result.converged)
print(f"expected displacement of the points: {1000 * result.predicted_rmse:.1f} mm")

# %%
# Standard deviations of x and y, and what the data could not determine: nothing here.

sigma_x, sigma_y = 1000 * np.sqrt(np.diag(result.covariance)[:2])
print(f"sigma: {sigma_x:.1f} mm and {sigma_y:.1f} mm")
print("directions without information:", len(result.degenerate_directions))

# %%
# The result as a matrix: ``T_target_source`` maps the second scan into the first.

np.savetxt(folder / "T_target_source.txt", result.T_target_source, fmt="%.6f")
print(np.round(result.T_target_source, 3))

# %%
# A bare wall is different: along it nothing holds the scans, and the covariance says so.

y, z = np.meshgrid(np.linspace(-0.8, 0.8, 80), np.linspace(-0.3, 0.3, 30))
wall = np.stack([np.full_like(y, 1.5), y, z], axis=-1).reshape(-1, 3)
result = s3d.register(wall, wall + np.array([0.01, 0.0, 0.0]))
print("directions without information:", len(result.degenerate_directions))

# sphinx_gallery_thumbnail_path = 'images/registration_overlay.svg'
