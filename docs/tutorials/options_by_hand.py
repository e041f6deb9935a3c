"""Write options by hand.

An option has three parts: an initiation set, a policy and a termination, written (I, pi, beta) by Sutton, Precup and
Singh (1999). This tutorial writes two options.
"""

import gymnasium

from hrl_escape import OptionsEnv
from hrl_escape.benchmark import RecordedEpisode
from hrl_escape.benchmark.episodes import StateRecorder
from hrl_escape.checks import check_option
from hrl_escape.options.option import Option, ScriptedOption

# The simplest option is a fixed list of primitives. Nine left turns make a quarter turn of 90 degrees.

quarter_turn = ScriptedOption("quarter-turn", [4] * 9)

# A better option reads the state. This one crosses the room sideways. Its `policy` and `termination` are functions of
# the state alone, which `is_markov` declares; intra-option learning requires this.


class Cross(Option):
    """Strafe to the wall on one side; available only while the robot looks along +x."""

    is_markov = True

    def __init__(self, name, primitive, edge):
        super().__init__(name)
        self.primitive, self.edge = primitive, edge

    def initiation(self, state):
        """Wherever the heading is 0 and it has not arrived."""
        return state.heading_steps % 36 == 0 and not self.has_arrived(state)

    def policy(self, state):
        """Always the same primitive."""
        return self.primitive

    def termination(self, state):
        """1 where it has arrived, else 0."""
        return float(self.has_arrived(state))

    def has_arrived(self, state):
        """Look at one coordinate."""
        return state.y >= self.edge if self.edge > 0 else state.y <= self.edge


env = gymnasium.make("hrl_escape/EscapeRoom-v1", config="paper-two-button")
north, south = Cross("to-the-left-wall", 2, 8.0), Cross("to-the-right-wall", 3, -8.0)
check_option(north, env)  # the contract, as a check that you can run on your own
env.unwrapped.instance

# `OptionsEnv` offers them in addition to the primitives. One `step` runs one of them to its end. `info` holds the SMDP
# transition: the duration k, the sum of gamma^i r_i, and the discount gamma^k.

recorder = StateRecorder(env)  # keeps every state, to play them below
env = OptionsEnv(recorder, [north, south, quarter_turn], discount=0.99)
_, info = env.reset(seed=0)
print(f"{len(env.action_names)} actions; the last: {', '.join(env.action_names[-3:])}")
decisions, total = [], 0.0
left, right, turn = "to-the-left-wall", "to-the-right-wall", "quarter-turn"
for name in (left, left, right, turn, left):
    action = env.action_names.index(name)
    if not info["action_mask"][action]:
        print(f"{name}: cannot start here")
        continue
    _, reward, _, _, info = env.step(action)
    print(f"{name}: {info['duration']} primitives, {info['option']['ended']}, reward {reward:g}, "
          f"discounted {info['discounted_reward']:.2f}, gamma^k {info['discount']:.3f}")
    decisions.append((name, info["duration"], info["option"]["ended"]))
    total += reward

# An option that cannot start is masked, so every option keeps its number. Choosing a masked option costs one primitive,
# because waiting must not be free. The episode from above:

RecordedEpisode(env.unwrapped.instance, tuple(recorder.states), tuple(decisions), total, success=False)
