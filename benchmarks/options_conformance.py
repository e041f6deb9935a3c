"""Do batched options do what `OptionsEnv`'s do? Masked random options in many rooms, compared one by one.

    python -m benchmarks.options_conformance --json options.json              # 10 instances of every room
    python -m benchmarks.options_conformance --rooms clutter --decisions 200  # one kind

Every decision that ends in the batch is made again by `OptionsEnv` from the state it began in. What reaches its goal
there must reach it here, and on the whole take no more than 5 % more primitives.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import sys
import time
from collections.abc import Sequence

import torch

from benchmarks.findings import list_batched_rooms, load_findings
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import UnsupportedError
from hrl_escape.files import write_json
from hrl_escape.options.batched.env import ENDINGS, BatchedOptionsEnv
from hrl_escape.options.options_env import OptionsEnv
from tests.env.rooms import RECTANGLE

MOST_MORE = 0.05
OWN = {
    "blocks-world-hand": get_preset("blocks-world", hand=True),
    "rectangle": RECTANGLE,
    "rectangle-turning": dataclasses.replace(RECTANGLE, robot=dataclasses.replace(RECTANGLE.robot,
                                                                                  drive="differential")),
}
"""Rooms in addition to the presets: a hand that grips, and rectangular bases."""


@dataclasses.dataclass
class OptionAgreement:
    """Findings of a comparison.

    Attributes:
        decisions: how many were compared.
        reached: those that reached their goal under `OptionsEnv`.
        planned: primitives they took there, in all.
        taken: primitives they took in the batch.
        side_presses: decisions that pressed another target in the batch and not under `OptionsEnv`.
        missed: what was reached there and not in the batch, or masked differently, in words.
        seconds: processor seconds to compute the fields, to step the batch, to step `OptionsEnv`.
    """

    decisions: int = 0
    reached: int = 0
    planned: int = 0
    taken: int = 0
    side_presses: int = 0
    missed: list[str] = dataclasses.field(default_factory=list)
    seconds: list[float] = dataclasses.field(default_factory=list)

    @property
    def more(self) -> float:
        """Share of primitives that the batch took more."""
        return self.taken / max(self.planned, 1) - 1.0

    @property
    def is_good(self) -> bool:
        """Nothing missed, and few primitives more."""
        return not self.missed and self.more <= MOST_MORE


def compare_options(instances: Sequence[RoomInstance], decisions: int, *, seed: int = 0) -> OptionAgreement:
    """Let masked random options run in a batch and make each of their decisions again with `OptionsEnv`.

    Args:
        instances: rooms of one room configuration.
        decisions: decisions to compare in each instance.
        seed: of the choices and episodes.
    """
    begun = time.process_time()
    per_room = min(decisions, 10)
    count = len(instances) * max(1, decisions // per_room)
    env = BatchedOptionsEnv(count, instance=instances, include_primitives=False)
    found = OptionAgreement(seconds=[time.process_time() - begun])
    begun = time.process_time()
    env.reset(torch.arange(count) + seed)
    generator = torch.Generator().manual_seed(seed)
    made = []
    begins, legal, left = [env.room.get_room_state(room) for room in range(count)], env.action_mask, [per_room] * count
    while any(left):
        choice = torch.multinomial(env.action_mask.to(torch.float32), 1, generator=generator).squeeze(1)
        done = env.step(choice)
        for room in done.where.nonzero().squeeze(1).tolist():
            if left[room]:
                made.append((room % len(instances), begins[room], legal[room].tolist(), int(done.action[room]),
                             ENDINGS[done.ended[room]], int(done.duration[room]), int(done.pressed[room])))
                left[room] -= 1
            begins[room] = env.room.get_room_state(room)
        legal = torch.where(done.where.unsqueeze(1), env.action_mask, legal)
    found.seconds.append(time.process_time() - begun)
    begun = time.process_time()
    for number, instance in enumerate(instances):
        single = OptionsEnv(EscapeRoomEnv(instance=instance), include_primitives=False)
        single.reset(seed=seed)
        for where, state, mask, action, ended, duration, pressed in made:
            if where != number:
                continue
            single.unwrapped.set_state(state)
            if single.resume().tolist() != mask:
                found.missed.append(f"instance {instance.id}: other mask than {mask} in {state}")
                continue
            info = single.step(action)[4]
            found.decisions += 1
            if info["option"]["ended"] != "reached":
                continue
            found.reached += 1
            if ended != "reached":
                found.missed.append(f"instance {instance.id}, option {action} from {state}: {ended} after {duration} "
                                    f"primitives, {info['duration']} by OptionsEnv")
                continue
            found.planned, found.taken = found.planned + info["duration"], found.taken + duration
            own = getattr(single.options[action], "targets", ())
            others = pressed & ~sum(1 << target for target in own) & (2 ** len(instance.targets) - 1)
            found.side_presses += bool(others) and not info["also_pressed"].any()
        single.close()
    found.seconds.append(time.process_time() - begun)
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns 1 where options differ."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", nargs="*", help="presets and knob extremes (all of them)")
    parser.add_argument("--instances", type=int, default=10, help="instances of each (%(default)s)")
    parser.add_argument("--decisions", type=int, default=100, help="decisions in each instance (%(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", help="file for the findings; what it holds of the same settings is not done again")
    chosen = parser.parse_args(arguments)
    torch.set_num_threads(1)
    settings = {name: getattr(chosen, name) for name in ("instances", "decisions", "seed")}
    good = True
    print(f"{'room':20} {'decisions':>9} {'reached':>8} {'missed':>7} {'planned':>8} {'taken':>8} {'more':>7} "
          f"{'side presses':>12} {'fields s':>8} {'batch s':>8} {'single s':>8}")
    own = ((name, config) for name, config in OWN.items() if not chosen.rooms or name in chosen.rooms)
    for name, config in itertools.chain(list_batched_rooms(chosen.rooms), own):
        known = load_findings(chosen.json).get(name, {})
        if settings.items() <= known.items():
            found = OptionAgreement(**{f.name: known[f.name] for f in dataclasses.fields(OptionAgreement)})
        else:
            rooms = [generate(config, seed) for seed in range(chosen.instances)]
            try:
                found = compare_options(rooms, chosen.decisions, seed=chosen.seed)
            except UnsupportedError as refusal:
                print(f"{name:20} left out: {refusal}")
                continue
            if chosen.json:
                write_json(chosen.json, load_findings(chosen.json) | {name: settings | dataclasses.asdict(found)})
        print(f"{name:20} {found.decisions:9,} {found.reached:8,} {len(found.missed):7} {found.planned:8,} "
              f"{found.taken:8,} {found.more:7.2%} {found.side_presses:12} "
              + " ".join(f"{seconds:8.1f}" for seconds in found.seconds), flush=True)
        print("\n".join(found.missed[:3]), end="\n" if found.missed else "")
        good &= found.is_good
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
