"""The console without a browser: its forms, its guard, the files it serves, and how it ends."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from urllib.parse import urlsplit

import pytest

from scan3d_twin.cli.console.console import Console
from scan3d_twin.cli.console.form import COMMON, OWN, build_command, form_fields
from scan3d_twin.cli.console.server import CHUNK, MAX_BODY, ConsoleServer
from scan3d_twin.core.errors import ConfigError

SOON = 60.0
"""Patience with a busy computer [s]."""
POSTS = ("start", "resume", "pause", "continue", "stop", "check", "compare", "export")


class Client:
    """Asks a console as its page does."""

    def __init__(self, address):
        place = urlsplit(address)
        self.host, self.base = place.netloc, f"http://{place.netloc}/"
        name = "twin_view_" + re.sub(r"[^A-Za-z0-9]", "_", place.netloc)
        self.cookie = f"{name}={place.query.removeprefix('token=')}"

    def ask(self, path, body=None, **headers):
        """Return the status and the body of the answer to a request."""
        data = body if body is None or isinstance(body, bytes) else json.dumps(body).encode()
        sent = {"Cookie": self.cookie, "Content-Type": "application/json", **headers}
        request = urllib.request.Request(self.base + path, data, sent)
        try:
            with urllib.request.urlopen(request, timeout=SOON) as answer:
                return answer.status, answer.read(), answer.headers
        except urllib.error.HTTPError as error:
            return error.code, error.read(), error.headers

    def state(self):
        """Return how the run stands."""
        return json.loads(self.ask("state")[1])["run"]

    def wait(self, wanted):
        """Wait until the run is in a state that ``wanted`` accepts, and return it."""
        until = time.monotonic() + SOON
        while not wanted(run := self.state()):
            assert time.monotonic() < until, run
            time.sleep(0.05)
        return run


@contextmanager
def serving(folder):
    """Serve a console of the runs in ``folder`` within this process."""
    console = Console(folder, 0)
    try:
        with ConsoleServer(console, 0, "a test") as server:
            Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
            yield Client(server.address)
            server.shutdown()
    finally:
        console.close()


@contextmanager
def program(folder):
    """Serve a console as a program of its own."""
    command = [sys.executable, "-m", "scan3d_twin.cli", "console", "--view-port", "0", "--json"]
    with subprocess.Popen(
        command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        yield process, Client(json.loads(process.stdout.readline())["address"])
        process.kill()


@pytest.mark.parametrize("kind", ["sim", "real"])
def test_the_form_has_the_options_of_the_command_and_their_defaults(twin, kind):
    page = " ".join(twin(kind, "--help").out.replace("│", " ").split())
    fields = form_fields(kind)
    flags = {*re.findall(r" (--[a-z-]+) (?:[A-Z]+ )?", page)}
    own = {"--" + name.replace("_", "-") for name in OWN}
    assert {field.flag for field in fields} == flags - own - {"--planning"}
    assert [field.name for field in fields[: len(COMMON[kind])]] == list(COMMON[kind])
    for field in fields:
        row = page.partition(f" {field.flag} ")[2]
        shown = re.match(r".*?(?= --[a-z-]+ | ╰)", row)[0]
        assert field.help in shown
        assert not field.default or f"[default: {field.default}]" in shown
        assert not field.choices or f"[choices: {', '.join(field.choices)}]" in shown
    known = {field.name: field.suggestions for field in fields}
    assert "create2" in known["robot"]
    assert "fisher" in known["planner"]


def test_a_default_that_a_variable_sets_is_the_one_shown(monkeypatch):
    form_fields.cache_clear()
    monkeypatch.setenv("TWIN_EPSILON", "7")
    shown = {field.name: field.default for field in form_fields("sim")}
    form_fields.cache_clear()
    assert shown["epsilon"] == "7 (TWIN_EPSILON)"


def test_a_filled_form_is_a_command_line():
    filled = {"epsilon": " 5 ", "scene": "", "target": "-1,2"}
    more = "--planning.trials 5 --sweep.width='1.2'"
    assert build_command("sim", filled, more, ["--out", "a"]) == (
        "sim", "--epsilon=5", "--target=-1,2", "--planning.trials", "5", "--sweep.width=1.2",
        "--out", "a",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "values", "more", "words"),
    [
        ("bench", {}, "", "no run of the kind 'bench'"),
        ("sim", {"port": "/dev/ttyUSB0"}, "", "no option 'port'"),
        ("sim", {"out": "/etc"}, "", "no option 'out'"),
        ("sim", {"seed": 3}, "", "--seed: not a text"),
        ("sim", {"scene": "a\nb"}, "", "--scene: more than"),
        ("sim", {"scene": "a" * 401}, "", "--scene: more than"),
        ("sim", {}, "--host 0.0.0.0", "--host is not for this page"),
        ("sim", {}, "--view_port=1", "--view_port is not for this page"),
        ("sim", {}, "--help", "--help is not for this page"),
        ("sim", {}, "-h", "-h is not for this page"),
        ("sim", {}, "--planning.trials '5", "more options: no closing quotation"),
    ],
)
def test_what_is_no_option_here_is_refused_in_a_line(kind, values, more, words):
    with pytest.raises(ConfigError, match=re.escape(words)) as error:
        build_command(kind, values, more, [])
    assert "\n" not in str(error.value)


def test_nobody_else_may_ask_or_do_anything(tmp_path):
    with serving(tmp_path) as client:
        assert client.ask("state")[0] == 200
        refused = (
            {"Cookie": ""}, {"Cookie": client.cookie[:-1]}, {"Host": "rebound.example"},
            {"Origin": "http://127.0.0.1:1"}, {"Origin": "null"}, {"Sec-Fetch-Site": "cross-site"},
        )  # fmt: skip
        for headers in refused:
            for path in ("", "state", "runs", "console.js", "run/a/report.json"):
                assert client.ask(path, **headers)[0] == 403, (path, headers)
            for path in POSTS:
                code, body, _ = client.ask(
                    path, {"kind": "sim", "options": {}, "more": ""}, **headers
                )
                assert code == 403, (path, headers)
                assert b"{" not in body
        assert client.state() is None
        code, page, headers = client.ask("")
        assert code == 200
        assert "script-src 'self';" in headers["Content-Security-Policy"]
        assert b"a test" in page


WRONG = [
    ("start", b"", 400),
    ("start", b"[]", 400),
    ("start", b"{", 400),
    ("start", b"[" * 5000, 400),
    ("start", b" " * (MAX_BODY + 1), 400),
    ("start", {"kind": "sim", "options": []}, 400),
    ("start", {"kind": 1, "options": {}, "more": ""}, 400),
    ("start", {"kind": "sim", "options": {"scene": "\ud800"}, "more": ""}, 400),
    ("pause", {}, 409),
    ("stop", {}, 409),
    ("resume", {"run": "../other"}, 404),
    ("export", {"run": "none", "format": "ply"}, 404),
    ("export", {"run": "run", "format": "exe"}, 400),
    ("compare", {"runs": ["run", {"a": 1}]}, 404),
    ("nothing", {}, 404),
    ("console.js", {}, 404),
]
"""Requests that are refused: path, body and status."""


def test_a_wrong_request_is_refused_in_a_line(finished):
    with serving(finished[0].parent) as client:
        for path, body, code in WRONG:
            got, answer, _ = client.ask(path, body)
            error = json.loads(answer)["error"]
            assert got == code, (path, body)
            assert "\n" not in error
            assert len(error) > 8
        assert client.state() is None


def test_what_is_no_request_is_refused_without_a_traceback(tmp_path, capfd):
    with serving(tmp_path) as client:
        host, _, port = client.host.rpartition(":")
        known = f"Host: {client.host}\r\nCookie: {client.cookie}\r\n".encode()
        for sent in (
            b"\x00\xff\r\n\r\n",
            b"GET\r\n\r\n",
            b"GET / HTTP/9.9\r\n\r\n",
            b"DELETE /runs HTTP/1.1\r\n" + known + b"\r\n",
            b"GET /state HTTP/1.1\r\n" + known + known + b"\r\n",
            b"GET /state HTTP/1.1\r\nHost : x\r\n\r\n",
            b"GET /state HTTP/1.1\r\nX: " + b"a" * 70_000 + b"\r\n\r\n",
            b"POST /nothing HTTP/1.1\r\nContent-Length: 9\r\n" + known + b"\r\nGET /sta\r\n\r\n",
            b"GET /run/%00/%00 HTTP/1.1\r\n" + known + b"\r\n",
        ):
            with socket.create_connection((host, int(port)), timeout=SOON) as link:
                link.sendall(sent)
                link.shutdown(socket.SHUT_WR)
                answer = b"".join(iter(lambda: link.recv(65_536), b""))
            assert b" 200 " not in answer, sent[:40]
            assert answer.count(b"HTTP/1.1 ") <= 1, sent[:40]
        assert client.ask("state")[0] == 200
    assert capfd.readouterr().err == ""


def test_only_files_of_runs_are_served_and_none_of_them_has_the_page_s_rights(finished, tmp_path):
    runs = tmp_path / "runs"
    run = runs / "a <b>"
    run.mkdir(parents=True)
    (run / "report.json").write_text((finished[0] / "report.json").read_text())
    (run / "report.html").write_text("<script>1</script>")
    model = b"ply" + bytes(2 * CHUNK)
    (run / "model.ply").write_bytes(model)
    (run / ".hidden").write_text("x")
    (tmp_path / "secret").write_text("secret")
    (run / "link.ply").symlink_to(tmp_path / "secret")
    os.mkfifo(run / "pipe")
    with serving(runs) as client:
        (listed,) = json.loads(client.ask("runs")[1])["runs"]
        assert listed["name"] == "a <b>"
        assert listed["files"] == ["model.ply", "report.html", "report.json"]
        assert listed["cells"][0] == "2"
        code, page, headers = client.ask("run/a%20%3Cb%3E/report.html")
        assert (code, page) == (200, b"<script>1</script>")
        assert headers.get_all("Content-Security-Policy")[0].startswith("sandbox allow-scripts")
        assert "allow-same-origin" not in headers["Content-Security-Policy"]
        code, content, headers = client.ask("run/a%20%3Cb%3E/model.ply")
        assert code == 200
        assert content == model
        assert headers["Content-Disposition"] == 'attachment; filename="model.ply"'
        for name in ("link.ply", "pipe", ".hidden", "..%2f..%2fsecret", "../../secret", "", "none"):
            code, content, _ = client.ask(f"run/a%20%3Cb%3E/{name}")
            assert code == 404, name
            assert b'"error"' in content
        assert client.ask("run/../secret")[0] == client.ask("compare.html")[0] == 404


def test_the_robot_is_checked_as_by_twin_doctor(tmp_path):
    with serving(tmp_path) as client:
        asked = {"port": str(tmp_path / "no_base"), "lidar_port": str(tmp_path / "no_lidar")}
        code, answer, _ = client.ask("check", {"options": {**asked, "seed": "1"}})
        found = {each["what"]: each for each in json.loads(answer)["findings"]}
        assert code == 200
        assert found["libraries"]["ok"]
        assert not found["base port"]["ok"]
        assert "no_base does not exist" in found["base port"]["found"]


def test_a_port_in_use_is_one_line(tmp_path, fails):
    with serving(tmp_path) as client:
        port = client.host.rpartition(":")[2]
        assert "cannot serve" in fails(3, "console", "--view-port", port)


def test_an_error_of_the_command_line_is_the_one_shown(tmp_path):
    with serving(tmp_path / "runs") as client:
        form = {"kind": "sim", "options": {"scene": "no_such_scene"}, "more": ""}
        assert client.ask("start", form)[0] == 200
        run = client.wait(lambda run: run["over"])
        assert run["state"] == "failed"
        assert run["error"].startswith("no scene 'no_such_scene'; ")
        assert client.ask("runs")[1] == b'{"runs": []}'


@pytest.mark.slow
def test_where_the_console_ends_or_is_killed_its_run_ends_in_the_orderly_way(tmp_path):
    form = {"kind": "sim", "options": {"epsilon": "100"}, "more": "--sweep.width 0.4"}
    ended, killed = tmp_path / "ended", tmp_path / "killed"
    ended.mkdir()
    killed.mkdir()
    with program(ended) as (process, client), program(killed) as (other, second):
        for each in (client, second):
            assert each.ask("start", form)[0] == 200
            assert each.ask("start", form)[0] == 409

        # Killed before the first view: its run leaves nothing
        second.wait(lambda run: run["live_view"])
        (folder,) = killed.glob("runs/*")
        other.kill()

        # Ended after it: the view is saved
        client.wait(lambda _: any(ended.glob("runs/*/views/000.npz")))
        process.send_signal(signal.SIGTERM)
        assert process.wait(SOON) == 0
        assert process.stderr.read() == "stopping the run; its finished views are saved\n"
    (report,) = ended.glob("runs/*/report.json")
    assert json.loads(report.read_text())["stop_reason"] == "interrupted"
    until = time.monotonic() + SOON
    while folder.exists():
        assert time.monotonic() < until
        time.sleep(0.05)


def test_a_folder_s_name_is_made_of_any_scene(tmp_path):
    from scan3d_twin.cli.console.console import _as_name

    assert _as_name("three_boxes") == "three_boxes"
    assert _as_name("random:3") == "random-3"
    assert _as_name("../../a b/.chair.v2.stl") == "chair.v2"
    assert _as_name("..") == _as_name("///") == "scene"
    assert len(_as_name("x" * 300)) == 60
    assert Path(_as_name("a/b")).name == "b"
