"""Signals that end the program during a sweep: it stops, and what was scanned is saved."""

import json
import os
import signal
import subprocess
import sys

import jsonschema
import pytest
from short_runs import COARSE

import scan3d_twin.cli.app as program
from scan3d_twin.cli import signals
from scan3d_twin.recording.load import load_session
from scan3d_twin.run.report import report_schema


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["SIGINT", "SIGTERM"])
def test_a_signal_during_a_sweep_saves_the_finished_views(tmp_path, number):
    command = [sys.executable, "-m", "scan3d_twin.cli", "sim", "--scene", "sine_box", "--json"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    command += [*COARSE, "--out", str(tmp_path / "run")]
    with subprocess.Popen(command, **pipes) as process:
        seen = ""
        for line in process.stderr:
            seen += line
            if "view 0:" in seen and line.startswith("scanning"):
                break
        process.send_signal(number)
        out, rest = process.communicate(timeout=60)
    assert process.returncode == 130, seen + rest
    assert rest.splitlines()[-1].startswith("error: interrupted; finished views: 1, saved in ")
    assert "Traceback" not in rest
    report = json.loads(out)
    jsonschema.validate(report, report_schema())
    assert report["stop_reason"] == "interrupted"
    assert report["views"] == 1
    assert json.loads((tmp_path / "run" / "report.json").read_text()) == report
    names = {path.name for path in (tmp_path / "run").rglob("*") if path.is_file()}
    assert names == {
        "model.ply", "report.json", "report.html", "top_view.svg", "config.toml", "session.mcap",
        "scene.png", "000.npz",
    }  # fmt: skip
    recorded = load_session(tmp_path / "run")
    assert (recorded.finished, recorded.session.stop_reason) == (True, "interrupted")


def test_a_closed_terminal_saves_the_finished_views(tmp_path):
    """As ssh closes it: nobody reads any more, and SIGHUP comes twice."""
    ours, theirs = os.openpty()
    command = [sys.executable, "-m", "scan3d_twin.cli", "sim", "--scene", "sine_box"]
    command += ["--sweep.width", "0.8", *COARSE]
    lead = "import fcntl, os, sys, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0);"
    lead += "os.execv(sys.argv[1], sys.argv[1:])"
    with subprocess.Popen(
        [sys.executable, "-c", lead, *command, "--out", str(tmp_path / "run")],
        stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True,
        env={**os.environ, "TERM": "xterm"},
    ) as process:  # fmt: skip
        os.close(theirs)
        seen = b""
        while b"scanning" not in seen.partition(b" scanned")[2]:
            seen += os.read(ours, 4096)
        os.close(ours)
        process.send_signal(signal.SIGHUP)
        assert process.wait(60) == 130
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    assert (report["stop_reason"], report["views"]) == ("interrupted", 1)
    assert load_session(tmp_path / "run").finished


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGQUIT])
def test_a_signal_before_the_first_view_leaves_nothing_behind(tmp_path, number):
    command = [sys.executable, "-m", "scan3d_twin.cli", "sim", "--out", str(tmp_path / "run")]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr.readline() != ""
        process.send_signal(number)
        _, rest = process.communicate(timeout=60)
    assert process.returncode == 130
    assert rest.splitlines()[-1] == "error: interrupted"
    assert not (tmp_path / "run").exists()


LEAVES_EXEC = """
import os, signal, sys
from scan3d_twin.cli import app as program
def interrupted(*_, **__):
    exec("import os, signal; os.kill(os.getpid(), signal.SIGINT)")
program.app = interrupted
sys.exit(program.main(["sim"]))
"""


def test_a_signal_inside_exec_ends_with_the_exit_code_of_an_interrupt(tmp_path):
    """With -m, Python 3.11 ends by SIGINT where a plain KeyboardInterrupt once left an exec."""
    (tmp_path / "interrupted.py").write_text(LEAVES_EXEC)
    done = subprocess.run(
        [sys.executable, "-m", "interrupted"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (130, "error: interrupted\n")


def test_an_interrupt_that_python_has_wrapped_is_one(monkeypatch, capsys):
    def wrapped(*_, **__):
        raise RuntimeError("Error calling __set_name__") from KeyboardInterrupt()

    monkeypatch.setattr(program, "app", wrapped)
    assert program.main(["sim"]) == 130
    assert capsys.readouterr().err == "error: interrupted\n"


@pytest.fixture
def handler():
    """The handler of the ending signals; those of the tests come back afterwards."""
    before = {number: signal.getsignal(number) for number in signals.ENDING}
    signals.catch_ending_signals()
    yield signal.getsignal(signal.SIGTERM)
    for number, each in before.items():
        signal.signal(number, each)


def test_a_signal_that_comes_in_pairs_interrupts_once_and_ctrl_c_always(handler, monkeypatch):
    now = [100.0]
    monkeypatch.setattr(signals.time, "monotonic", lambda: now[0])
    with pytest.raises(KeyboardInterrupt):
        handler(signal.SIGHUP, None)
    handler(signal.SIGHUP, None)
    handler(signal.SIGTERM, None)
    with pytest.raises(KeyboardInterrupt):
        handler(signal.SIGINT, None)
    now[0] += signals.REPEATED + 0.1
    with pytest.raises(KeyboardInterrupt):
        handler(signal.SIGTERM, None)


def test_a_hang_up_that_is_ignored_stays_ignored(handler):
    """So does ``nohup`` start the program."""
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signals.catch_ending_signals()
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
