"""Record an episode as one HTML page that plays it in 3D offline, or as an animation.

    hrl-escape record
    hrl-escape record --room clutter#3 --out clutter.html clutter.gif
    hrl-escape record runs/smdp-dqn-paper-two-button-0-5a1d3f0c --out learned.html
    hrl-escape record episodes/paper-two-button-0-31-primitives-3f9c02ab.json --out mine.mp4

By default the oracle drives. Otherwise give the folder of a run (see `hrl-escape train`), the file of an episode
saved from `hrl-escape play`, a rung with a trained agent, a reference such as search-backtrack, or the spec of an
agent, which is recorded in its first episode of training.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from hrl_escape.agents.spec import ORACLE
from hrl_escape.commands.room_choice import RoomChoice
from hrl_escape.env.engine import check_camera, film
from hrl_escape.env.pictures.video import save_video
from hrl_escape.errors import UnsupportedError
from hrl_escape.figures import VIDEO_FORMATS
from hrl_escape.names import make_console_text
from hrl_escape.viewer.play.episode import load_episode
from hrl_escape.viewer.recording import EpisodeRecording, record_driver, record_saved
from hrl_escape.viewer.watch.drivers import find_driver, open_driver

PAGE_ENDING = ".html"


@dataclasses.dataclass(frozen=True)
class RecordArgs(RoomChoice):
    """Options of `hrl-escape record`."""

    driver: Annotated[str, tyro.conf.Positional] = ORACLE
    """The driver: oracle or another reference, the folder of a run, the file of a saved episode, a rung, or the spec of
    an agent."""
    out: tuple[Path, ...] = (Path("escape.html"),)
    """Files to write: .html for the page, .gif or .mp4 for an animation."""
    camera: str = "chase"
    """Camera of animations; `hrl-escape list cameras` names them."""
    episode_seed: int = 0
    """Episode seed: fixes the start and the noise."""
    trust: bool = False
    """Allow imports of any code that a run's folder names; only for folders that you trust."""


def run(args: RecordArgs) -> None:
    """Drive one episode and write it."""
    known = (PAGE_ENDING, *(f".{ending}" for ending in VIDEO_FORMATS))
    for path in args.out:
        if path.suffix.lower() not in known:
            raise UnsupportedError(f"{path}: a recording's name must end in {', '.join(known)}")
    check_camera(args.camera)
    recording = _record(args)
    console = Console(soft_wrap=True)
    console.print(f"{make_console_text(recording.driver)}: {recording.end.words} after {len(recording.rewards)} "
                  f"primitives, return {sum(recording.rewards):g}")
    for path in args.out:
        if path.suffix.lower() == PAGE_ENDING:
            from hrl_escape.viewer.pages.offline import save_replay  # needs the extra `viewer`, which animations do not

            save_replay(path, recording)
        else:
            save_video(path, film(recording.instance, recording.states, args.camera))
        console.print(f"wrote {path}", markup=False)


def _record(args: RecordArgs) -> EpisodeRecording:
    if args.driver.endswith(".json"):
        return record_saved(load_episode(args.driver), Path(args.driver).stem)
    text, own = find_driver(args.driver)
    instance = (None if args.is_given else own) or args.make_instance()
    driver = open_driver(text, instance, trust=args.trust)
    try:
        return record_driver(driver, args.episode_seed)
    finally:
        driver.env.close()
