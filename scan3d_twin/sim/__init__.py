"""The MuJoCo twin: a simulated robot and world behind the hardware interface."""
