"""TorchRL with options.

In TorchRL, rooms with options are an environment like any other, with one difference: a step is a decision of k
primitives, so the next value must be discounted by gamma^k. TorchRL does this if it finds k under the key
`steps_to_next_obs`. `SMDPTransform` writes that key.
"""

import logging

import torch
from torchrl.collectors import Collector
from torchrl.data import Categorical, LazyTensorStorage, ReplayBuffer
from torchrl.modules import MLP, EGreedyModule, QValueActor
from torchrl.objectives import DQNLoss, SoftUpdate, ValueEstimators

from hrl_escape.figures import get_figure_class
from hrl_escape.options import OptionsTorchRLEnv, SMDPTransform

logging.getLogger("torchrl").setLevel(logging.WARNING)
torch.manual_seed(0)
GAMMA, ROOMS = 0.99, 16
env = OptionsTorchRLEnv(ROOMS, "paper-two-button", observation="features", discount=GAMMA, include_primitives=False)
env.set_seed(0)
env.rooms.get_many_envs().rooms.instances[0]

# Policy, loss and replay buffer are TorchRL's own. `action_mask` excludes illegal options from choices and targets.

actions = Categorical(len(env.rooms.action_names))
inputs = env.observation_spec["observation"].shape[-1]
network = MLP(in_features=inputs, out_features=actions.n, num_cells=(64, 64))
actor = QValueActor(network, spec=actions, in_keys=["observation"], action_space="categorical",
                    action_mask_key="action_mask")
greed = EGreedyModule(actions, eps_init=1.0, eps_end=0.05, annealing_num_steps=2_000,
                      action_mask_key="action_mask")
loss = DQNLoss(actor, delay_value=True, double_dqn=True, action_space="categorical")
loss.make_value_estimator(ValueEstimators.TD0, gamma=GAMMA)
target, adam = SoftUpdate(loss, tau=0.01), torch.optim.Adam(loss.parameters(), lr=1e-3)
replay = ReplayBuffer(storage=LazyTensorStorage(20_000), batch_size=256)


def explore(tensordict):
    """Greedy by the network, or with probability epsilon uniform over what is legal."""
    return greed(actor(tensordict))


# The collector runs 16 rooms. Rewards are already discounted within each decision.

collector = Collector(env, explore, frames_per_batch=ROOMS * 16, total_frames=ROOMS * 16 * 20,
                      postproc=SMDPTransform())
for number, data in enumerate(collector):
    replay.extend(data.reshape(-1))
    greed.step(data.numel())
    for _ in range(32):
        batch = replay.sample()
        adam.zero_grad()
        loss(batch)["loss"].backward()
        adam.step()
        target.step()
    escapes = data["next", "terminated"].sum().item()
    if number % 5 == 4:
        print(f"{data.numel() * (number + 1):5,} decisions: {escapes:3} escapes in the last {data.numel()}")

# To see the effect, compare with an estimator that ignores durations. It counts a walk of ten primitives as one step,
# and its targets are too far from zero.

batch = replay.sample()
batch = batch[batch["steps_to_next_obs"].squeeze(-1) >= 10]
estimate = loss.value_estimator.value_estimate
with torch.no_grad():
    right, wrong = (estimate(data.clone(), target_params=loss.target_value_network_params)
                    for data in (batch, batch.exclude("steps_to_next_obs")))
later = ~batch["next", "terminated"]
print(f"targets of long walks: {right[later].mean():.1f} with durations, "
      f"{wrong[later].mean():.1f} without")

# The durations of the greedy policy's decisions after this short training:

lengths = env.rollout(40, policy=actor, break_when_any_done=False)["next", "duration"]
figure = get_figure_class()(figsize=(5.6, 2.6), layout="constrained")
figure.add_subplot(xlabel="primitives of a decision (k)", ylabel="decisions of the greedy policy").hist(
    lengths.flatten().numpy(), bins=30)
figure

# `hrl-escape train smdp-torchrl-dqn` trains the same agent with checkpoints, evaluations and reports.
# `smdp-torchrl-ppo` and `smdp-torchrl-sac` are built in the same way.
