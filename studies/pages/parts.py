"""Rules of the page on the parts of a hierarchy."""

from __future__ import annotations

import math
from typing import Any

from studies.parts.reach import BASELINE, FULL, LIMIT, RULE, STRUCTURED
from studies.publishing import Rules

STUDIES = ("parts", "crossover")
FOUR_TO_FIFTEEN = (4, 6, 8, 10, 15)


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
    """The ratio is below 1 with four to 15 buttons under both rules, over all rooms."""
    return all(numbers.crossover.ratios[rule]["all"][size].high < 1 for rule in ("ignore", "reset")
               for size in FOUR_TO_FIFTEEN)


def does_only_search_escape_everywhere(numbers: Any) -> bool:
    """With 15 buttons and resets, all runs of search with memory escape, not all of the learner, none that forgets."""
    found = numbers.crossover.ratios["reset"]["all"][15]
    escaped, made = numbers.parts.first.escapes[BASELINE, RULE].get(15, (0, 1))
    return found.search == found.rooms > found.learner and not escaped and made > 0


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
}
