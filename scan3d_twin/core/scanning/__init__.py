"""From a turning robot to the target's points: sweep, de-skew, gap filling, target, extrinsics."""
