"""The viewer's web server: viser, bound to this machine unless the user names another address, behind a guard.

Nothing here knows rooms.
"""

from __future__ import annotations

import contextlib
import io
import socket
from typing import Any

from hrl_escape.errors import AddressError
from hrl_escape.viewer.extra import viser
from hrl_escape.viewer.guard import Guard, guard_servers, is_expected

HOST = "127.0.0.1"
DEFAULT_PORT = 8080


class Server(viser.ViserServer):
    """A viser server behind a guard, without the tunnel that would share it over the internet.

    Args:
        host: address to listen on.
        port: port to listen on.
        label: heading of the control panel.

    Attributes:
        guard: decides whom the server answers.
    """

    def __init__(self, host: str, port: int, label: str) -> None:
        self.guard = Guard(host)
        with guard_servers(self.guard):
            super().__init__(host=host, port=port, label=label, verbose=False)
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
        """Stop without viser's message."""
        with contextlib.redirect_stdout(io.StringIO()):
            super().stop()


def open_server(host: str = HOST, port: int = DEFAULT_PORT, label: str = "hrl-escape") -> Server:
    """Start serving an empty page.

    Args:
        host: address to listen on; anything but 127.0.0.1 lets other machines in.
        port: port to listen on; 0 for any free one.
        label: heading of the control panel.

    Raises:
        AddressError: the port is taken, or the address is not this machine's.
    """
    _check_free(host, port)
    with contextlib.redirect_stdout(io.StringIO()):  # it prints a banner of its own
        server = Server(host, port, label)
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


