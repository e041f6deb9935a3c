"""Rules of the page "The ladder at its own budgets"."""

from __future__ import annotations

from studies.publishing import Rules

STUDIES = ("budgets",)
PPO, DQN, DAC, MEMORY = "smdp-ppo", "smdp-dqn", "smdp-dac", "smdp-ppo+objects+memory"
RULES: Rules = {
    "dqn-everywhere": lambda n: min(n.budgets.means[DQN].values()) > 0.85 and len(n.budgets.rungs) == 12,
    "more-updates": lambda n: (n.budgets.more[PPO].low > 0 and n.budgets.more[DQN].low > 0
                               and min(n.budgets.means[DQN].values()) > 0.85),
    "more-primitives": lambda n: n.budgets.more[PPO].low > 0 and n.budgets.more[DQN].low > 0,
    "beyond-search": lambda n: all(found.sign > 0 for found, _ in n.budgets.beyond.values())
    and len(n.budgets.beyond) == 4,
    "policies-at-ten": lambda n: all(n.budgets.means[agent]["lattice"] < 0.6 for agent in (PPO, DAC, MEMORY)),
}
