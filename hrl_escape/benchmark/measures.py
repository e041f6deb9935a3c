"""Numbers that agents of a comparison are compared by: efficiency in rooms, success rate or return elsewhere."""

from __future__ import annotations

import math
from typing import NamedTuple

from hrl_escape.benchmark.inference import Estimate


class Measure(NamedTuple):
    """Final value that agents are compared by, with its words."""

    metric: str  # of `RunResult.get_final`
    curve: str  # of `Curve.metrics`
    name: str  # in sentences and on axes
    article: str  # before the name
    better: str  # between two labels, where the first has a higher value
    verb: str  # of an episode that reaches its goal
    noun: str  # of the same
    digits: str  # format of a value
    largest: float  # largest difference of two values
    interval: str  # of its estimates, in words

    def format(self, value: float) -> str:
        """Format a value."""
        return format(value, self.digits)

    def describe(self, estimate: Estimate) -> str:
        """Format an estimate with its interval."""
        return f"{estimate:{self.digits}}"


EFFICIENCY = Measure("efficiency", "efficiency", "efficiency", "an", "is more efficient than", "escape", "escape",
                     ".2f", 1.0, "IQM, 95 % interval")
SUCCESS = Measure("success_rate", "success", "success rate", "a", "succeeds more often than", "succeed", "success",
                  ".2f", 1.0, "mean, 95 % interval")
RETURN = Measure("mean_return", "return", "return", "a", "has a higher return than", "succeed", "success",
                 ".4g", math.inf, "mean, 95 % t interval")
