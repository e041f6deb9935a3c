"""Do the batched engine and the scalar rules agree? Random primitives in many rooms, compared one by one.

    python -m benchmarks.conformance --json full.json                    # the full check, two hours; continues if
    stopped python -m benchmarks.conformance --rooms clutter --instances 5 --primitives 10000

Every difference of a pose by more than 1e-4 m, of a press, exit, reward or flag is either a close
call (moving the start of that primitive by a millimetre changes what it does) or a disagreement.
The Bullet engine steps with these scalar rules, so what agrees with them agrees with it.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from benchmarks.findings import list_batched_rooms, load_findings
from hrl_escape.env.batched.engine import Outcome, TensorRoom
from hrl_escape.env.batched.puzzles.base import as_signed, get_tensor_puzzle
from hrl_escape.env.batched.rooms import Rooms
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics, RoomState, Transition
from hrl_escape.env.sampling.generation import generate
from hrl_escape.env.velocities import Velocities
from hrl_escape.files import write_json

TOLERANCE = 1e-4
THRESHOLD = 1e-3
MOST_CLOSE_CALLS = 1e-4


@dataclasses.dataclass
class Agreement:
    """Findings of a comparison.

    Attributes:
        primitives: how many were compared.
        worst: largest difference of a coordinate apart from close calls, m.
        close_calls: differences within a millimetre of a threshold.
        disagreements: all other differences, in words.
    """

    primitives: int = 0
    worst: float = 0.0
    close_calls: int = 0
    disagreements: list[str] = dataclasses.field(default_factory=list)

    @property
    def is_good(self) -> bool:
        """No disagreement, and close calls as rare as they must be."""
        return not self.disagreements and self.close_calls <= max(1, MOST_CLOSE_CALLS * self.primitives)


def compare(instances: Sequence[RoomInstance], primitives: int, *, copies: int = 1, seed: int = 0,
            velocities: Velocities | None = None) -> Agreement:
    """Step instances in both engines with the same random primitives, or velocities.

    Args:
        instances: rooms of one room configuration.
        primitives: primitives in each instance, shared by its copies.
        copies: rooms that each instance is stepped in at once.
        seed: of the primitives and of the episodes.
        velocities: meaning of actions other than primitives.
    """
    rooms = len(instances) * copies
    batch = TensorRoom(Rooms(rooms, instance=instances), autoreset="disabled", velocities=velocities)
    scalar = [Kinematics(instances[i % len(instances)]) for i in range(rooms)]
    batch.reset(torch.arange(rooms) + seed)
    rng = np.random.default_rng(seed)
    found = Agreement()
    states = [batch.get_room_state(i) for i in range(rooms)]
    for room in range(rooms):
        _check_start(found, scalar[room], states[room])
    for _ in range(primitives // copies):
        actions = draw_actions(batch, rng)
        outcome = batch.step(torch.from_numpy(actions))
        transitions = [move(k, s, a, velocities) for k, s, a in zip(scalar, states, actions.tolist(), strict=True)]
        _compare_step(found, batch, outcome, scalar, states, actions, transitions)
        states = [t.state for t in transitions]
        ended = np.array([t.terminated or t.truncated for t in transitions])
        if ended.any():
            batch.reset(where=torch.from_numpy(ended))
            for room in np.flatnonzero(ended).tolist():
                states[room] = batch.get_room_state(room)
                _check_start(found, scalar[room], states[room])
    return found


def draw_actions(batch: TensorRoom, rng: np.random.Generator) -> np.ndarray:
    """Primitives (rooms,); or velocities (rooms, numbers), each at a bound or beyond, 0, or between the bounds."""
    if batch.layout.velocities is None:
        return rng.integers(batch.actions, size=batch.count)
    top = np.array(batch.layout.velocities.list_bounds(batch.layout.robot))
    drawn = rng.uniform(-1.0, 1.0, (batch.count, len(top)))
    kind = rng.integers(4, size=drawn.shape)
    return top * np.select([kind == 0, kind == 1], [np.sign(drawn) * 1.5, 0.0 * drawn], drawn)


def move(rules: Kinematics, state: RoomState, action: Any, velocities: Velocities | None) -> Transition:
    """The outcome by the scalar rules."""
    if velocities is None:
        return rules.step(state, action)
    top = velocities.list_bounds(rules.instance.robot)
    rates = tuple(min(max(rate, -bound), bound) for rate, bound in zip(action, top, strict=True))
    done = rules.glide(state, velocities.make_glide(rules, state, rates))
    return velocities.judge(done, rules.instance)


def _check_start(found: Agreement, scalar: Kinematics, state: RoomState) -> None:
    starts = [scalar.make_state(start, state.noise_key) for start in scalar.instance.starts]
    if state not in starts:
        found.disagreements.append(f"instance {scalar.instance.id} begins in {state}")


def _compare_step(found: Agreement, batch: TensorRoom, outcome: Outcome, scalar: list[Kinematics],
                  states: list[RoomState], actions: np.ndarray, transitions: list[Transition]) -> None:
    now, after, form = batch.state, [t.state for t in transitions], get_tensor_puzzle(batch.layout.puzzle)
    off = np.maximum(np.abs(now.x.numpy() - [s.x for s in after]), np.abs(now.y.numpy() - [s.y for s in after]))
    turned = np.abs(now.heading_offset.numpy() - [s.heading_offset for s in after])
    other = np.minimum(turned, 2 * np.pi - turned) > TOLERANCE
    count = len(transitions[0].state.joint_steps)
    bent = np.array([s.joint_offsets or (0.0,) * count for s in after]).reshape(len(after), count)
    other |= (np.abs(now.joint_offsets.numpy().T - bent) > TOLERANCE).any(axis=1)
    targets = range(outcome.info.pressed.shape[1])
    for mine, theirs in (
        (now.heading_steps, [s.heading_steps for s in after]),
        (now.primitives, [s.primitives for s in after]),
        (now.puzzle, [as_signed(form.encode(k.instance.puzzle, s.puzzle)) for k, s in zip(scalar, after, strict=True)]),
        (now.touching, [as_signed(s.touching) for s in after]),
        (outcome.reward, np.array([t.reward for t in transitions], dtype=np.float32)),
        (outcome.terminated, [t.terminated for t in transitions]),
        (outcome.truncated, [t.truncated for t in transitions]),
    ):
        other |= mine.numpy() != np.array(theirs)
    for table, rows in (
        (now.joint_steps.T, [s.joint_steps for s in after]),
        (outcome.info.pressed, [[i in t.pressed for i in targets] for t in transitions]),
        (outcome.info.buttons_on, [_list_lit(k, s, len(targets)) for k, s in zip(scalar, after, strict=True)]),
    ):
        other |= (table.numpy() != np.array(rows).reshape(table.shape)).any(axis=1)
    wrong = other | (off > TOLERANCE)
    found.primitives += len(transitions)
    found.worst = max(found.worst, float(off[~wrong].max(initial=0.0)))
    for room in np.flatnonzero(wrong).tolist():
        action = actions[room].tolist()
        if is_close_call(scalar[room], states[room], action, transitions[room], batch.layout.velocities):
            found.close_calls += 1
        else:
            found.disagreements.append(
                f"instance {scalar[room].instance.id}, action {action} in {states[room]}: batched engine "
                f"{batch.get_room_state(room)}, scalar rules {transitions[room]}"
            )
        batch.set_room_state(room, transitions[room].state)


def _list_lit(scalar: Kinematics, state: RoomState, targets: int) -> tuple[bool, ...]:
    """Targets that are on; those that this instance lacks are off."""
    lit = scalar.instance.puzzle.get_lit(state.puzzle)
    return lit + (False,) * (targets - len(lit))


def is_close_call(scalar: Kinematics, state: RoomState, action: Any, done: Transition,
                  velocities: Velocities | None) -> bool:
    """True if an action that starts a millimetre away has another outcome."""
    moved = np.array([(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)]) * THRESHOLD
    for dx, dy in moved.tolist():
        other = move(scalar, state._replace(x=state.x + dx, y=state.y + dy), action, velocities)
        if (other.pressed, other.terminated, other.state.touching, other.state.heading_steps) != (
                done.pressed, done.terminated, done.state.touching, done.state.heading_steps):
            return True
        if max(abs(other.state.x - done.state.x), abs(other.state.y - done.state.y)) > 10 * THRESHOLD:
            return True
    return False


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns 1 where the engines disagree."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", nargs="*", help="presets and knob extremes (all of them)")
    parser.add_argument("--instances", type=int, default=50, help="instances of each (%(default)s)")
    parser.add_argument("--primitives", type=int, default=100_000, help="primitives in each instance (%(default)s)")
    parser.add_argument("--copies", type=int, default=20, help="rooms that share them (%(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", help="file for the findings; what it holds of the same settings is not done again")
    chosen = parser.parse_args(arguments)
    torch.set_num_threads(1)
    settings = {name: getattr(chosen, name) for name in ("instances", "primitives", "copies", "seed")}
    good = True
    print(f"{'room':20} {'primitives':>12} {'worst pose':>11} {'close calls':>11} {'disagreements':>13} {'seconds':>8}")
    for name, config in list_batched_rooms(chosen.rooms):
        begun, done = time.perf_counter(), load_findings(chosen.json).get(name, {})
        if settings.items() <= done.items():
            found = Agreement(**{field.name: done[field.name] for field in dataclasses.fields(Agreement)})
        else:
            rooms = [generate(config, seed) for seed in range(chosen.instances)]
            found = compare(rooms, chosen.primitives, copies=chosen.copies, seed=chosen.seed)
            seconds = time.perf_counter() - begun
            if chosen.json:
                entry = settings | dataclasses.asdict(found) | {"seconds": seconds}
                write_json(chosen.json, load_findings(chosen.json) | {name: entry})
        print(f"{name:20} {found.primitives:12,} {found.worst:9.1e} m {found.close_calls:11} "
              f"{len(found.disagreements):13} {time.perf_counter() - begun:8.1f}", flush=True)
        print("\n".join(found.disagreements[:3]), end="\n" if found.disagreements else "")
        good &= found.is_good
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
