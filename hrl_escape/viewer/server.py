"""The viewer's web server: viser with access control, reachable from this machine only by default.

Every web page in the user's browser can send requests to this machine, and viser answers all of them. Here a request
needs a Host header that names this server (a rebound DNS name does not), the same origin if it has one, and a token.
The token is part of the printed address. The first answer turns it into a cookie, which other sites cannot send.

An admitted page may send its camera, values of the controls that it shows, and hotkeys. viser would set any attribute
of any control that a message names. Messages are therefore checked here first, and all others are dropped. This module
is independent of rooms.
"""

from __future__ import annotations

import contextlib
import hmac
import html
import http
import io
import ipaddress
import math
import secrets
import socket
import threading
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

from hrl_escape.errors import AddressError, UnsupportedError
from hrl_escape.viewer import HOST, PORT
from hrl_escape.viewer.extra import msgspec, viser, websockets

_Three = tuple[float, float, float]


class _Camera(msgspec.Struct, tag="ViewerCameraMessage", tag_field="type", forbid_unknown_fields=True):
    wxyz: tuple[float, float, float, float]
    position: _Three
    fov: float
    near: float
    far: float
    image_height: int
    image_width: int
    look_at: _Three
    up_direction: _Three

    def is_finite(self) -> bool:
        numbers = (*self.wxyz, *self.position, *self.look_at, *self.up_direction, self.fov, self.near, self.far)
        return all(map(math.isfinite, numbers)) and 0 < self.image_height < 2**16 and 0 < self.image_width < 2**16


class _Value(msgspec.Struct, forbid_unknown_fields=True):
    value: bool | int | float | str


class _Update(msgspec.Struct, tag="GuiUpdateMessage", tag_field="type", forbid_unknown_fields=True):
    uuid: str
    updates: _Value


class _Trigger(msgspec.Struct, tag="CommandTriggerMessage", tag_field="type", forbid_unknown_fields=True):
    uuid: str


_DECODER = msgspec.msgpack.Decoder(_Camera | _Update | _Trigger)


def is_expected(server: Any, client: int | None, raw: object) -> bool:
    """Return whether the viewer's own page could have sent a message; `client` is the client's id, None if unknown."""
    if not isinstance(raw, bytes):
        return False
    try:
        message = _DECODER.decode(raw)
    except (msgspec.MsgspecError, ValueError, RecursionError):
        return False
    if isinstance(message, _Camera):
        return message.is_finite()
    if isinstance(message, _Trigger):
        return True  # viser ignores unknown commands, and a trigger has no other content
    handle = server.gui._gui_input_handle_from_uuid.get(message.uuid)
    own = server.get_clients().get(client)
    if handle is None and own is not None:
        handle = own.gui._gui_input_handle_from_uuid.get(message.uuid)
    return handle is not None and _may_set(handle, message.updates.value)


def _may_set(handle: Any, value: bool | int | float | str) -> bool:
    """Return whether a page can give this value to this control."""
    if handle.disabled or not handle.visible:
        return False
    if isinstance(handle, (viser.GuiButtonGroupHandle, viser.GuiDropdownHandle)):
        return isinstance(value, str) and value in handle.options
    if isinstance(handle, (viser.GuiButtonHandle, viser.GuiCheckboxHandle)):
        return isinstance(value, bool)
    if isinstance(handle, viser.GuiSliderHandle):
        return not isinstance(value, (bool, str)) and handle.min <= value <= handle.max
    return False


LARGEST_MESSAGE = 2**16
"""Largest message that a page may send, bytes."""
_LOOPBACK = ("localhost", "127.0.0.1", "::1")
_WILDCARDS = ("0.0.0.0", "::", "")
_HEADERS = {
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}
_STARTING = threading.Lock()


