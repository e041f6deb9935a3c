"""Rules of the page "Do options help?"."""

from __future__ import annotations

from studies.publishing import Rules

STUDIES = ("price", "why", "league", "flat-ppo")
RULES: Rules = {
    "options-cost-less": lambda n: min(found.low for found in n.price.factors["efficient"].values()) >= 25,
    "give-options": lambda n: (min(found.low for found in n.price.factors["efficient"].values()) > 1
                               and all(found.low > 1 for found in n.why.exploring["escape"].values())),
    "first-escape": lambda n: all(found.low > 1 and found.p < 0.05 for found in n.price.factors["escape"].values()),
    "first-escape-is-chance": lambda n: n.price.walk[1].low < 1 < n.price.walk[1].high,
    "few-rooms-need-no-learning": lambda n: n.price.ready[1][0] > 0 and n.price.ready[2][0] == 0,
    "search-without-training": lambda n: max(n.league.searched.values()) < 1_000,
    "exploration-sooner": lambda n: all(found.low > 1 for found in n.why.exploring["escape"].values()),
    "exploration-alike": lambda n: n.why.alike[0] >= n.why.alike[1] - 1,
    "exploration-half": lambda n: (n.why.exploring["half"][2].low > 1
                                   and n.why.exploring["half"][1].low < 1 < n.why.exploring["half"][1].high),
    "whole-options-more": lambda n: n.why.beyond["half"][2].low > 1,
    "repeats-do-less": lambda n: all(found.low > 1 for found in n.why.repeats["escape"].values()),
    "credit-alone": lambda n: all(found.low < 1 < found.high for found in n.why.credit["escape"].values()),
    "imagining-alone": lambda n: all(found.low < 1 < found.high for own in n.why.imagined.values()
                                     for found in own.values()),
    "one-flat-learner": lambda n: [label for (label, size), (arrived, runs) in n.league.efficient.items()
                                   if size == 3 and 2 * arrived >= runs] == ["dqn, patient"],
    "all-later-than-search": lambda n: min(found.low for found in n.league.later.values()) > 50,
    "ppo-novelty-longer": lambda n: n.league.longer["ppo, novelty"] == (5, 10),
    "ppo-in-corners": lambda n: n.flat_ppo.chance_corners.high < 0 and n.flat_ppo.corners["ppo"] > 0.15,
    "ppo-not-later": lambda n: n.flat_ppo.chance_escape.low < 1 < n.flat_ppo.chance_escape.high,
    "normalisation": lambda n: n.flat_ppo.remedy_corners["ppo, advantages as they are"].high < 0,
    "ppo-repeats": lambda n: (n.flat_ppo.remedy_escapes["ppo, commitment"].high < 1
                              and "ppo, commitment" in n.flat_ppo.untrained
                              and all(found.low < 0 < found.high for found in n.flat_ppo.late.values())),
    "ppo-learns-no-escape": lambda n: not any(n.flat_ppo.greedy.values()),
}
