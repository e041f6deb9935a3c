"""Your own reward: a cost of turning and a bonus for each button that turns on, in one room and in a batch."""

import dataclasses
from typing import Annotated, Any

import gymnasium
import numpy as np
import tyro

from hrl_escape import RoomConfig
from hrl_escape.env import RewardConfig, rewards
from hrl_escape.env.rewards import Events, RewardState
from hrl_escape.settings import Range


@dataclasses.dataclass(frozen=True)
class SteadyReward(RewardConfig):
    """Sparse reward with a cost of turning and a bonus for each button that turns on."""

    kind = "steady"
    turn_cost: Annotated[float, Range(0, 10)] = 0.5
    """Cost of a turn."""
    bonus: Annotated[float, Range(0, 100)] = 5.0
    """Bonus of a primitive that turns a button on."""

    def compute_extra(self, before: RewardState, after: RewardState, events: Events) -> Any:
        """Compute bonus minus cost: a number for one room, a tensor for a batch."""
        turned = after.heading_steps != before.heading_steps
        return self.bonus * (events.turned_on != 0) - self.turn_cost * turned


def main(turn_cost: float = 0.5) -> None:
    """Turn and move in a single room and in a batch, and print the rewards.

    Args:
        turn_cost: cost of a turn.
    """
    rewards.register("steady", SteadyReward)
    config = RoomConfig(reward=SteadyReward(turn_cost=turn_cost))
    env = gymnasium.make("hrl_escape/EscapeRoom-v1", config=config)
    batch = gymnasium.make_vec("hrl_escape/EscapeRoom-v1", num_envs=2, config=config)
    env.reset(seed=0), batch.reset(seed=0)
    forward, turn = 0, 4
    print("one room:", [env.step(action)[1] for action in (forward, turn)])
    print("a batch: ", [batch.step(np.full(2, action))[1].tolist() for action in (forward, turn)])


if __name__ == "__main__":
    tyro.cli(main)
