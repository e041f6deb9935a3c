"""PPO of Stable-Baselines3, PPO of this package and PPO over options on one curve, in one call (extra `bench`).

All three have the same rooms, seeds, budgets and evaluations. Bands are 95 % intervals over seeds.
"""

from pathlib import Path

import tyro
from stable_baselines3 import PPO

from hrl_escape import compare
from hrl_escape.agents import SB3Agent


def main(room: str = "paper-one-button", primitives: int = 20_000, seeds: int = 5, out: Path = Path("runs/ppo")
         ) -> None:
    """Train the three agents and write curve and report.

    Args:
        room: room of training and evaluation.
        primitives: training budget of a run.
        seeds: training seeds of each agent; ten give a verdict.
        out: folder of runs and report; the same call continues there.
    """
    result = compare([SB3Agent(PPO, n_steps=512), "ppo", "smdp-ppo"], room=room, seeds=seeds, primitives=primitives,
                     eval_episodes=1, out=out)
    result.plot().savefig(out / "curve.svg")
    print(result)
    for agent in result.summary.agents:
        print(f"{agent.spec.title}: efficiency {agent.efficiency:.2f} after {agent.decisions:,.0f} decisions")
    print(f"curve: {out / 'curve.svg'}, report: {result.report(out)}")


if __name__ == "__main__":  # required, because the runs start processes that import this file
    tyro.cli(main)
