"""Rules of the page on learned structure: parts of a hierarchy, search with equal information, and sizes."""

from __future__ import annotations

import math
from typing import Any

from studies.parts.reach import BASELINE, FULL, LIMIT, RULE, STRUCTURED
from studies.publishing import Rules
from studies.scaling.rounds import HOLDS

STUDIES = ("parts", "crossover", "buttons", "scaling")
FROM_FOUR = (4, 6, 8, 10, 15, 20)
FACTORED, MONTE_CARLO = "smdp-factored-r-max", "smdp-monte-carlo-model"


def is_search_fastest(numbers: Any) -> bool:
    """With 3 to `LIMIT` buttons the search baseline has the lowest median, in the first and in the fresh rooms."""
    cells = [cell["name"] for cell in numbers.parts.data["cells"] if "reference" not in cell]
    return all(own.medians[BASELINE, RULE][size] < own.medians[cell, RULE].get(size, math.inf)
               for own in (numbers.parts.first, numbers.parts.fresh) for cell in cells
               for size in numbers.parts.data["sizes"] if 3 <= size <= LIMIT)


def does_structure_alone_escape(numbers: Any) -> bool:
    """Beyond `LIMIT` buttons no run without structure escapes, and half of the runs with all parts or more do.

    Some run without structure must have been made there, for a run that was never made is not data.
    """
    return all(_stops_others(own.escapes) for own in (numbers.parts.first, numbers.parts.fresh))


def _stops_others(escapes: dict[tuple[str, str], dict[int, tuple[int, int]]]) -> bool:
    beyond = {cell: {size: count for size, count in own.items() if size > LIMIT}
              for (cell, rule), own in escapes.items() if rule == RULE}
    without = [escaped for cell, own in beyond.items() if cell not in STRUCTURED for escaped, _ in own.values()]
    return bool(without) and not any(without) and len(beyond[FULL]) > 1 and all(
        2 * escaped >= made for escaped, made in beyond[FULL].values())


def does_structure_pay_late(numbers: Any) -> bool:
    """If wrong presses have no effect, structure changes nothing up to 15 buttons, and with 20 no other run escapes."""
    ratios = numbers.parts.first.ratios["options + structure", "options", "ignore"]
    return all(ratio.median == 1 for size, ratio in ratios.items() if size <= 15) and not (
        numbers.parts.first.escapes["options", "ignore"][20][0])


def does_search_win_without_resets(numbers: Any) -> bool:
    """Without resets, the search baseline escapes from all rooms, sooner than all parts from four buttons on."""
    first = numbers.parts.first
    ratios = first.ratios[FULL, "untried-nearest", "ignore"]
    return all(escaped == made for escaped, made in first.escapes["untried-nearest", "ignore"].values()) and all(
        ratio.median < 1 for size, ratio in ratios.items() if size >= 4)


def do_planned_walks_pay(numbers: Any) -> bool:
    """Planned walks need at most a thirtieth of the primitives of committed ones at every size, under both rules."""
    return all(ratio.median > 30 for rule in ("ignore", "reset")
               for ratio in numbers.parts.first.ratios["options", "flat + commitment", rule].values() if ratio.rooms)


def is_search_with_memory_faster(numbers: Any) -> bool:
    """The ratio is below 1 from four to 20 buttons under both rules, in all rooms and in each slice of them."""
    return all(own[size].high < 1 for rule in ("ignore", "reset") for own in numbers.crossover.ratios[rule].values()
               for size in FROM_FOUR)


def does_only_search_escape_everywhere(numbers: Any) -> bool:
    """With 15 and 20 buttons and resets, all runs of search with memory escape, and not all of the learner.

    Search that forgets was run with 15, and none of its runs escapes.
    """
    escaped, made = numbers.parts.first.escapes[BASELINE, RULE].get(15, (0, 0))
    return all(found.search == found.rooms > found.learner for size in (15, 20)
               for found in [numbers.crossover.ratios["reset"]["all"][size]]) and not escaped and made > 0


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


def is_the_bar_passed(numbers: Any) -> bool:
    """All runs in both rooms of the bar, and all fresh ones, come near the best with the whole graph."""
    return all(own.runs >= 10 and own.near_best == own.whole == own.escaped == own.runs for own in numbers.scaling.bar)


def do_too_few_parents_fail(numbers: Any) -> bool:
    """Given one parent it finds the whole graph in 3 of 10 runs at most, given two or more in 9 or more."""
    given = numbers.scaling.given
    few = [whole / made for (_, label), (whole, made) in given.items() if label.endswith(", 1")]
    enough = [whole / made for (_, label), (whole, made) in given.items() if not label.endswith(", 1")]
    return bool(few) and max(few) <= 0.3 and min(enough) >= 0.9


def does_more_cost(numbers: Any) -> bool:
    """No replacement of the true condition or number of parents saves primitives, and some cost primitives."""
    signs = {cost.sign for (_, label), cost in numbers.scaling.costs.items() if label != HOLDS}
    return -1 not in signs and 1 in signs


def _escape(numbers: Any, rule: str, agent: str, size: int) -> bool:
    return all(numbers.scaling.escapes[rule, agent, size].observed)


def do_models_go_furthest(numbers: Any) -> bool:
    """Only these two escape in all runs with 20 buttons under `ignore`, and with 15 under `reset` only one does."""
    agents = numbers.scaling.data["agents"]
    return [agent for agent in agents if ("ignore", agent, 20) in numbers.scaling.escapes
            and _escape(numbers, "ignore", agent, 20)] == [FACTORED, MONTE_CARLO] and [
        agent for agent in agents if ("reset", agent, 15) in numbers.scaling.escapes
        and _escape(numbers, "reset", agent, 15)] == [MONTE_CARLO]


RULES: Rules = {
    "search-with-memory-is-faster": is_search_with_memory_faster,
    "no-crossover": is_search_with_memory_faster,
    "fifteen-buttons": does_only_search_escape_everywhere,
    "search-is-fastest-up-to-ten-buttons": is_search_fastest,
    "only-structure-escapes-beyond-ten": does_structure_alone_escape,
    "takeaway": lambda numbers: is_search_with_memory_faster(numbers) and does_structure_alone_escape(numbers),
    "structure-pays-late": does_structure_pay_late,
    "search-wins-without-resets": does_search_win_without_resets,
    "planned-walks-pay": do_planned_walks_pay,
    "search-is-first": is_search_first,
    "search-is-quicker": is_search_quicker,
    "two-reach-the-end": do_two_reach_the_end,
    "others-stop": do_others_stop,
    "the-bar-is-passed": is_the_bar_passed,
    "give-enough-parents": do_too_few_parents_fail,
    "more-costs": does_more_cost,
    "models-go-furthest": do_models_go_furthest,
}
