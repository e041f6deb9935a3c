"""Play a room yourself, in the browser, and beat the best known return.

    hrl-escape play
    hrl-escape play --room clutter#3 --hidden
    hrl-escape play --replay episodes/paper-two-button-0-31-primitives-3f9c02ab.json

W A S D and the arrows drive, U J move the arm, M and a number run a meta-action. Z takes a move back, R starts
again, N enters the next room, F saves the episode. Your best return in each room is kept in --save-to.
"""

from __future__ import annotations

import dataclasses
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from hrl_escape.commands.room_choice import RoomChoice, refuse_options
from hrl_escape.names import make_console_text
from hrl_escape.viewer import HOST, PORT
from hrl_escape.viewer.play.episode import Episode, SavedEpisode, load_episode

if TYPE_CHECKING:
    from hrl_escape.viewer.server import Server


@dataclasses.dataclass(frozen=True)
class PageAddress:
    """Options of the page's address, shared with `watch`."""

    host: str = HOST
    """Address to serve on; addresses other than 127.0.0.1 are open to other machines."""
    port: int = PORT
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


@dataclasses.dataclass(frozen=True)
class PlayArgs(PageAddress, RoomChoice):
    """Options of `hrl-escape play`."""

    episode_seed: int = 0
    """Episode seed: fixes the start and the noise."""
    replay: Path | None = None
    """File of a saved episode to replay first; its room is used."""
    save_to: Path = Path("episodes")
    """Folder for saved episodes."""
    hidden: bool = False
    """Hide the dependency graph: it shows what presses have proved, and everything after the escape."""

    def make_episode(self, saved: SavedEpisode | None = None) -> Episode:
        """Make the episode in the requested room, or in the room of a saved episode."""
        if saved is not None:
            refuse_options(self, ("room", "set", "episode_seed"),
                           "chooses what to play, and --replay has room and start: give one of them")
            return Episode(saved.instance, None, saved.seed, self.hidden)
        return Episode(self.make_instance(), self.find_config(), self.episode_seed, self.hidden)


def run(args: PlayArgs) -> None:
    """Play until the user quits."""
    saved = load_episode(args.replay) if args.replay else None
    episode = args.make_episode(saved)
    server = args.open_server()
    try:
        from hrl_escape.viewer.pages.play import PlayPage

        page = PlayPage(server, episode, args.save_to)
        args.announce(server, "Play")
        if saved is not None:
            page.replay(saved)
        page.run()
    except KeyboardInterrupt:
        pass  # the regular end
    finally:
        server.stop()
