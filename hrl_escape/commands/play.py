"""Play a room yourself: drive, press, undo, and beat the best known return; in browser, window or terminal.

    hrl-escape play
    hrl-escape play --preset clutter --seed 3
    hrl-escape play --no-browser
    hrl-escape play --replay episodes/paper-two-button-0-31-primitives.json

W A S D and the arrows drive, U J move the arm, M and a number run a meta-action, Z undoes, R starts again, N goes on.
"""

from __future__ import annotations

import dataclasses
import webbrowser
from pathlib import Path

from rich.console import Console

from hrl_escape.commands.room_choice import RoomChoice
from hrl_escape.errors import UnsupportedError
from hrl_escape.viewer.episode import Episode, load_episode


@dataclasses.dataclass(frozen=True)
class PlayArgs(RoomChoice):
    """Options of `hrl-escape play`."""

    episode_seed: int = 0
    """Seed of the episode: its start and its noise."""
    replay: Path | None = None
    """Play what an episode's file says first, then go on from there; it names the room too."""
    save_to: Path = Path("episodes")
    """Folder for saved episodes."""
    host: str = "127.0.0.1"
    """Address to serve on; any other than 127.0.0.1 lets other machines drive."""
    port: int = 8080
    """Port to serve on; 0 for any that is free."""
    browser: bool = True
    """Serve a page and open it; --no-browser plays in the terminal, over ssh too."""
    open: bool = True
    """Open the page in your browser; --no-open only prints where it is."""
    window: bool = False
    """Play in Bullet's own window instead."""


def run(args: PlayArgs) -> None:
    """Play until the user has had enough."""
    if args.window and not args.browser:
        raise UnsupportedError("--window and --no-browser are two ways to play: choose one")
    saved = load_episode(args.replay) if args.replay else None
    instance = saved.instance if saved else args.make_instance()
    config = None if saved or args.load else args.make_config()
    seed = saved.seed if saved else args.episode_seed
    if args.window:
        from hrl_escape.viewer.window import play_in_window

        play_in_window(instance, seed)
        return
    episode = Episode(instance, config, seed)
    if not args.browser:
        from hrl_escape.viewer.terminal import play_in_terminal

        if saved is not None:
            episode.replay(saved)
        play_in_terminal(episode, args.save_to)
        return
    from hrl_escape.viewer.play_page import PlayPage
    from hrl_escape.viewer.server import get_url, open_server

    server = open_server(args.host, args.port)
    try:
        page = PlayPage(server, episode, args.save_to)
        Console(soft_wrap=True).print(f"Play at [bold]{get_url(server)}[/bold] (Ctrl-C ends)")
        if args.open:
            webbrowser.open(get_url(server))
        if saved is not None:
            page.replay(saved)
        page.run()
    except KeyboardInterrupt:
        pass  # the way to end it
    finally:
        server.stop()
