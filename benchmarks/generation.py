"""CPU time that sampling a room costs, over room configurations drawn from the whole range of their fields.

    python benchmarks/generation.py --count 300

Prints how many were sampled or refused, quantiles of CPU seconds, and the dearest room configuration. The issue of a
room configuration is decided by counted work (`LARGEST_WORK`), never by these seconds.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np

from hrl_escape.env.config import RoomConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ConfigError, GenerationError


def draw_config(rng: np.random.Generator) -> RoomConfig:
    """Room configuration with every field of weight for sampling drawn from its range, small and large ones alike."""
    while True:
        try:
            return RoomConfig.from_dict(_draw_fields(rng))
        except ConfigError:
            continue


def _draw_fields(rng: np.random.Generator) -> dict[str, Any]:
    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    def whole(low: int, high: int) -> int:
        return min(max(round(between(low, high + 0.5)), low), high)

    hand = bool(rng.random() < 0.2)
    count = whole(1, 64)
    return {
        "room": {"width": between(5, 200), "depth": between(5, 200), "rooms": whole(1, 16),
                 "doorway_width": between(1, 10)},
        "robot": {"body_radius": between(0.1, 1.5), "joints": whole(1, 7) if hand else 0,
                  "move_step": between(0.1, 3), "turn_step_deg": float(rng.choice([5, 10, 15, 30, 45, 90]))},
        "puzzle": {"kind": "buttons", "count": count, "allow_off": bool(rng.random() < 0.2),
                   "on_violation": str(rng.choice(["ignore", "reset"])),
                   "buttons": {"width": between(0.1, 5), "height": between(0.2, 2)}},
        "obstacles": {"count": whole(1, 200) if rng.random() < 0.7 else 0, "size_max": between(0.5, 5)},
        "start": {"choices": whole(1, 10_000) if rng.random() < 0.3 else 1},
        "exit": {"door": bool(rng.random() < 0.3), "width": between(1, 5), "depth": between(0.5, 5)},
        "dynamics": {"press_with": "hand" if hand else "body"},
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    rng, rows, refused = np.random.default_rng(args.seed), [], 0
    for number in range(args.count):
        config = draw_config(rng)
        began = time.process_time()
        try:
            generate(config, number)
        except GenerationError:
            refused += 1
        rows.append((time.process_time() - began, config))
    seconds = np.array([row[0] for row in rows])
    print(f"{args.count - refused} sampled, {refused} refused")
    print("CPU seconds: " + ", ".join(f"p{q} {np.quantile(seconds, q / 100):.3f}" for q in (50, 90, 99, 100)))
    print("dearest:", rows[int(seconds.argmax())][1].to_dict())


if __name__ == "__main__":
    main()
