"""Episodes to keep, from whoever drives: the planner, a trained run, or a file that a person saved.

Each becomes a `Recording`; how that is written as a page or a video is for others.
"""

from __future__ import annotations

from pathlib import Path

from hrl_escape.agents.evaluation import play_episode
from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import UnsupportedError
from hrl_escape.viewer.drivers import Driver
from hrl_escape.viewer.episode import Episode, SavedEpisode
from hrl_escape.viewer.recording import Recording
from hrl_escape.viewer.tap import Step

__all__ = ["record_driver", "record_saved"]


def record_driver(driver: Driver, seed: int = 0) -> Recording:
    """Let somebody drive one episode with frozen weights.

    Raises:
        UnsupportedError: an agent that has not been trained yet.
        PlanningFailed: the planner finds no way.
    """
    if driver.trains:
        name = driver.name.partition(",")[0]
        raise UnsupportedError(f"{name} has not been trained yet: run `hrl-escape train {name}` first and give the "
                               "folder that it leaves")
    steps: list[Step] = []
    driver.tap.on_step = steps.append
    decisions: list[tuple[str, int]] = []
    for transition, _ in play_episode(driver.agent, driver.env, seed):
        decisions.append((driver.names[transition.action], transition.duration))
    return _make(driver.room.instance, steps, decisions, driver.name)


def record_saved(saved: SavedEpisode, path: Path) -> Recording:
    """Play a saved episode again.

    Raises:
        EpisodeFileError: it does not play out as the file says.
    """
    episode = Episode(saved.instance, seed=saved.seed)
    try:
        episode.replay(saved)
        decisions = [(move.name, len(move.steps)) for move in episode.moves]
        return _make(saved.instance, episode.steps, decisions, path.stem)
    finally:
        episode.close()


def _make(instance: RoomInstance, steps: list[Step], decisions: list[tuple[str, int]], who: str) -> Recording:
    if not steps:
        raise UnsupportedError("there is nothing to record: no primitive ran")
    last = steps[-1]
    end = "escaped" if last.terminated else "out of time" if last.truncated else "still inside"
    return Recording(instance, (steps[0].before, *(step.after for step in steps)),
                     tuple(step.reward for step in steps), tuple(decisions), end, who)
