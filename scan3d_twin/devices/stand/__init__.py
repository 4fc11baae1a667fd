"""A stand: a base without wheels, on which a turntable turns the lidar."""

BASES = {"stand": "STAND"}
