"""Push blocks onto their plates and leave, from hundreds of starts, by meta-actions alone.

Run: `python benchmarks/push_block.py --count 200` (about five minutes on one core). Each start is an
instance and an episode of the preset `push-block`, escaped in closed loop. A push that undoes an
earlier one counts as a fault, whether the robot escapes in the end or not. Exits with 1 if any start
was not escaped, or any push undone.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from typing import Any

from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.push_block import PushBlockConfig
from hrl_escape.errors import PlanningFailed
from hrl_escape.options.closed_loop import pursue


def escape(seed: int, blocks: int) -> dict[str, Any]:
    """Escape from one start; returns the outcome."""
    config = dataclasses.replace(get_preset("push-block"), puzzle=PushBlockConfig(count=blocks))
    env = EscapeRoomEnv(config, instance_seed=seed)
    began = time.perf_counter()
    try:
        env.reset(seed=seed)
        run = pursue(env)
    except PlanningFailed as failure:
        return {"escaped": False, "undone": 0, "primitives": 0, "seconds": time.perf_counter() - began,
                "why": str(failure)}
    finally:
        env.close()
    facts = [env.instance.puzzle.symbolic.get_facts(state.puzzle) for state in run.states]
    undone = sum(not before <= after for before, after in zip(facts[:-1], facts[1:], strict=True))
    why = "" if run.escaped else "; ".join(f"{d['name']} {d['ended']} {d['reason']}" for d in run.decisions[-3:])
    return {"escaped": run.escaped, "undone": undone, "primitives": len(run.rewards),
            "seconds": time.perf_counter() - began, "why": why}


def main() -> int:
    """Escape from start after start."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=200, help="starts")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--blocks", type=int, default=1, help="blocks in each room, each with a plate")
    arguments = parser.parse_args()
    rows = []
    for seed in range(arguments.first, arguments.first + arguments.count):
        rows.append(escape(seed, arguments.blocks))
        if not rows[-1]["escaped"] or rows[-1]["undone"]:
            print(f"seed {seed}: {rows[-1]}", flush=True)
    escaped = sum(bool(row["escaped"]) for row in rows)
    undone = sum(row["undone"] for row in rows)
    seconds = sorted(row["seconds"] for row in rows)
    print(f"escaped {escaped} of {len(rows)} starts, {undone} pushes undone, "
          f"{seconds[len(rows) // 2]:.1f} s in the median and {seconds[-1]:.1f} s at most")
    return 0 if escaped == len(rows) and not undone else 1


if __name__ == "__main__":
    sys.exit(main())
