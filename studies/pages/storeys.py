"""Rules of the page on room sequences."""

from __future__ import annotations

from typing import Any

from studies.publishing import Rules

STUDIES = ("storeys",)


def does_memory_pay(numbers: Any) -> bool:
    """Efficiency rises for the planner that remembers, and for neither reference that forgets."""
    found = numbers.storeys
    return found.remembering.low > 0 and all(own.low <= 0 <= own.high for own in (found.forgetting, found.searching))


RULES: Rules = {"memory-pays": does_memory_pay, "report-both-ends": does_memory_pay}
