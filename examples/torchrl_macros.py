"""TorchRL's macro primitives compared with options.

`MacroPrimitiveTransform` turns one target into a fixed number of actions, open loop. A `ScriptedOption` makes the same
motion. An option also has an initiation set, a termination that depends on the state, and k and gamma^k.
"""

import gymnasium
import torch
import tyro
from tensordict import TensorDict
from torchrl.envs import GymWrapper, TransformedEnv
from torchrl.envs.transforms import MacroPrimitiveTransform

from hrl_escape import OptionsEnv
from hrl_escape.options import FunctionOption, ScriptedOption


def run_macro(torque: float, steps: int, seed: int) -> list[float]:
    """Run one macro, from no torque to the target in equal steps, and return its rewards."""
    transform = MacroPrimitiveTransform(macro_steps=steps, action_dim=1, execute=True)
    env = TransformedEnv(GymWrapper(gymnasium.make("Pendulum-v1")), transform)
    decision = env.reset(seed=seed).set("action", torch.tensor([torque]))
    return env.step(decision)["next", "reward"].flatten().tolist()


def expand_macro(torque: float, steps: int) -> ScriptedOption:
    """Make an option of the actions into which the transform expands the target."""
    transform = MacroPrimitiveTransform(macro_steps=steps, action_dim=1)
    actions = transform.inv(TensorDict({"action": torch.tensor([[torque]])}, batch_size=[1]))["action"][0]
    return ScriptedOption("macro", [action.numpy() for action in actions])


def main(torque: float = 2.0, steps: int = 8, seed: int = 0, gamma: float = 0.9) -> None:
    """Run the macro both ways, then an option with a termination.

    Args:
        torque: target of the macro, N m.
        steps: number of actions in the macro.
        seed: seed of the first state.
        gamma: discount per primitive.
    """
    brake = FunctionOption(
        "brake",
        policy=lambda state: [-torque if state[2] > 0 else torque],  # against the angular velocity
        termination=lambda state: float(abs(state[2]) < 1.0),  # near a turning point
        initiation=lambda state: abs(state[2]) >= 1.0,
    )
    env = OptionsEnv(gymnasium.make("Pendulum-v1"), [expand_macro(torque, steps), brake], discount=gamma)
    rewards = run_macro(torque, steps, seed)
    print(f"transform: {len(rewards)} rewards, sum {sum(rewards):.3f}; no duration, no gamma^k")

    _, info = env.reset(seed=seed)
    print(f"legal at the start: {dict(zip(env.action_names, info['action_mask'].tolist(), strict=True))}")
    for name in ("macro", "brake", "brake"):
        if not info["action_mask"][env.action_names.index(name)]:
            print(f"{name}: cannot start here")
            continue
        _, reward, _, _, info = env.step(env.action_names.index(name))
        print(f"{name}: {info['duration']} primitives, {info['option']['ended']}, sum {reward:.3f}, discounted "
              f"{info['discounted_reward']:.3f}, gamma^k {info['discount']:.3f}")


if __name__ == "__main__":
    tyro.cli(main)
