"""Rules of the page "What each learner is good at"."""

from __future__ import annotations

from studies.publishing import Rules

STUDIES = ("profiles",)
TABLE, MODEL = "smdp-q-learning", "smdp-factored-r-max"
RULES: Rules = {
    "leaders": lambda n: {axis: agent for axis, agent in n.profiles.leaders.items() if agent} == {
        "depth": MODEL, "branching": MODEL, "violations": MODEL, "undoing": TABLE} and len(n.profiles.axes) == 11,
    "give-a-profile": lambda n: (any(n.profiles.gains[axis, TABLE, MODEL].is_shown for axis in n.profiles.axes)
                                 and any(n.profiles.gains[axis, MODEL, TABLE].is_shown for axis in n.profiles.axes)),
    "crossing": lambda n: [[axis for axis in n.profiles.axes if n.profiles.gains[axis, one, other].is_shown]
                           for one, other in ((TABLE, MODEL), (MODEL, TABLE))] == [
        ["noise", "undoing", "memory"], ["depth", "branching", "violations"]],
    "three-without-headroom": lambda n: all(min(means[axis] for agent, means in n.profiles.means.items()
                                                if agent.startswith("smdp-") and "+" not in agent) > 0.95
                                            for axis in ("motion", "arm", "perception")),
    "falls": lambda n: all(len(own) >= 3 for own in n.profiles.falls.values()),
    "moves-below": lambda n: n.profiles.below == ["motion", "arm", "perception"],
    "beyond-search": lambda n: set(n.profiles.axes) - set(n.profiles.beyond) == {"motion", "arm", "perception"},
}
