"""The viewer answers the page whose address was printed, and nobody else; of that page it takes what it may send."""

from __future__ import annotations

import http.client
import socket
import threading
import time
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest
import viser
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.sync.connection import Connection
from websockets.typing import Origin, Subprotocol

from hrl_escape.viewer.pages.play import MOST_WAITING, PlayPage
from hrl_escape.viewer.play.commands import Command
from hrl_escape.viewer.play.episode import Episode
from hrl_escape.viewer.server import Server, is_expected, open_server

CAMERA = {"type": "ViewerCameraMessage", "wxyz": (1, 0, 0, 0), "position": (0, -20, 20), "fov": 0.9, "near": 0.1,
          "far": 100.0, "image_height": 800, "image_width": 900, "look_at": (0, 0, 0), "up_direction": (0, 0, 1)}
OWN = "own"


def fetch(server: Server, path: str = "/", host: str = OWN, **headers: str) -> tuple[int, Any, bytes]:
    """Status, headers and body of a request."""
    port = server.get_port()
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=600)
    try:
        connection.putrequest("GET", path, skip_host=True)
        connection.putheader("Host", f"127.0.0.1:{port}" if host == OWN else host.format(port=port))
        for name, value in headers.items():
            connection.putheader(name, value.format(port=port))
        connection.endheaders()
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read()
    finally:
        connection.close()


def open_socket(server: Server, query: str = OWN, origin: str | None = OWN, host: str = OWN, cookie: str = ""
                ) -> Connection:
    port = server.get_port()
    name = f"127.0.0.1:{port}" if host == OWN else host.format(port=port)
    query = f"?token={server.guard.token}" if query == OWN else query
    source = None if origin is None else Origin(f"http://{name}" if origin == OWN else origin.format(port=port))
    dialled = socket.create_connection(("127.0.0.1", port))
    return connect(f"ws://{name}/{query}", sock=dialled, origin=source, max_size=None, compression=None,
                   subprotocols=[Subprotocol(f"viser-v{viser.__version__}")],
                   additional_headers={"Cookie": cookie} if cookie else None)


def wait_until(condition: Any, seconds: float = 600.0) -> bool:
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.02)
    return bool(condition())


# --- who is admitted -----------------------------------------------------------------------------


@pytest.mark.parametrize("origin", [
    "http://evil.example", "https://evil.example", "http://127.0.0.1:1", "http://localhost:{port}", "null", None,
    "http://127.0.0.1:{port}.evil.example", "http://127.0.0.1:{port}/", "file://127.0.0.1:{port}", "",
])
def test_a_socket_from_another_page_is_refused_even_with_the_token(server: Server, origin: str | None):
    with pytest.raises(InvalidStatus) as refused:
        open_socket(server, origin=origin)
    assert refused.value.response.status_code == 403
    assert not server._websock_server._live_connections


@pytest.mark.parametrize("host", ["evil.example:{port}", "127.0.0.1.evil.example:{port}", "evil.example", "10.0.0.1",
                                  "localhost@evil.example:{port}", "[::1", ""])
def test_a_host_that_was_rebound_to_this_machine_is_refused(server: Server, host: str):
    status, headers, _ = fetch(server, f"/?token={server.guard.token}", host=host)
    assert status in (400, 403) and "Set-Cookie" not in headers
    if host.isprintable() and "@" not in host and host and "[" not in host:
        with pytest.raises(InvalidStatus):
            open_socket(server, host=host)


@pytest.mark.parametrize("query", ["", "?token=", "?token=guess", "?Token={token}", "?token={token}x",
                                   "?token={token:.8}"])
def test_without_the_token_neither_page_nor_socket_opens(server: Server, query: str):
    query = query.format(token=server.guard.token)
    status, headers, body = fetch(server, f"/{query}")
    assert status == 403 and "Set-Cookie" not in headers and b"printed" in body
    assert server.guard.token.encode() not in body
    with pytest.raises(InvalidStatus):
        open_socket(server, query)
    with pytest.raises(InvalidStatus):
        open_socket(server, query, cookie=f"hrl-escape-{server.get_port()}=guess")


def test_the_printed_address_gives_the_page_a_cookie_that_opens_the_socket(server: Server):
    server.set_title("<b>room</b>")
    status, headers, body = fetch(server, f"/?token={server.guard.token}", **{"Accept-Encoding": "gzip"})
    assert status == 200 and b"<title>&lt;b&gt;room&lt;/b&gt;</title>" in body
    cookie = headers["Set-Cookie"]
    assert "HttpOnly" in cookie and "SameSite=Strict" in cookie
    assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
    held = cookie.partition(";")[0]
    with open_socket(server, "", cookie=f"other=1; {held}") as page:
        page.recv(timeout=600)
    assert fetch(server, "/", Cookie=held)[0] == 200
    other = open_server(port=0)
    try:
        assert fetch(other, "/", Cookie=held)[0] == 403, "a token is of one server only"
    finally:
        other.stop()


