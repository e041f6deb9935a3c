r"""SMDP Q-learning from scratch in 60 lines.

Q-learning backs up r + gamma max Q(s', a'). If an action lasts k primitives, two things change. The reward becomes the
discounted sum of the k primitive rewards, and the next value is discounted by gamma^k:

$$
Q(s,o) \leftarrow Q(s,o) + \alpha \left[ \sum_{i<k} \gamma^i r_i + \gamma^k \max_{o'} Q(s',o') - Q(s,o) \right]
$$
"""

import gymnasium
import numpy as np

from hrl_escape import OptionsEnv
from hrl_escape.figures import get_figure_class

GAMMA, ALPHA, EPSILON, EPISODES = 0.99, 0.5, 0.2, 40

env = OptionsEnv(gymnasium.make("hrl_escape/PaperTwoButton-v1", observation="features"),
                 discount=GAMMA, include_primitives=False)
rng = np.random.default_rng(0)
table = {}  # rounded observation -> Q of every option
env.unwrapped.instance

# The three functions of tabular Q-learning, for options:


def read(observation):
    """The row of a state."""
    return table.setdefault(tuple(np.round(observation * 4).astype(int)), np.zeros(env.action_space.n))


def choose(observation, mask, epsilon):
    """Epsilon-greedy among what is legal here."""
    if rng.random() < epsilon:
        return int(rng.choice(np.flatnonzero(mask)))
    return int(np.argmax(np.where(mask, read(observation), -np.inf)))


def play(seed, learn):
    """One episode; returns its undiscounted return and the options chosen."""
    observation, info = env.reset(seed=seed)
    total, names, ended = 0.0, [], False
    while not ended:
        mask = info["action_mask"]
        option = choose(observation, mask, EPSILON if learn else 0.0)
        state, (observation, reward, terminated, truncated, info) = read(observation), env.step(option)
        total, ended = total + reward, terminated or truncated
        names.append(info["option"]["name"])
        if learn:
            following = np.where(info["action_mask"], read(observation), -np.inf).max()
            # Only termination sets the next value to zero; a truncated episode keeps it.
            # Discounting is per primitive, not per decision.
            target = info["discounted_reward"] + info["discount"] * (0.0 if terminated else following)
            state[option] += ALPHA * (target - state[option])
    return total, names


returns = []
for episode in range(EPISODES):
    total, names = play(seed=episode, learn=True)
    returns.append(total)
    if episode in (0, 1, 2, 5, 10, 20, 39):
        print(f"episode {episode:2}: return {total:5g} in {len(names)} decisions")

# Without exploration:

total, names = play(seed=99, learn=False)
print(f"greedy: return {total:g} by {', then '.join(names)}")

figure = get_figure_class()(figsize=(5.6, 2.6), layout="constrained")
figure.add_subplot(xlabel="episode", ylabel="return while exploring").plot(returns, marker="o")
figure

# The packaged `smdp-q-learning` makes the same backup. It adds decaying exploration, checkpoints and evaluation.
