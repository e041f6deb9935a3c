"""Share of meta-actions that end `reached` when primitives are noisy, slip, or obey physics.

Run: `python benchmarks/meta_actions.py --runs 200` (a minute or two on one core). Random meta-actions are
run one after another in generated rooms; a room is left when it is escaped. Prints, for each family
and dynamics, the share that reached, why others did not, and what the runs cost.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections import Counter

import numpy as np

from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.options.options_env import OptionsEnv

DYNAMICS = {
    "exact": {},
    "noise 0.1, slip 0.1": {"noise": 0.1, "slip": 0.1},
    "physics": {"kind": "physics"},
    "physics, noise 0.1, slip 0.1": {"kind": "physics", "noise": 0.1, "slip": 0.1},
}
FAMILIES = ("paper-two-button", "four-button-chain", "clutter", "arm-two-button")
PUSHES = "push-block"  # physics by itself; seconds of planning a push, so only if asked for
A_ROOM = 10


def measure(name: str, dynamics: dict, runs: int, first: int) -> dict[str, float | str]:
    """Run random meta-actions; an option that ends with its episode counts only if the robot escaped."""
    config = get_preset(name)
    config = dataclasses.replace(config, dynamics=dataclasses.replace(config.dynamics, **dynamics))
    rng, ends, primitives, replans, seed = np.random.default_rng(first), Counter(), 0, 0, first
    planning, began = 0.0, time.perf_counter()
    while sum(ends.values()) < runs:
        env = OptionsEnv(EscapeRoomEnv(instance=generate(config, seed)), include_primitives=False)
        _, info = env.reset(seed=seed)
        for _ in range(A_ROOM):
            legal = np.flatnonzero(info["action_mask"])
            _, _, terminated, truncated, info = env.step(int(rng.choice(legal)))
            option = info["option"]
            ends["reached" if option["ended"] == "reached" or terminated else option["ended"]] += 1
            primitives, replans = primitives + info["duration"], replans + env.planning_report.replans
            planning += env.planning_report.planner_seconds
            if option["reason"]:
                print(f"\n{name}, seed {seed}, {option['name']}: {option['reason']}")
            if terminated or truncated or sum(ends.values()) == runs:
                break
        env.close()
        seed += 1
    count = sum(ends.values())
    return {"reached": ends["reached"] / count, "ends": dict(ends), "primitives": primitives / count,
            "replans": replans / count, "planning ms": 1000 * planning / count,
            "seconds": time.perf_counter() - began}


def main() -> None:
    """Measure every family under every dynamics."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=200, help="meta-actions of each family and dynamics")
    parser.add_argument("--family", choices=(*FAMILIES, PUSHES), help="only this family")
    parser.add_argument("--dynamics", choices=DYNAMICS, help="only these dynamics")
    parser.add_argument("--first", type=int, default=0, help="first instance seed")
    arguments = parser.parse_args()
    for name in (arguments.family,) if arguments.family else FAMILIES:
        for label, dynamics in DYNAMICS.items():
            if arguments.dynamics in (None, label):
                found = measure(name, dynamics, arguments.runs, arguments.first)
                print(f"{name:18} {label:28} reached {found['reached']:6.1%}  {found['primitives']:5.1f} primitives  "
                      f"{found['replans']:5.2f} replans  {found['planning ms']:6.1f} ms planning  {found['ends']}",
                      flush=True)


if __name__ == "__main__":
    main()