def test_a_request_from_another_page_is_refused(server: Server):
    path = f"/?token={server.guard.token}"
    assert fetch(server, path, Origin="http://evil.example")[0] == 403
    assert fetch(server, path, Origin="http://127.0.0.1:{port}")[0] == 200
    assert fetch(server, f"/../../../etc/passwd?token={server.guard.token}")[0] == 404


def test_a_server_for_other_machines_takes_addresses_and_its_own_name_but_no_other():
    server = open_server("0.0.0.0", 0)
    try:
        path = f"/?token={server.guard.token}"
        assert fetch(server, path, host="192.0.2.7:{port}")[0] == 200
        assert fetch(server, path, host="evil.example:{port}")[0] == 403
        assert fetch(server, "/", host="192.0.2.7:{port}")[0] == 403
    finally:
        server.stop()


# --- what an admitted page may say ---------------------------------------------------------------


@pytest.fixture
def game(server: Server, two_buttons) -> Iterator[PlayPage]:
    """Manual mode whose keys nobody carries out, so that they pile up."""
    yield PlayPage(server, Episode(two_buttons), stride=0.0)


def find_control(server: Server, option: str) -> Any:
    return next(handle for handle in server.gui._gui_input_handle_from_uuid.values()
                if option in getattr(handle, "options", ()))


def send(page: Connection, **message: Any) -> None:
    page.send(msgspec.msgpack.encode(message))


def test_a_page_sets_values_that_its_controls_offer_and_nothing_else(server: Server, game: PlayPage):
    control = find_control(server, "Undo")
    crafted: list[dict[str, Any]] = [
        {"updates": {"update_cb": []}}, {"updates": {"removed": True}}, {"updates": {"sync_cb": None}},
        {"updates": {"_impl": 1}}, {"updates": {"value": "no such option"}}, {"updates": {"value": ["Undo"]}},
        {"updates": {"value": "Undo", "disabled": True}}, {"updates": {}}, {"updates": {"value": None}},
        {"updates": {"value": float("nan")}}, {"updates": {"value": "Undo"}, "excluded_self_client": 1},
        {"updates": {"value": "Undo"}, "uuid": "none"}, {"updates": {"value": "Undo"}, "uuid": 7},
    ]
    before = dict(vars(control._impl))
    with open_socket(server) as page:
        page.recv(timeout=600)
        page.send(msgspec.msgpack.encode(CAMERA))
        assert wait_until(server.get_clients)
        for message in crafted:
            send(page, type="GuiUpdateMessage", **({"uuid": control._impl.uuid} | message))
        for raw in (b"", b"\xc1", b"\x91" * 5000 + b"\xc0", msgspec.msgpack.encode([1]), "text",
                    msgspec.msgpack.encode({"type": "Nothing"})):
            page.send(raw)
        for kind in ("ShareUrlRequest", "ResetGuiMessage", "RunJavascriptMessage", "FileTransferStartUpload"):
            send(page, type=kind, source="window.__pwned=1")
        send(page, **(CAMERA | {"position": (float("nan"), 0, 0)}))
        send(page, **(CAMERA | {"image_height": 10**9}))
        send(page, type="GuiUpdateMessage", uuid=control._impl.uuid, updates={"value": "Again"})
        assert wait_until(lambda: game._waiting.qsize() == 1), "the page's own click arrives after all that"
        assert game._waiting.get() == "r"
        (client,) = server.get_clients().values()
        assert client.camera.position.tolist() == [0.0, -20.0, 20.0]
    after = vars(control._impl)
    assert {name for name in before if before[name] is not after[name]} <= {"value", "update_timestamp"}


def test_the_largest_message_is_small(server: Server):
    with open_socket(server) as page:
        page.recv(timeout=600)
        page.send(b"\0" * (2**16 + 1))  # the page itself sends a few hundred bytes
        with pytest.raises(ConnectionClosed) as closed:
            assert page.ping(ack_on_close=True).wait(600)  # a server that took the message answers what follows it
            page.send(b"")
    assert closed.value.rcvd is not None and closed.value.rcvd.code == 1009


