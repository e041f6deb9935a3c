"""Watch an agent drive and see what it thinks: option and plan, action values, SMDP numbers, what-if.

    hrl-escape watch
    hrl-escape watch smdp-dqn --preset clutter --seed 3
    hrl-escape watch runs/smdp-dqn-paper-two-button-0

Without a name the planner drives. An agent's name trains that agent as you look on; the folder of a run (see
`hrl-escape train`) lets the trained agent drive in its room. Space pauses, P runs one primitive, D one decision.
"""

from __future__ import annotations

import dataclasses
import sys
import webbrowser
from typing import Annotated, Literal

import torch
import tyro
from rich.console import Console

from hrl_escape.commands.room_choice import RoomChoice
from hrl_escape.env.instance import RoomInstance
from hrl_escape.viewer.drivers import PLANNER, find_room, open_driver
from hrl_escape.viewer.server import get_url, open_server
from hrl_escape.viewer.watch_page import WatchPage, run_in_thread
from hrl_escape.viewer.watching import Gate, Watch


@dataclasses.dataclass(frozen=True)
class WatchArgs(RoomChoice):
    """Options of `hrl-escape watch`."""

    driver: Annotated[str, tyro.conf.Positional] = PLANNER
    """Who drives: planner, the name of an agent that is then trained, or the folder of a run."""
    pace: float = 5.0
    """Primitives a second to begin with; 0 for as many as it can."""
    paused: bool = False
    """Begin paused."""
    observation: Literal["features", "state", "egocentric"] = "features"
    """What an agent to be trained sees."""
    flavour: Literal["press", "press-with-ancestors"] = "press"
    """What meta-actions do: press one button, or first those that must be on before it."""
    options_only: bool = False
    """Leave the primitives out of the choices of an agent to be trained."""
    recipe: str = "corrected"
    """Where the settings of an agent to be trained come from."""
    episode_seed: int = 0
    """Fixes the episodes, and an agent to be trained."""
    host: str = "127.0.0.1"
    """Address to serve on; any other than 127.0.0.1 lets other machines look on."""
    port: int = 8080
    """Port to serve on; 0 for any that is free."""
    open: bool = True
    """Open the page in your browser; --no-open only prints where it is."""


def run(args: WatchArgs) -> None:
    """Serve until interrupted."""
    torch.set_num_threads(1)
    room = None if args.load else find_room(args.driver)
    instance = RoomInstance.load(room) if room else args.make_instance()
    driver = open_driver(args.driver, instance, observation=args.observation, flavour=args.flavour,
                         include_primitives=not args.options_only, recipe=args.recipe, seed=args.episode_seed)
    gate = Gate(args.pace or None, args.paused)
    server = open_server(args.host, args.port)
    page = WatchPage(server, Watch(driver, gate, args.episode_seed))
    thread = run_in_thread(page)
    try:
        Console(soft_wrap=True).print(f"Watch {driver.name} at [bold]{get_url(server)}[/bold] (Ctrl-C ends)")
        if args.open:
            webbrowser.open(get_url(server))
        page.finished.wait()
        if page.problem:
            print(f"The driver stopped: {page.problem}. The page stays until Ctrl-C", file=sys.stderr)
        server.sleep_forever()
    except KeyboardInterrupt:
        pass  # the way to end it
    finally:
        gate.stop()
        thread.join(5.0)
        server.stop()
