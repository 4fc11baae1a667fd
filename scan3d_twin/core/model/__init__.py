"""The model of the target: fused cloud, mesh, and evaluation against the truth."""
