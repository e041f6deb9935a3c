"""Learn from your own play.

`hrl-escape play` opens a room in the browser. M and a number run an option, and F saves the episode to the folder
`episodes`. Here a script plays three episodes as clumsily as a first try and saves them in the same way. Replace them
by your own files.
"""

import tempfile
from pathlib import Path

import numpy as np

from hrl_escape import train
from hrl_escape.benchmark import record_episode
from hrl_escape.data import load_data, make_played_recording, save_recording
from hrl_escape.data.card import draw_card
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.viewer.play.episode import Episode, save_episode

folder = Path(tempfile.mkdtemp())
room = generate(get_preset("paper-two-button"), 0)
TURN, FIRST, SECOND, LEAVE = 4, 6, 7, 8
for number, moves in enumerate([(SECOND, TURN, FIRST, SECOND, LEAVE), (FIRST, FIRST, SECOND, LEAVE),
                                (LEAVE, SECOND, FIRST, TURN, SECOND, TURN, LEAVE)]):
    episode = Episode(room, None, number)
    for move in moves:
        episode.do(move)
    save_episode(folder / f"mine-{number}.json", episode.to_saved())
    print(f"episode {number}: return {episode.total:g}, {episode.end.value}")
    episode.close()

# The files become a data set. Every move is a decision with its duration, and single primitives are decisions of
# duration 1. On the command line: `hrl-escape data make mine --room paper-two-button#0 --played episodes/*.json`.

recording = make_played_recording("mine", "paper-two-button#0", sorted(folder.glob("mine-*.json")))
save_recording(folder / "mine.npz", recording)
data = load_data(folder / "mine.npz", observation="features")
decisions = data.read_decisions(gamma=0.99)
print(recording)
print("durations:", decisions.duration.tolist())
draw_card(recording)

# Behaviour cloning repeats what you did most often. Fitted Q-iteration combines the best parts of your episodes: it
# finds the best way that consists of choices you made.

for agent, settings in (("smdp-behaviour-cloning+primitives", {}), ("smdp-fitted-q+primitives", {"gamma": 0.99})):
    result = train(agent, data=data, settings={"values": "table", **settings}, eval_episodes=1)
    last = result.evaluations[-1]
    print(f"{agent}: return {last.mean_return:g} after {last.lengths[0]} primitives")
print("best of your episodes:", max(np.bincount(decisions.trajectory, decisions.summed_reward)))

# The better of the two, move by move:

record_episode(result.agent, data.make_env(options=True, gamma=0.99))
