"""Fixed arithmetic for all tests, and the options of the tests on a real robot."""

from scan3d_twin.cli.arithmetic import fix_arithmetic

fix_arithmetic()  # before anything loads NumPy: the tests compare bits with those of the program

import pytest  # noqa: E402


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the ports of a real robot, to run the contract on it."""
    group = parser.getgroup("hardware")
    group.addoption("--port", help="Serial port of the real base: run the contract on the robot.")
    group.addoption("--lidar-port", help="Serial port of the real lidar.")
