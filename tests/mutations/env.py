"""Bugs of rooms, engines and observations."""

from tests.mutations.mutation import Mutation

MUTATIONS = [
    Mutation(
        "a press out of order turns off only its own button",
        "env/puzzles/buttons.py",
        'elif self.on_violation == "reset":\n                state = 0',
        'elif self.on_violation == "reset":\n                state &= ~bit',
        "env/puzzles/test_buttons.py",
    ),
    Mutation(
        "one parent is enough",
        "env/puzzles/buttons.py",
        "elif self.parent_masks[button] & ~state == 0 and",
        "elif (not self.parent_masks[button] or self.parent_masks[button] & state) and",
        "env/puzzles/test_buttons.py",
    ),
    Mutation(
        "locks may shut every way",
        "env/puzzles/graphs.py",
        "if place[b] < place[a] and a not in needs[b]",
        "if a not in needs[b]",
        "env/puzzles/test_buttons.py",
    ),
    Mutation(
        "the goal keeps its number when the others are shuffled",
        "env/puzzles/graphs.py",
        ", label[last]\n",
        ", last\n",
        "env/puzzles/test_buttons.py env/puzzles/test_graphs.py",
    ),
    Mutation(
        "a wrong bit stays on",
        "env/puzzles/bit_flip.py",
        "state &= ~(lower | 1 << bit)",
        "state &= ~lower",
        "env/puzzles/test_bit_flip.py",
    ),
    Mutation(
        "every button of a layer has one parent",
        "env/puzzles/graphs.py",
        "number = int(rng.integers(1, min(len(above), config.max_parents) + 1))",
        "number = int(rng.integers(1, 2))",
        "env/puzzles/test_graphs.py",
    ),
    Mutation(
        "the horizon is one primitive late",
        "env/kinematics.py",
        "not terminated and count >= self._horizon",
        "not terminated and count > self._horizon",
        "env/test_escape_room.py env/test_kinematics.py",
    ),
    Mutation(
        "a target touched at the start is pressed by the first primitive",
        "env/kinematics.py",
        "touching = self.compute_touching(start.x, start.y, start.heading_steps, start.heading_offset, steps, ())",
        "touching = 0",
        "env/test_kinematics.py env/test_escape_room.py",
    ),
    Mutation(
        "the exit's reward never replaces the step's",
        "env/kinematics.py",
        "reward.exit if reward.exit_replaces_step else reward.step + reward.exit",
        "reward.step + reward.exit",
        "env/test_kinematics.py env/test_escape_room.py env/test_engines_agree.py",
    ),
    Mutation(
        "joints have no lower limit",
        "env/kinematics.py",
        "if not self.robot.step_low[joint] <= steps[joint] <= self.robot.step_high[joint]:",
        "if not steps[joint] <= self.robot.step_high[joint]:",
        "env/test_kinematics.py env/test_engines_agree.py",
    ),
    Mutation(
        "what an observer remembers of a puzzle has no bound",
        "env/observations.py",
        "if len(self._seen) > 4096:",
        "if False:",
        "env/test_observations.py",
    ),
]
