"""The limit of processor time that tests/conftest.py puts on every test."""

import subprocess
import sys
from pathlib import Path

CONFTEST = Path(__file__).with_name("conftest.py")
BUSY = """
import time

def test_busy():
    while True:
        pass

def test_waiting():
    time.sleep(1.0)
"""


def test_a_busy_test_fails_and_a_waiting_one_does_not(tmp_path):
    (tmp_path / "conftest.py").write_text(CONFTEST.read_text())
    (tmp_path / "test_it.py").write_text(BUSY)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:dash"]
    result = subprocess.run(
        [*command, "-o", "cpu_limit=0.3", str(tmp_path)],
        cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert "1 failed, 1 passed" in result.stdout
    assert "took more than 0.3 s of processor time" in result.stdout
