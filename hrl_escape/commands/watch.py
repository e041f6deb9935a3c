"""Watch an agent drive: options and plans, action values, SMDP transitions, what-if previews.

    hrl-escape watch
    hrl-escape watch smdp-r-max --room clutter#3
    hrl-escape watch search-backtrack --room four-button-chain
    hrl-escape watch maxq-q+planned
    hrl-escape watch runs/smdp-dqn-paper-two-button-0-5a1d3f0c
    hrl-escape watch lattice
    hrl-escape watch text-agent --settings model=search-random reveal=names

By default the oracle drives. The spec of an agent trains that agent while you watch. A reference such as
search-backtrack plays by its rule. The folder of a run (see `hrl-escape train`) loads its agent and room. The name of a
rung (see `hrl-escape ladder list`) loads the trained agent that comes with the package. Space pauses, P runs one
primitive, D one decision.
"""

from __future__ import annotations

import dataclasses
import sys
from typing import Annotated

import torch
import tyro

from hrl_escape.agents.spec import ORACLE
from hrl_escape.commands.agent_choice import AgentChoice
from hrl_escape.commands.play import PageAddress
from hrl_escape.commands.room_choice import RoomChoice
from hrl_escape.viewer.pages.watch import WatchPage, run_in_thread
from hrl_escape.viewer.watch.drivers import find_driver, names_run, open_driver, parse_driver
from hrl_escape.viewer.watch.watch import Gate, Watch


@dataclasses.dataclass(frozen=True)
class WatchArgs(PageAddress, AgentChoice, RoomChoice):
    """Options of `hrl-escape watch`."""

    driver: Annotated[str, tyro.conf.Positional] = ORACLE
    """The driver: oracle or another reference, the spec of an agent to train, the folder of a run, or a rung
    with a trained agent."""
    pace: float = 5.0
    """Initial primitives per second; 0 for no limit."""
    paused: bool = False
    """Wait for the page's play button before the first primitive."""
    seed: int = 0
    """Training seed of an agent to train. Give --room too: --seed alone chose a room in 0.3."""
    episode_seed: int = 0
    """Seed of the episodes."""
    trust: bool = False
    """Allow imports of any code that a run's folder names; only for folders that you trust."""


def run(args: WatchArgs) -> None:
    """Open the page in the browser and run the driver until interrupted."""
    torch.set_num_threads(1)
    text, own = find_driver(args.driver)
    instance = (None if args.is_given else own) or args.make_instance()
    chosen = text if names_run(text) else args.make_spec(parse_driver(text))
    driver = open_driver(chosen, instance, observation=args.observation, seed=args.seed, trust=args.trust)
    gate = Gate(args.pace or None, args.paused)
    watch = Watch(driver, gate, args.episode_seed)
    server = args.open_server()
    page = WatchPage(server, watch)
    thread = run_in_thread(page)
    try:
        args.announce(server, f"Watch {driver.name}")
        page.finished.wait()
        if page.problem:
            print(f"The driver stopped: {page.problem}. The page stays up until Ctrl-C", file=sys.stderr)
        server.sleep_forever()
    except KeyboardInterrupt:
        pass  # the regular end
    finally:
        gate.stop()
        thread.join(5.0)
        server.stop()
