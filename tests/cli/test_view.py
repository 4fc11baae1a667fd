import json
import signal
import subprocess
import sys
import urllib.request

from short_runs import ONE_VIEW

from scan3d_twin.cli import main


def test_a_run_is_served_on_this_machine_until_ctrl_c(finished):
    command = [sys.executable, "-m", "scan3d_twin.cli", "view", finished[0], "--view-port", "0"]
    with subprocess.Popen([*command, "--json"], stdout=subprocess.PIPE, text=True) as process:
        told = json.loads(process.stdout.readline())
        assert told["views"] == 2
        assert told["address"].startswith("http://127.0.0.1:")
        page = urllib.request.urlopen(told["address"], timeout=30).read()
        assert b"<html" in page.lower()
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0
        assert process.stdout.read() == ""


def test_a_folder_without_a_run_is_no_view(fails):
    assert "no session in nowhere" in fails(3, "view", "nowhere")


def test_a_run_may_be_watched_by_nobody(twin, tmp_path):
    result = twin(*ONE_VIEW, "--view", "--view-port", "0", "--out", "run")
    assert result.code == 0
    assert (tmp_path / "run" / "model.ply").is_file()
    assert "live view: http://127.0.0.1:" in result.err
    assert "stays until" not in result.err


def test_help_of_a_run_names_the_live_view(capfd):
    main(["real", "--help"])
    words = capfd.readouterr().out
    assert "--view-port" in words
    assert "--host" in words
