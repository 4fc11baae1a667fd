"""The MuJoCo twin: a robot behind the hardware interface, in a simulated world."""
