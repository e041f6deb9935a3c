"""Record an episode: one HTML page that plays it in 3D without a network, or an animation.

    hrl-escape record
    hrl-escape record --preset clutter --seed 3 --out clutter.html clutter.gif
    hrl-escape record runs/smdp-dqn-paper-two-button-0 --out learned.html
    hrl-escape record episodes/paper-two-button-0-31-primitives.json --out mine.mp4

Without a name the planner drives; else a trained run (see `hrl-escape train`), or an episode saved from
`hrl-escape play`.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from hrl_escape.commands.room_choice import RoomChoice
from hrl_escape.env.bullet_cameras import check_camera, film
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.video import VIDEO_FORMATS, save_video
from hrl_escape.errors import UnsupportedError
from hrl_escape.viewer.drivers import PLANNER, find_room, open_driver
from hrl_escape.viewer.episode import load_episode
from hrl_escape.viewer.episodes import record_driver, record_saved
from hrl_escape.viewer.recording import Recording, save_page

PAGE = ".html"


@dataclasses.dataclass(frozen=True)
class RecordArgs(RoomChoice):
    """Options of `hrl-escape record`."""

    driver: Annotated[str, tyro.conf.Positional] = PLANNER
    """Who drives: planner, the folder of a run, or the file of a saved episode."""
    out: tuple[Path, ...] = (Path("escape.html"),)
    """What to write: .html for the page, .gif or .mp4 for an animation."""
    camera: str = "chase"
    """Through which camera animations are taken."""
    flavour: str = "press"
    """What the meta-actions of a trained run do: press, or press-with-ancestors."""
    episode_seed: int = 0
    """Seed of the episode: its start and its noise."""


def run(args: RecordArgs) -> None:
    """Drive one episode and write it."""
    known = (PAGE, *(f".{ending}" for ending in VIDEO_FORMATS))
    for path in args.out:
        if path.suffix.lower() not in known:
            raise UnsupportedError(f"{path}: a recording's name must end in {', '.join(known)}")
    check_camera(args.camera)
    recording = _record(args)
    console = Console(soft_wrap=True)
    console.print(f"{recording.who}: {recording.end} after {len(recording.rewards)} primitives, return "
                  f"{sum(recording.rewards):g}")
    for path in args.out:
        if path.suffix.lower() == PAGE:
            save_page(path, recording)
        else:
            save_video(path, film(recording.instance, recording.states, args.camera))
        console.print(f"wrote {path}")


def _record(args: RecordArgs) -> Recording:
    if args.driver.endswith(".json"):
        return record_saved(load_episode(args.driver), Path(args.driver))
    room = None if args.load else find_room(args.driver)
    instance = RoomInstance.load(room) if room else args.make_instance()
    driver = open_driver(args.driver, instance, flavour=args.flavour)
    try:
        return record_driver(driver, args.episode_seed)
    finally:
        driver.env.close()
