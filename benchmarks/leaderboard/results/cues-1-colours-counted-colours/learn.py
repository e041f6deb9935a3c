"""Count at which place of the order each colour lights up, in 32 training rooms, with the rule of agent.py to play."""

import collections
import json

import gymnasium

import hrl_escape  # noqa: F401  # registers the environment

COLOURS = ("red", "blue", "green", "yellow", "purple", "cyan", "orange", "black")
env = gymnasium.make("hrl_escape/Ladder-v1", benchmark="cues-1@0", rung="colours", set="train", slice="0..32",
                     observation="objects", options={"include_primitives": False}, disable_env_checker=True)
words = list(env.observation_space.words)
counts, primitives = collections.defaultdict(collections.Counter), 0
for room in range(32):
    observation, info = env.reset(seed=room, options={"instance_index": room})
    tried, lights, place, is_over = set(), None, 0, False
    while not is_over:
        rows = [dict(zip(words, observation[at:])) for at in range(0, env.action_space.n * len(words), len(words))]
        lit = [row["lit"] for row in rows]
        for row, now, before in zip(rows, lit, lights or lit):
            if now > before and not row["exit"]:
                counts[next(colour for colour in COLOURS if row[colour])][place] += 1
                place += 1
        tried, lights = (tried if lit == lights else set()), lit
        legal = [action for action, is_legal in enumerate(info["action_mask"]) if is_legal]
        action = min(legal, key=lambda action: (
            not (lit[action] if rows[action]["exit"] else not lit[action] and action not in tried),
            rows[action]["ahead"] ** 2 + rows[action]["left"] ** 2))
        tried.add(action)
        observation, _, terminated, truncated, info = env.step(action)
        is_over, primitives = terminated or truncated, primitives + info["duration"]
ranks = {colour: found.most_common(1)[0][0] for colour, found in sorted(counts.items())}
with open("ranks.json", "w") as file:
    json.dump(ranks, file)
print(f"{primitives} primitives: {ranks}")
