"""Who may see a run and press its buttons: only the reader of the printed address."""

import json
import threading
import urllib.error
import urllib.request
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import urlsplit

import pytest
import viser
from pixels import SMALL

from scan3d_twin.core.errors import LinkError
from scan3d_twin.viz.served.live import open_live_view
from scan3d_twin.viz.served.markdown import as_text
from scan3d_twin.viz.served.server import LOOPBACK, describe_reach, open_server
from scan3d_twin.viz.served.session_view import SessionView

HOSTILE = (
    '"><img src="http://203.0.113.7/a.png"><iframe src=http://203.0.113.7/b></iframe>'
    "![c](http://203.0.113.7/c.png) [d](http://203.0.113.7/d) {globalThis.taken = 1} "
    "<script>globalThis.taken = 1</script> <!-- </script> `e` **f** </title> &lt;g&gt;"
)
"""A name that is markup in HTML, Markdown, JSX and XML at once; the addresses are TEST-NET-3."""


@pytest.fixture
def view():
    """A live view, its address with the token, and what it said."""
    notes = []
    with open_live_view(LOOPBACK, 0, "boxes", "unlimited", notes.append) as opened:
        yield opened, notes[0].removeprefix("live view: ")


def status(url, **headers):
    """Return the status and the body of a request."""
    request = urllib.request.Request(url, headers=headers)
    try:
        with urllib.request.urlopen(request, timeout=30) as answer:
            return answer.status, answer.read()
    except urllib.error.HTTPError as error:
        return error.code, error.read()


def handshake(port, **headers):
    """Return the headers that open the page's socket."""
    return {
        "Host": f"{LOOPBACK}:{port}",
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
        **headers,
    }


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "rebound.example"},
        {"Host": "rebound.example:{port}"},
        {"Origin": "http://127.0.0.1:1"},
        {"Origin": "https://example.org"},
        {"Origin": "null"},
        {"Sec-Fetch-Site": "same-site", "Sec-Fetch-Mode": "no-cors"},
        {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Dest": "iframe", "Sec-Fetch-Mode": "navigate"},
    ],
    ids=str,
)
def test_the_token_alone_is_not_enough(view, headers):
    _, address = view
    sent = {name: each.format(port=urlsplit(address).port) for name, each in headers.items()}
    code, body = status(address, **sent)
    assert code == 403
    assert b"<html" not in body
    assert status(address)[0] == 200


def test_without_the_token_there_is_neither_page_nor_socket(view):
    _, address = view
    place = urlsplit(address)
    bare = f"http://{place.netloc}/"
    for url in (bare, f"{bare}?token=", f"{bare}?token=wrong", f"{bare}?token=%C3%BC"):
        code, body = status(url)
        assert code == 403
        assert b"open the whole address" in body
        assert status(url, **handshake(place.port))[0] == 403
    cookie = f"twin_view_127_0_0_1_{place.port}=" + place.query.removeprefix("token=")
    assert status(bare, Cookie=cookie)[0] == 200
    for others in ('a={"x":1}; ', "a=[1,2]; b; =; ", "\xfc=\xfc; ", f"{cookie[:-1]}; "):
        assert status(bare, Cookie=others + cookie)[0] == 200
        assert status(bare, Cookie=others + "x" + cookie)[0] == 403
    assert status(bare, Cookie=f'{cookie}; a={{"x":1}}')[0] == 200
    assert status(bare, Cookie=cookie, Origin="http://127.0.0.1:1")[0] == 403


def test_a_server_that_does_not_take_the_guard_is_stopped(monkeypatch):
    started = []

    class Unguarded:
        def __init__(self, **_):
            started.append(self)
            self.stopped = False

        def stop(self):
            self.stopped = True

    monkeypatch.setattr(viser, "ViserServer", Unguarded)
    with (
        pytest.raises(LinkError, match="this version of viser cannot be guarded"),
        open_server(LOOPBACK, 0, "a"),
    ):
        pass
    assert [each.stopped for each in started] == [True]


def test_each_view_has_its_own_token():
    with open_server(LOOPBACK, 0, "a") as (_, first), open_server(LOOPBACK, 0, "b") as (_, second):
        token = urlsplit(first).query
        assert len(token) > 24
        assert token != urlsplit(second).query
        assert status(f"http://{urlsplit(second).netloc}/?{token}")[0] == 403


