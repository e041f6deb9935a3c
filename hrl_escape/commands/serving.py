"""Address of the viewer's page: the options that `play` and `watch` share. Not a command."""

from __future__ import annotations

import dataclasses
import webbrowser
from typing import TYPE_CHECKING

from rich.console import Console

from hrl_escape.names import make_console_text

if TYPE_CHECKING:
    from hrl_escape.viewer.server import Server


@dataclasses.dataclass(frozen=True)
class PageAddress:
    """Options of the page's address; dataclasses of commands inherit them."""

    host: str = "127.0.0.1"
    """Address to serve on; any other than 127.0.0.1 lets other machines in."""
    port: int = 8080
    """Port to serve on; 0 for any free one."""
    no_open: bool = False
    """Only print the page's address; by default your browser opens it."""

    def open_server(self) -> Server:
        """Start serving an empty page, see `viewer.server`, which needs the extra `viewer`."""
        from hrl_escape.viewer.server import open_server  # needs the extra

        return open_server(self.host, self.port)

    def announce(self, server: Server, invitation: str) -> None:
        """Print the page's address and open it in the browser."""
        from hrl_escape.viewer.server import get_url

        url = get_url(server)
        Console(soft_wrap=True).print(f"{make_console_text(invitation)} at [bold]{url}[/bold] (Ctrl-C ends)")
        if not self.no_open:
            webbrowser.open(url)
