"""Recordings of one episode: of a driver (the oracle or a trained agent), or of a saved episode replayed.

An `EpisodeRecording` is plain data. `pages.offline` writes it as a page, and the cameras as a video.
"""

from __future__ import annotations

import dataclasses

from hrl_escape.agents.decisions import name_action
from hrl_escape.agents.training.evaluation import play_episode
from hrl_escape.benchmark.episodes import PrimitiveStep
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import EpisodeEnd, RoomState
from hrl_escape.env.noise import check_seed
from hrl_escape.errors import UnsupportedError
from hrl_escape.viewer.play.episode import Episode, SavedEpisode
from hrl_escape.viewer.watch.drivers import Driver


@dataclasses.dataclass(frozen=True)
class EpisodeRecording:
    """One recorded episode."""

    instance: RoomInstance  # the room
    states: tuple[RoomState, ...]  # one more than rewards
    rewards: tuple[float, ...]  # one per primitive
    decisions: tuple[tuple[str, int], ...]  # name and number of primitives of each decision, in order
    end: EpisodeEnd  # end of the episode
    driver: str  # name of the driver, or of the file


def record_driver(driver: Driver, seed: int = 0) -> EpisodeRecording:
    """Record one episode of a driver without training. Raises `UnsupportedError` if its agent is not trained."""
    if driver.trains:
        name = driver.name.partition(",")[0]
        raise UnsupportedError(f"{name} has not been trained. Run `hrl-escape train {name}` first, then name the "
                               "folder of that run")
    steps: list[PrimitiveStep] = []
    driver.recorder.on_step = steps.append
    decisions: list[tuple[str, int]] = []
    for transition, _ in play_episode(driver.agent, driver.env, check_seed(seed)):
        decisions.append((name_action(driver.names, transition.action), transition.duration))
    return _make(driver.room.instance, steps, decisions, driver.name)


def record_saved(saved: SavedEpisode, name: str) -> EpisodeRecording:
    """Record a saved episode by replaying it. Raises `EpisodeFileError` if the replay differs from the file."""
    episode = Episode(saved.instance, seed=saved.seed)
    try:
        episode.replay(saved)
        decisions = [(move.name, len(move.steps)) for move in episode.moves]
        return _make(saved.instance, episode.steps, decisions, name)
    finally:
        episode.close()


def _make(instance: RoomInstance, steps: list[PrimitiveStep], decisions: list[tuple[str, int]],
          driver: str) -> EpisodeRecording:
    if not steps:
        raise UnsupportedError("there is nothing to record: no primitive ran")
    return EpisodeRecording(instance, (steps[0].before, *(step.after for step in steps)),
                     tuple(step.reward for step in steps), tuple(decisions), steps[-1].end,
                     driver)