def test_clicks_and_keys_wait_in_a_queue_of_bounded_length(server: Server, game: PlayPage):
    undo, meta = find_control(server, "Undo"), find_control(server, "press-button-1")
    save = next(h for h in server.gui._gui_input_handle_from_uuid.values() if isinstance(h, viser.GuiButtonHandle))
    threads = threading.active_count()
    with open_socket(server) as page:
        page.recv(timeout=600)
        page.send(msgspec.msgpack.encode(CAMERA))
        assert wait_until(server.get_clients)
        for _ in range(200):
            send(page, type="GuiUpdateMessage", uuid=meta._impl.uuid, updates={"value": "press-button-1"})
            send(page, type="GuiUpdateMessage", uuid=undo._impl.uuid, updates={"value": "Undo"})
            send(page, type="GuiUpdateMessage", uuid=save._impl.uuid, updates={"value": True})
        assert page.ping().wait(600)
        assert wait_until(lambda: game._waiting.qsize() >= MOST_WAITING)
        time.sleep(0.5)
        assert game._waiting.qsize() == MOST_WAITING
        asked = [game._waiting.get() for _ in range(3)]
        assert isinstance(asked[0], Command) and asked[1:] == ["z", "f"], "in the order of the clicks"
        assert threading.active_count() - threads < 10


def test_a_slider_takes_numbers_of_its_range_only(server: Server):
    slider = server.gui.add_slider("speed", 1, 60, 1, 5)
    box, hidden = server.gui.add_checkbox("fast", False), server.gui.add_checkbox("hidden", False, visible=False)

    def may(handle: Any, value: Any) -> bool:
        message = {"type": "GuiUpdateMessage", "uuid": handle._impl.uuid, "updates": {"value": value}}
        return is_expected(server, None, msgspec.msgpack.encode(message))

    assert all(may(slider, value) for value in (1, 60, 5.5))
    assert not any(may(slider, value) for value in (0, 61, True, "5", float("nan"), 1e300))
    assert [may(box, value) for value in (True, False, 1, "x")] == [True, True, False, False]
    assert not may(hidden, True)
    others = (server.gui.add_text("name", "x"), server.gui.add_number("count", 1), server.gui.add_rgb("ink", (0, 0, 0)))
    assert not any(may(other, value) for other in others for value in ("y", 2, True)), "kinds that no page of ours has"


def test_a_page_may_set_the_controls_of_all_and_its_own_and_no_other_page_s(server: Server):
    with open_socket(server) as page:
        page.recv(timeout=600)
        page.send(msgspec.msgpack.encode(CAMERA))
        assert wait_until(server.get_clients)
        (number, client), = server.get_clients().items()
        message = {"type": "GuiUpdateMessage", "updates": {"value": True}}
        own = msgspec.msgpack.encode(message | {"uuid": client.gui.add_checkbox("mine", False)._impl.uuid})
        shared = msgspec.msgpack.encode(message | {"uuid": server.gui.add_checkbox("ours", False)._impl.uuid})
        assert [is_expected(server, who, own) for who in (number, number + 1, None)] == [True, False, False]
        assert [is_expected(server, who, shared) for who in (number, number + 1, None)] == [True, True, True]


def test_a_message_with_a_field_more_than_it_has_is_none(server: Server):
    assert is_expected(server, None, msgspec.msgpack.encode(CAMERA))
    assert not is_expected(server, None, msgspec.msgpack.encode(CAMERA | {"zoom": 2}))


def test_a_disabled_control_takes_nothing(server: Server):
    for handle, value in ((server.gui.add_checkbox("fast", False, disabled=True), True),
                          (server.gui.add_slider("speed", 1, 60, 1, 5, disabled=True), 30)):
        message = {"type": "GuiUpdateMessage", "uuid": handle._impl.uuid, "updates": {"value": value}}
        assert not is_expected(server, None, msgspec.msgpack.encode(message))
        handle.disabled = False
        assert is_expected(server, None, msgspec.msgpack.encode(message))


def test_a_request_with_two_hosts_is_refused_though_the_first_is_right(server: Server):
    port = server.get_port()
    for hosts, status in ((["127.0.0.1"], b"200"), (["127.0.0.1", "127.0.0.1"], b"403"),
                          (["127.0.0.1", "evil.example"], b"403")):
        lines = [f"GET /?token={server.guard.token} HTTP/1.1", *(f"Host: {host}:{port}" for host in hosts),
                 "Connection: close", "", ""]
        with socket.create_connection(("127.0.0.1", port), timeout=600) as dialled:
            dialled.sendall("\r\n".join(lines).encode())
            assert dialled.recv(64).split()[1] == status, hosts
