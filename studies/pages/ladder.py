"""Rules of the page "Baselines of the ladder"."""

from __future__ import annotations

from studies.publishing import Rules

STUDIES = ("ladder",)
MODEL = "smdp-factored-r-max"
RULES: Rules = {
    "model-but-three": lambda n: [rung for rung, mean in n.ladder.means[MODEL].items() if mean < 0.9] == [
        "freight", "switchboard", "house"] and len(n.ladder.means[MODEL]) == 18,
    "report-rungs": lambda n: n.ladder.means[MODEL]["lattice"] > 0.9 and n.ladder.means[MODEL]["switchboard"] < 0.1,
    "blank": lambda n: n.ladder.blank == {MODEL: ["switchboard"]},
    "three-parents": lambda n: "house" in n.ladder.mastered[f"{MODEL}@three-parents"],
    "values-fall": lambda n: all(n.ladder.means[agent]["lattice"] < 0.1 for agent in ("smdp-q-learning", "smdp-ppo")),
    "beyond-search": lambda n: {agent for agent, (found, _) in n.ladder.beyond.items() if found.sign > 0} == {
        MODEL, f"{MODEL}@three-parents", "smdp-dqn", "smdp-r-max"},
    "random-options-low": lambda n: {rung for rung, mean in n.ladder.means["random-options"].items()
                                     if mean >= 0.5} == {"doormat"},
    "no-rung-out-of-order": lambda n: not any(step.p < 0.05 and step.change > 0 for step in n.ladder.steps),
    "numbers-hold-no-order": lambda n: not any(p < 0.05 and gain > 0 for gain, p in n.ladder.orders.values()),
}