class Guard:
    """Access control of a server.

    Attributes:
        token: secret of this server.
        title: title of the browser's tab.
        is_expected: decides on each message of an admitted page from its connection and its bytes. None while the
            server starts, when all requests are refused.
        connections: all connections, including idle ones that a browser opens in advance.
    """

    def __init__(self, host: str) -> None:
        self.token = secrets.token_urlsafe(24)
        self.title = "hrl-escape"
        self.is_expected: Callable[[Any, Any], bool] | None = None
        self.connections: weakref.WeakSet[Any] = weakref.WeakSet()
        self._names = {host.lower(), *_LOOPBACK}
        self._is_open = host in _WILDCARDS
        if self._is_open:
            self._names |= {socket.gethostname().lower(), socket.getfqdn().lower()}

    def find_fault(self, path: str, headers: Any, port: int) -> str:
        """Return why a request, by its path with query, headers and port, is refused; empty if it is admitted."""
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1 or not self._is_own_name(hosts[0]):
            return "this address is not one of this server's names"
        if len(origins) > 1 or (_is_socket(headers) and not origins):
            return "the request does not name the page it comes from"
        if origins and not _is_same_origin(origins[0], hosts[0]):
            return "the request comes from another page"
        if not self._holds_token(path, headers, port):
            return "open the address that was printed when the viewer started"
        return ""

    def make_cookie(self, port: int) -> str:
        """Return the header that stores the token in the browser."""
        return f"{_name_cookie(port)}={self.token}; Path=/; HttpOnly; SameSite=Strict"

    def _is_own_name(self, host: str) -> bool:
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        return name in self._names or (self._is_open and _is_address(name))

    def _holds_token(self, path: str, headers: Any, port: int) -> bool:
        found = parse_qs(urlsplit(path).query).get("token", [])
        for text in headers.get_all("Cookie"):
            try:
                cookies = SimpleCookie(text)
            except CookieError:
                continue
            if _name_cookie(port) in cookies:
                found.append(cookies[_name_cookie(port)].value)
        return any(hmac.compare_digest(value.encode(), self.token.encode()) for value in found)


def _is_socket(headers: Any) -> bool:
    return [value.lower() for value in headers.get_all("Upgrade")] == ["websocket"]


def _name_cookie(port: int) -> str:
    return f"hrl-escape-{port}"  # browsers share cookies among the ports of a host


def _is_same_origin(origin: str, host: str) -> bool:
    scheme, _, place = origin.partition("://")
    return scheme in ("http", "https") and place.lower() == host.lower()


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


@contextmanager
def guard_servers(guard: Guard) -> Iterator[None]:
    """Put a guard in front of the server that viser starts in this block.

    viser has no hook for it. The function that starts its server is therefore wrapped during the block.

    Raises:
        UnsupportedError: this version of viser starts its server differently.
    """
    module = websockets.asyncio.server
    with _STARTING:
        serve, guarded = module.serve, []

        def serve_guarded(handler: Any, *arguments: Any, **options: Any) -> Any:
            if getattr(handler, "__module__", "") == viser.infra.WebsockServer.__module__:
                guarded.append(True)
                options |= {"max_size": LARGEST_MESSAGE, "create_connection": _make_connection_class(guard),
                            "process_request": _make_process(guard, options.get("process_request"))}
            return serve(handler, *arguments, **options)

        module.serve = serve_guarded
        try:
            yield
        finally:
            module.serve = serve
    if not guarded:
        raise UnsupportedError("this version of viser cannot be protected from other web pages. Install viser 1.1.1")


