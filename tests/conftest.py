import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("hardware")
    group.addoption("--port", help="Serial port of the real base: run the contract on the robot.")
    group.addoption("--lidar-port", help="Serial port of the real lidar.")
