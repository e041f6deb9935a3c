"""The web server of the viewer: viser on this machine only, with errors that say what to do.

Nothing here knows rooms. A listener on other addresses is opened only where the user names one.
"""

from __future__ import annotations

import contextlib
import io
import socket
from typing import Any

from hrl_escape.errors import AddressError
from hrl_escape.viewer.extra import viser

__all__ = ["DEFAULT_PORT", "HOST", "Server", "get_url", "open_server"]

HOST = "127.0.0.1"
DEFAULT_PORT = 8080


class Server(viser.ViserServer):
    """A viser server that stays on this machine: it can be shared by address only, never through a tunnel."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refused."""
        del verbose
        return None

    def stop(self) -> None:
        """Stop quietly."""
        with contextlib.redirect_stdout(io.StringIO()):
            super().stop()


def open_server(host: str = HOST, port: int = DEFAULT_PORT, label: str = "hrl-escape") -> Server:
    """Start serving an empty page.

    Args:
        host: address to listen on; anything but 127.0.0.1 lets other machines in.
        port: 0 for any that is free.
        label: heading of the control panel.

    Raises:
        AddressError: the port is taken, or the address is not this machine's.
    """
    _check_free(host, port)
    with contextlib.redirect_stdout(io.StringIO()):  # it prints a banner of its own
        server = Server(host=host, port=port, label=label, verbose=False)
    settings: dict[str, Any] = {"show_logo": False, "show_share_button": False, "control_width": "large",
                                "brand_color": (47, 109, 181)}
    server.gui.configure_theme(**settings)
    server.gui.main_panel.dock_right()
    return server


def get_url(server: Server) -> str:
    """Where a browser finds it."""
    host = server.get_host()
    return f"http://{'localhost' if host in ('0.0.0.0', '::') else host}:{server.get_port()}"


def _check_free(host: str, port: int) -> None:
    """Viser would move on to the next port without a word, and try a foreign address for ever."""
    if not 0 <= port <= 65535:
        raise AddressError(f"port {port} is not possible: choose one from 1024 to 65535, or 0 for any that is free")
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except OSError as error:
        raise AddressError(f"cannot serve on {host}:{port}: {error.strerror or error}. Another program may be using "
                           "the port: choose one with --port, or --port 0 for any that is free") from None