def _make_process(guard: Guard, serve_files: Any) -> Any:
    """Answer requests as viser does, behind the guard."""
    http11, encoding = websockets.http11, "Accept-Encoding"

    def process(connection: Any, request: Any) -> Any:
        port = connection.local_address[1]
        fault = guard.find_fault(request.path, request.headers, port)
        if guard.is_expected is None or fault:
            status = http.HTTPStatus.FORBIDDEN if fault else http.HTTPStatus.SERVICE_UNAVAILABLE
            return connection.respond(status, f"{fault or 'the viewer is starting'}\n")
        if _is_socket(request.headers):
            return None
        if encoding in request.headers:
            del request.headers[encoding]  # the title can only be changed in uncompressed text
        answer = serve_files(connection, request)
        if answer.status_code != http.HTTPStatus.OK:
            return answer
        title = f"<title>{html.escape(guard.title)}</title>".encode("utf-8", "replace")
        body = answer.body.replace(b"<title>Viser</title>", title, 1)
        headers = websockets.Headers(answer.headers)
        del headers["Content-Length"]
        headers.update({"Content-Length": str(len(body)), "Set-Cookie": guard.make_cookie(port), **_HEADERS})
        return http11.Response(answer.status_code, answer.reason_phrase, headers, body)

    return process


def _make_connection_class(guard: Guard) -> type:
    class GuardedConnection(websockets.asyncio.server.ServerConnection):
        """A connection that passes on only expected messages."""

        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            guard.connections.add(self)

        async def recv(self, decode: bool | None = None) -> Any:
            while True:
                raw = await super().recv(decode)
                if guard.is_expected is not None and guard.is_expected(self, raw):
                    return raw

    return GuardedConnection


class Server(viser.ViserServer):
    """A viser server behind a guard, without viser's tunnel that would share it over the internet."""

    def __init__(self, host: str, port: int) -> None:
        self.guard = Guard(host)
        with guard_servers(self.guard):
            super().__init__(host=host, port=port, label="hrl-escape", verbose=False)
        self.guard.is_expected = self._is_expected

    def _is_expected(self, connection: Any, raw: object) -> bool:
        live = self._websock_server._live_connections.items()
        client = next((number for number, other in tuple(live) if other is connection), None)
        return is_expected(self, client, raw)

    def set_title(self, title: str) -> None:
        """Set the title of the browser's tab for clients that connect from now on."""
        self.guard.title = title

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Return None; viser would publish the page through an external server."""
        del verbose
        return None

    def stop(self) -> None:
        """Stop at once, without viser's message; idle connections would delay it."""
        for connection in tuple(self.guard.connections):
            if connection.request is None:
                connection.loop.call_soon_threadsafe(connection.transport.abort)
        with contextlib.redirect_stdout(io.StringIO()):
            super().stop()


NARROW_STYLE = """<style>@media (max-width: 40em) {
  [style*="max-height: 60%"], [style*="width: 20em"] { width: 100% !important }
}</style>"""
"""Gives the panel the whole width of a phone, where viser leaves a third empty."""


def open_server(host: str = HOST, port: int = PORT) -> Server:
    """Start serving an empty page. A host other than 127.0.0.1 admits other machines; port 0 selects a free port.

    Raises:
        AddressError: the port is in use, or the address belongs to another machine.
    """
    _check_free(host, port)
    with contextlib.redirect_stdout(io.StringIO()):  # viser prints a banner
        server = Server(host, port)
    settings: dict[str, Any] = {"show_logo": False, "show_share_button": False, "control_width": "large",
                                "brand_color": (47, 109, 181)}
    server.gui.configure_theme(**settings)
    server.gui.main_panel.dock_right()
    server.gui.add_html(NARROW_STYLE)
    return server


def get_url(server: Server) -> str:
    """Return the address for a browser, with the token that admits it."""
    host = server.get_host()
    name = "localhost" if host in ("0.0.0.0", "::") else f"[{host}]" if ":" in host else host
    return f"http://{name}:{server.get_port()}/?token={server.guard.token}"


def _check_free(host: str, port: int) -> None:
    """Refuse a port in use, which viser would silently replace, and a foreign address, which it would retry."""
    if not 0 <= port <= 65535:
        raise AddressError(f"port {port} is not possible: choose one from 1024 to 65535, or 0 for any free one")
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except OSError as error:
        raise AddressError(f"cannot serve on {host}:{port}: {error.strerror or error}. Another program may be using "
                           "the port: choose one with --port, or --port 0 for any free one") from None
