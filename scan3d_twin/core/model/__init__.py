"""The model of the target: fused cloud, mesh, and its evaluation against the truth."""
