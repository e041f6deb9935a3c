"""Rules of the page "All algorithms on the same rooms"."""

from __future__ import annotations

from studies.publishing import Rules

STUDIES = ("canon", "hierarchies", "learned", "intra-option")
MODELS = ("smdp-r-max", "smdp-factored-r-max", "smdp-met-r-max", "smdp-vigorito-barto", "smdp-monte-carlo-model")
GIVEN = ("maxq-q+planned", "hamq+planned", "h-dqn@table+planned")
RULES: Rules = {
    "bounded": lambda n: min(n.canon.means["smdp-r-max"].values()) > 0.9,
    "learn-a-model": lambda n: min(n.canon.means["smdp-r-max"].values()) > 0.9,
    "models-lead": lambda n: min(min(n.canon.means[label].values()) for label in MODELS) > 0.85,
    "networks-fall": lambda n: all(n.canon.means[label]["ladder-2/violations-4"] < 0.3 and
                                   n.canon.means[label]["ladder-1/lattice"] < 0.4 for label in
                                   ("smdp-dqn", "smdp-ppo", "smdp-rainbow", "smdp-sarsa", "smdp-ddpg")),
    "beyond-search": lambda n: sum(found.sign > 0 for found in n.canon.beyond.values()) == 7,
    "given-lead": lambda n: all(min(n.canon.means[label].values()) > 0.9 for label in GIVEN),
    "moves-fail": lambda n: (n.canon.lost_moves, n.canon.moves) == (19, 27) and n.canon.most_of_moves < 0.25,
    "structure-alone": lambda n: not any(n.hierarchies.success[agent] for each in
                                         n.hierarchies.questions["Structure alone"].values()
                                         for agent in (each.agent, each.other)),
    "structure-given": lambda n: all(each.is_better for each in n.hierarchies.questions[
        "Structure where a planner walks anyway"].values()),
    "intra-option-equal": lambda n: all(
        each.is_same for each in n.intra_option.questions["Learning inside options that follow plans"].values()),
}
