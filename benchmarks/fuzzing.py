"""Thousands of calls of the public API with states, goals and arguments of right and wrong kinds and ranges.

Run: `python -m benchmarks.fuzzing --count 20000`. The calls are listed in `tests/fuzzing.py`. An error
that is neither the package's nor Gymnasium's is printed with its call; exits with 1 if there was one.
"""

from __future__ import annotations

import argparse
import faulthandler
import sys
import traceback
from collections import Counter
from typing import Any

from hypothesis import HealthCheck, Phase, given, seed, settings

from tests.fuzzing import make_calls, run_call


def main() -> int:
    """Make the calls and count how they end."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=20_000, help="calls")
    parser.add_argument("--seed", type=int, default=0, help="seed of the calls")
    args = parser.parse_args()
    faulthandler.enable()
    ends: Counter[str] = Counter()

    @seed(args.seed)
    @settings(max_examples=args.count, deadline=None, database=None, phases=[Phase.generate],
              suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much, HealthCheck.data_too_large])
    @given(call=make_calls())
    def fuzz(call: tuple[str, str, tuple[Any, ...]]) -> None:
        try:
            ends["answered" if run_call(call) else "refused"] += 1
        except Exception:
            ends["raw"] += 1
            print(f"{call!r}\n{traceback.format_exc()}", flush=True)
        if ends.total() % 1000 == 0:
            print(f"{ends.total()} calls: {dict(ends)}", flush=True)

    fuzz()
    print(f"{ends.total()} calls: {ends['answered']} answered, {ends['refused']} refused, {ends['raw']} raw tracebacks")
    return 0 if ends["raw"] == 0 else 1


if __name__ == "__main__":
    sys.exit(main())
