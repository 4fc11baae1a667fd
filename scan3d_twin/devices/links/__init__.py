"""Links between a driver and its device: serial port, socket, pseudo-terminal, line model."""
