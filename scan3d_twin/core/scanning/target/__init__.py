"""The target: chosen in a panorama, extracted from sweeps, separated from walls."""