def test_other_machines_need_the_address_and_the_user_is_told():
    assert describe_reach(LOOPBACK) == describe_reach("localhost") == ""
    notes = []
    with open_live_view("0.0.0.0", 0, "boxes", None, notes.append):
        address = notes[0].removeprefix("live view: ")
        assert "every address of this machine to everyone who has this address" in notes[1]
        assert status(address)[0] == 200
        assert status(address.partition("?")[0])[0] == 403
        assert status(address, Host="rebound.example")[0] == 403
        assert status(address, Host="192.0.2.1:8080")[0] == 200


@contextmanager
def other_origin(folder, page):
    """Serve ``page`` from another port of this machine."""
    (folder / "evil.html").write_text(page, encoding="utf-8")

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, *_):
            pass

    with ThreadingHTTPServer((LOOPBACK, 0), partial(Quiet, directory=folder)) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield f"http://{LOOPBACK}:{server.server_port}/evil.html"
        server.shutdown()
        thread.join()


EVIL = """<!doctype html><script>
const place = %s;
const text = url => fetch(url, {credentials: "include"}).then(a => a.text()).catch(() => "");
const opened = protocols => new Promise(done => {
  const socket = new WebSocket("ws://" + place, protocols);
  socket.onopen = () => done("open"); socket.onmessage = () => done("message");
  socket.onerror = socket.onclose = () => done("");
});
const framed = () => new Promise(done => {
  const frame = document.createElement("iframe");
  frame.onload = () => { try { done(frame.contentDocument.title || "") } catch { done("") } };
  frame.src = "http://" + place; document.body.append(frame);
});
const scripted = () => new Promise(done => {
  const script = document.createElement("script");
  script.onload = () => done("loaded"); script.onerror = () => done("");
  script.src = "http://" + place; document.head.append(script);
});
async function attack(version) {
  return [await text("http://" + place), await opened(), await opened([version]),
          await framed(), await scripted()];
}
</script><body></body>"""


def test_a_page_of_another_origin_gets_no_byte_and_presses_no_button(view, open_page, tmp_path):
    import viser

    opened, address = view
    shown = open_page(address, **SMALL)
    shown.page.get_by_role("button", name="Pause").wait_for()
    place = json.dumps(urlsplit(address).netloc)
    with other_origin(tmp_path, EVIL % place) as url:
        evil = shown.page.context.new_page()  # the same browser, with the cookie of the view
        evil.goto(url)
        got = evil.evaluate("version => attack(version)", f"viser-v{viser.__version__}")
    assert got == ["", "", "", "", ""]
    assert len(opened._server.get_clients()) == 1
    assert opened.command() == "go"
    shown.page.get_by_role("button", name="Pause").click()  # the user's own page can
    shown.page.get_by_role("button", name="Continue").wait_for()
    assert opened.command() == "pause"
    shown.page.goto(address.partition("?")[0])  # the cookie keeps the page open
    shown.page.get_by_role("button", name="Continue").wait_for()
    assert shown.errors == []


def test_text_of_a_session_is_shown_and_never_obeyed(session, open_page):
    plans = tuple(replace(plan, reason=HOSTILE) for plan in session.plans)
    named = replace(session, plans=plans, stop_reason=HOSTILE)
    with open_server(LOOPBACK, 0, HOSTILE) as (server, address):
        SessionView(server, HOSTILE, named)
        shown = open_page(address, **SMALL)
        shown.page.get_by_text("**f**").first.wait_for()
        assert shown.page.get_by_text("<iframe src=http").count() >= 2
        assert shown.page.locator("img[src^=http], iframe").count() == 0
        assert shown.page.evaluate("globalThis.taken") is None
        assert (shown.errors, shown.asked) == ([], [])


def test_an_event_of_a_run_is_text_too(view, open_page):
    opened, address = view
    shown = open_page(address, **SMALL)
    opened.on_event(HOSTILE)
    shown.page.get_by_text("**f**").first.wait_for()
    opened.finish(HOSTILE.replace("**f**", "the end"))
    shown.page.get_by_text("the end").first.wait_for()
    assert shown.page.evaluate("globalThis.taken") is None
    assert (shown.errors, shown.asked) == ([], [])


def test_a_text_as_markdown_is_one_line_without_markup():
    assert as_text("front complete, 80 %\n") == "front complete&#44; 80 &#37;"
    assert not set(as_text(HOSTILE)) & set('<>{}[]()*_`!"$\\|~')
