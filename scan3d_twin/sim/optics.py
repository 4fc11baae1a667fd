"""What comes back of the lidar's light: power, noise and bias of a reading.

Light and receiver coincide (monostatic), so the half vector is the view. Power per beam, in units
of a white diffuse surface facing the sensor at 1 m times 1 / pi:

    P = (rho / pi * cos + F0 * D * G1^2 / (4 * cos)) / r^2

with diffuse reflectance rho, normal reflectance F0 and the GGX distribution D and Smith shadowing
G1 (Walter et al. 2007, eq. 33 and 34) of alpha = roughness^2. Metals have no diffuse part, so a
shiny curved metal returns only from where it faces the sensor: the paper's Fig. 6a.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from scan3d_twin.core.types import BoolArray, FloatArray, IntArray
from scan3d_twin.sim.config import LidarModelConfig

SPEED_OF_LIGHT = 299_792_458.0
MODULATION = 46.55e6
"""Frequency of the light's modulation [Hz]; URG-04LX, the higher of its two."""
F0_DIELECTRIC, F0_METAL = 0.04, 0.90
"""Reflectance at normal incidence of plastics, and of aluminium or chrome near 785 nm."""


@dataclass(frozen=True)
class Materials:
    """Optical properties by geom id; the last row is the robot itself.

    Attributes:
        diffuse: rho (n_geoms + 1,).
        specular: F0 (n_geoms + 1,).
        alpha: GGX roughness (n_geoms + 1,).
    """

    diffuse: FloatArray
    specular: FloatArray
    alpha: FloatArray

    @staticmethod
    def of(model: Any, config: LidarModelConfig) -> Materials:
        """Read ``metallic`` and ``roughness`` of each geom's material; unset (-1) is matte.

        MuJoCo's ``specular`` and ``shininess`` cannot serve: by default all things shine.
        """
        metallic = np.zeros(model.ngeom + 1)
        roughness = np.full(model.ngeom + 1, config.roughness)
        for geom, material in enumerate(model.geom_matid):
            if material >= 0:
                metallic[geom] = max(0.0, float(model.mat_metallic[material]))
                if model.mat_roughness[material] >= 0:
                    roughness[geom] = max(0.01, float(model.mat_roughness[material]))
        return Materials(
            diffuse=(1 - metallic) * config.albedo,
            specular=F0_DIELECTRIC * (1 - metallic) + F0_METAL * metallic,
            alpha=roughness**2,
        )

    def power(self, geoms: IntArray, cosines: FloatArray, distances: FloatArray) -> FloatArray:
        """Return P (n,) of hits on ``geoms`` at incidence ``cosines`` and ``distances`` [m]."""
        cos = np.clip(np.abs(cosines), 1e-3, 1.0)
        alpha2 = self.alpha[geoms] ** 2
        ggx = alpha2 / (math.pi * (cos**2 * (alpha2 - 1) + 1) ** 2)
        g1 = 2 * cos / (cos + np.sqrt(alpha2 + (1 - alpha2) * cos**2))
        specular = self.specular[geoms] * ggx * g1**2 / (4 * cos)
        result: FloatArray = (self.diffuse[geoms] / math.pi * cos + specular) / distances**2
        return result


def detected(power: FloatArray, normals: FloatArray, config: LidarModelConfig) -> BoolArray:
    """Return which returns of ``power`` (n,) are detected, given standard normal draws (n,)."""
    if config.threshold == 0:
        return np.isfinite(power)
    margin = np.log(np.maximum(power, 1e-12) / config.threshold) / config.softness
    result: BoolArray = normals < margin
    return result


def perturbed(
    distances: FloatArray, power: FloatArray, normals: FloatArray, config: LidarModelConfig
) -> FloatArray:
    """Return ``distances`` (n,) [m] with noise (standard normal draws (n,)) and cyclic bias."""
    weak = np.sqrt(np.minimum(1.0, config.threshold / np.maximum(power, 1e-12)))
    sigma = np.hypot(config.sigma + config.sigma_per_metre * distances, config.sigma_weak * weak)
    bias = config.bias * np.sin(8 * math.pi * MODULATION * distances / SPEED_OF_LIGHT)
    result: FloatArray = distances + bias + sigma * normals
    return result
