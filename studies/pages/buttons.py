"""Rules of the page on first escapes and buttons."""

from __future__ import annotations

import math
from typing import Any

from studies.publishing import Rules

STUDIES = ("buttons",)


def is_search_first(numbers: Any) -> bool:
    """The search baseline has the lowest median with every number of buttons."""
    sizes, searcher = numbers.buttons.sizes, numbers.buttons.data["searcher"]
    return all(found.median < own[size].median for size, found in sizes[searcher].items()
               for agent, own in sizes.items() if agent != searcher and size in own)


def is_search_quicker(numbers: Any) -> bool:
    """With the most buttons it needs less than half of the primitives of learned structure, room by room."""
    ratio = numbers.buttons.ratio
    return is_search_first(numbers) and ratio.p < 0.05 and 0.36 <= ratio.mean < 0.5


def do_two_reach_the_end(numbers: Any) -> bool:
    """All runs of search and of learned structure escape from every room."""
    of = numbers.buttons
    return all(own.escaped == own.made for agent in (of.data["searcher"], of.data["structure"])
               for own in of.sizes[agent].values())


def do_others_stop(numbers: Any) -> bool:
    """Half of the runs escape up to 4, 12 and 15 buttons, and fewer beyond."""
    reach = numbers.buttons.reach
    return [reach[agent] for agent in ("dqn@patient", "smdp-dqn", "smdp-ppo+objects+memory")] == [4, 12, 15] and (
        all(math.isinf(numbers.buttons.sizes[agent][20].median) for agent in ("smdp-dqn", "smdp-ppo+objects+memory")))


RULES: Rules = {
    "search-is-first": is_search_first,
    "compare-with-search": is_search_quicker,
    "search-is-quicker": is_search_quicker,
    "two-reach-the-end": do_two_reach_the_end,
    "others-stop": do_others_stop,
}
