"""The devices as bytes: what a robot behind the hardware interface says on its ports."""
