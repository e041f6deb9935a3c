"""Admission to the viewer's server: only the page whose printed address the user opened.

Every web page in the user's browser can send requests to this machine, and viser answers them
all. Here a request needs a Host that names this server (a DNS name rebound to this machine does
not), the same origin if it says from where it comes, and a token. The token stands in the printed
address; the first answer turns it into a cookie, which other sites cannot send along.
"""

from __future__ import annotations

import hmac
import html
import http
import ipaddress
import secrets
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

from hrl_escape.errors import UnsupportedError
from hrl_escape.viewer.extra import viser, websockets

__all__ = ["LARGEST_MESSAGE", "Guard", "guard_servers"]

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
    """Rules of admission of one server.

    Args:
        host: address that the server listens on.

    Attributes:
        token: secret of this server.
        title: title of the browser's tab.
        is_expected: decides about each message of an admitted page, given its connection and the bytes;
            None while the server starts, when nobody is admitted.
    """

    def __init__(self, host: str) -> None:
        self.token = secrets.token_urlsafe(24)
        self.title = "hrl-escape"
        self.is_expected: Callable[[Any, Any], bool] | None = None
        self._names = {host.lower(), *_LOOPBACK}
        self._is_open = host in _WILDCARDS
        if self._is_open:
            self._names |= {socket.gethostname().lower(), socket.getfqdn().lower()}

    def find_fault(self, path: str, headers: Any, port: int) -> str:
        """The reason why a request is refused; empty if it is admitted.

        Args:
            path: path and query of the request.
            headers: its headers.
            port: port that the server listens on.
        """
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

        async def recv(self, decode: bool | None = None) -> Any:
            while True:
                raw = await super().recv(decode)
                if guard.is_expected is not None and guard.is_expected(self, raw):
                    return raw

    return GuardedConnection
