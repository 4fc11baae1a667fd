"""From a turning robot to a clean image: sweep, de-skew, gap filling, target, extrinsics."""
