"""The devices as bytes: what a robot behind the hardware interface would say on its serial ports."""
