"""The viewer's web server: viser, bound to this machine unless the user names another address, behind a guard.

Every web page in the user's browser can send requests to this machine, and viser answers them all. Here a request needs
a Host that names this server (a DNS name rebound to this machine does not), the same origin if it says from where it
comes, and a token. The token stands in the printed address; the first answer turns it into a cookie, which other sites
cannot send along.

An admitted page may send its camera, a value of a control that it shows, and a hotkey. viser would set whatever
attribute of whatever control a message names, so messages are read here first, and all others are dropped. Nothing here
knows rooms.
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
    """True for a message that the viewer's own page could have sent, by a client whose number is None if not known."""
    if not isinstance(raw, bytes):
        return False
    try:
        message = _DECODER.decode(raw)
    except (msgspec.MsgspecError, ValueError, RecursionError):
        return False
    if isinstance(message, _Camera):
        return message.is_finite()
    if isinstance(message, _Trigger):
        return True  # viser knows its commands, and a trigger carries nothing else
    handle = server.gui._gui_input_handle_from_uuid.get(message.uuid)
    own = server.get_clients().get(client)
    if handle is None and own is not None:
        handle = own.gui._gui_input_handle_from_uuid.get(message.uuid)
    return handle is not None and _may_set(handle, message.updates.value)


def _may_set(handle: Any, value: bool | int | float | str) -> bool:
    """True if a page can give this value to this control."""
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
"""Bytes of the largest message that a page may send."""
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
    """Rules of admission of the server that listens on an address.

    Attributes:
        token: secret of this server.
        title: title of the browser's tab.
        is_expected: decides about each message of an admitted page, given its connection and the bytes;
            None while the server starts, when nobody is admitted.
        connections: all connections, those that a browser opens for later and says nothing on among them.
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
        """Reason why a request, by its path with its query, headers and port, is refused; empty if it is admitted."""
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1 or not self._is_own_name(hosts[0]):
            return "this address is not one of this server's names"
        if len(origins) > 1 or (_is_socket(headers) and not origins):
            return "the request does not say from which page it comes"
        if origins and not _is_same_origin(origins[0], hosts[0]):
            return "the request comes from another page"
        if not self._holds_token(path, headers, port):
            return "open the address that was printed when the viewer started"
        return ""

    def make_cookie(self, port: int) -> str:
        """Header that lets the page hold the token."""
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
    """Let a guard stand before the server that viser starts in this block.

    viser gives no hook for it, so the function that it starts its server with is wrapped meanwhile.

    Raises:
        UnsupportedError: this version of viser starts its server in another way.
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
        raise UnsupportedError("this version of viser cannot be guarded against other web pages; install viser 1.1.1")


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
            del request.headers[encoding]  # the title is changed in the plain text
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
        """A connection that passes on only what a page is expected to send."""

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
    """A viser server behind a guard, without the tunnel that would share it over the internet."""

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
        """Name the browser's tab for clients that come from now on."""
        self.guard.title = title

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Return None: viser would publish the page through a server elsewhere."""
        del verbose
        return None

    def stop(self) -> None:
        """Stop at once, without viser's message; a connection on which nothing was said would hold it up."""
        for connection in tuple(self.guard.connections):
            if connection.request is None:
                connection.loop.call_soon_threadsafe(connection.transport.abort)
        with contextlib.redirect_stdout(io.StringIO()):
            super().stop()


def open_server(host: str = HOST, port: int = PORT) -> Server:
    """Start serving an empty page; a host but 127.0.0.1 lets other machines in, and port 0 is any free one.

    Raises:
        AddressError: the port is taken, or the address is not this machine's.
    """
    _check_free(host, port)
    with contextlib.redirect_stdout(io.StringIO()):  # it prints a banner of its own
        server = Server(host, port)
    settings: dict[str, Any] = {"show_logo": False, "show_share_button": False, "control_width": "large",
                                "brand_color": (47, 109, 181)}
    server.gui.configure_theme(**settings)
    server.gui.main_panel.dock_right()
    return server


def get_url(server: Server) -> str:
    """Address for a browser; the token in it lets the browser in."""
    host = server.get_host()
    name = "localhost" if host in ("0.0.0.0", "::") else f"[{host}]" if ":" in host else host
    return f"http://{name}:{server.get_port()}/?token={server.guard.token}"


def _check_free(host: str, port: int) -> None:
    """Refuse a port that is taken, which viser would silently replace, and a foreign address, which it would retry."""
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
