"""Exact values of finite environments: sweeps, linear solves, models of options, nested tasks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tests.classic.tabular import Tables

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

TIE = 1e-9
"""Choices whose values differ by less are equally good; the first is taken."""


# --- decision models -------------------------------------------------------------------


@dataclass(frozen=True)
class Model:
    """An SMDP with the discount inside.

    Attributes:
        rewards: (states, choices), expected discounted reward until the next decision.
        follow: (states, choices, states), expected gamma^k of deciding next in each state; what ended is missing.
        legal: (states, choices).
    """

    rewards: Array
    follow: Array
    legal: Mask


def make_model(tables: Tables, gamma: float) -> Model:
    """One primitive is one decision."""
    return Model(tables.rewards, gamma * tables.continuing, np.ones(tables.rewards.shape, bool))


def count_primitives(tables: Tables, price: float = 1.0) -> Tables:
    """The same environment with one reward for every primitive: undiscounted values are expected durations."""
    terminal = np.einsum("sas->sa", tables.ending).min(axis=1) == 1
    return replace(tables, rewards=np.where(terminal[:, None], 0.0, np.full_like(tables.rewards, price)))


def compute_choice_values(model: Model, values: Array) -> Array:
    """Value of each choice if `values` come after it; -inf where it is illegal."""
    return np.where(model.legal, model.rewards + model.follow @ values, -np.inf)


def find_values(model: Model, sweeps: int | None = None, start: Array | None = None) -> Array:
    """Optimal values by synchronous value iteration.

    Args:
        model: the decisions.
        sweeps: stop after so many; None sweeps until nothing changes.
        start: values before the first sweep; None is 0 everywhere.
    """
    values = np.zeros(len(model.rewards)) if start is None else start
    active = model.legal.any(axis=1)
    for _ in range(100_000 if sweeps is None else sweeps):
        swept = np.where(active, compute_choice_values(model, values).max(axis=1), 0.0)
        change, values = np.abs(swept - values).max(), swept
        if sweeps is None and change < 1e-12:
            return values
    assert sweeps is not None, "values do not converge"
    return values


def find_fewest_primitives(tables: Tables) -> Array:
    """Expected primitives to the end of the episode for who wants to be there soonest."""
    return -find_values(make_model(count_primitives(tables, price=-1.0), 1.0))


def find_greedy_policy(model: Model, values: Array) -> NDArray[np.int64]:
    """The first of the best choices in each state."""
    choices = compute_choice_values(model, values)
    return np.argmax(choices >= choices.max(axis=1, keepdims=True) - TIE, axis=1)


def make_uniform_policy(model: Model) -> Array:
    """Probability of each choice of the random walk over legal choices."""
    return model.legal / np.maximum(model.legal.sum(axis=1, keepdims=True), 1)


def make_policy_matrix(policy: NDArray[np.int64], choices: int) -> Array:
    """Probabilities (states, choices) of a deterministic policy."""
    return np.eye(choices)[policy]


def evaluate(model: Model, policy: Array) -> Array:
    """Values of a policy (states, choices) by a linear solve."""
    rewards = (policy * model.rewards).sum(axis=1)
    follow = np.einsum("sc,sct->st", policy, model.follow)
    return np.linalg.solve(np.eye(len(rewards)) - follow, rewards)


# --- options ---------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class TabularOption:
    """A Markov option.

    Attributes:
        name: of the option.
        initiation: (states,), where it may start.
        policy: (states, actions), probabilities; rows of 0 where it never is.
        termination: (states,), probability of stopping on arrival.
    """

    name: str
    initiation: Mask
    policy: Array
    termination: Array


def make_primitive_options(states: int, actions: int) -> list[TabularOption]:
    """Each primitive as an option of one step."""
    everywhere = np.ones(states, bool)
    return [
        TabularOption(str(action), everywhere, np.tile(np.eye(actions)[action], (states, 1)), np.ones(states))
        for action in range(actions)
    ]


def model_option(tables: Tables, option: TabularOption, gamma: float) -> tuple[Array, Array]:
    """Expected discounted reward, and expected gamma^k of stopping in each state, from each first state."""
    rewards = (option.policy * tables.rewards).sum(axis=1)
    follow = gamma * np.einsum("sa,sat->st", option.policy, tables.continuing)
    return run_to_end(rewards, follow, option.termination)


def run_to_end(rewards: Array, follow: Array, termination: Array) -> tuple[Array, Array]:
    """Solves R = r + F (1 - beta) R and P = F beta + F (1 - beta) P."""
    system = np.eye(len(rewards)) - follow * (1 - termination)
    solved = np.asarray(np.linalg.solve(system, np.column_stack([rewards, follow * termination])), np.float64)
    return solved[:, 0], solved[:, 1:]


def make_option_model(tables: Tables, options: Sequence[TabularOption], gamma: float) -> Model:
    """One option is one decision, legal where it may start."""
    models = [model_option(tables, option, gamma) for option in options]
    return Model(
        np.stack([rewards for rewards, _ in models], axis=1),
        np.stack([follow for _, follow in models], axis=1),
        np.stack([option.initiation for option in options], axis=1),
    )


def make_subgoal_option(name: str, tables: Tables, inside: Mask, targets: Mask, gamma: float) -> TabularOption:
    """The option that leaves the states it may start in for one of its targets, as soon as possible.

    It maximises the expected gamma^k of stopping in a target; an episode that ends there counts too.
    """
    termination = np.where(inside, 0.0, 1.0)
    arriving = gamma * (tables.probability @ targets)
    model = Model(arriving, gamma * tables.continuing * inside, np.tile(inside[:, None], (1, tables.rewards.shape[1])))
    greedy = find_greedy_policy(model, find_values(model))
    policy = make_policy_matrix(greedy, tables.rewards.shape[1]) * inside[:, None]
    return TabularOption(name, inside, policy, termination)


# --- nested tasks ----------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class NestedTask:
    """A task of a MAXQ graph.

    Attributes:
        name: unique in the graph.
        children: tasks and primitives it may call; a task that is over cannot be called.
        over: (states,), where the task is over.
        pseudo: (states,), reward on ending there that only the task itself sees; None is 0.
    """

    name: str
    children: Sequence[NestedTask | int]
    over: Mask
    pseudo: Array | None = None


@dataclass(frozen=True)
class NestedSolution:
    """Recursively optimal policies, by task.

    Attributes:
        values: (states,), expected discounted reward of the environment until the task is over.
        choices: (states,), number of the child that is called.
        follow: (states, states), expected gamma^k of ending in each state.
    """

    values: dict[str, Array] = field(default_factory=dict)
    choices: dict[str, NDArray[np.int64]] = field(default_factory=dict)
    follow: dict[str, Array] = field(default_factory=dict)


def find_recursive_optimum(tables: Tables, root: NestedTask, gamma: float) -> NestedSolution:
    """Value iteration task by task, leaves first: each is optimal given its children, none for its caller."""
    solution = NestedSolution()
    _solve_task(tables, root, gamma, solution)
    return solution


def _solve_task(tables: Tables, task: NestedTask, gamma: float, solution: NestedSolution) -> None:
    if task.name in solution.values:
        return
    rewards, follow, legal = [], [], []
    for child in task.children:
        if isinstance(child, NestedTask):
            _solve_task(tables, child, gamma, solution)
            rewards.append(solution.values[child.name])
            follow.append(solution.follow[child.name])
            legal.append(~task.over & ~child.over)
        else:
            rewards.append(tables.rewards[:, child])
            follow.append(gamma * tables.continuing[:, child])
            legal.append(~task.over)
    model = Model(np.stack(rewards, axis=1), np.stack(follow, axis=1), np.stack(legal, axis=1))
    ends = task.over.astype(float)
    pseudo = np.zeros(len(ends)) if task.pseudo is None else task.pseudo
    seen = replace(model, rewards=model.rewards + model.follow @ (ends * pseudo))
    policy = find_greedy_policy(seen, find_values(seen))
    rows = np.arange(len(ends))
    active = ~task.over
    solution.choices[task.name] = policy
    solution.values[task.name], solution.follow[task.name] = run_to_end(
        model.rewards[rows, policy] * active, model.follow[rows, policy] * active[:, None], ends
    )


def find_polled_policy(root: NestedTask, solution: NestedSolution) -> NDArray[np.int64]:
    """The primitive in each state if the path from the root is chosen anew at every primitive."""
    return np.array([_descend(root, solution, state) for state in range(len(root.over))])


def _descend(root: NestedTask, solution: NestedSolution, state: int) -> int:
    called: NestedTask | int = root
    while isinstance(called, NestedTask):
        called = called.children[solution.choices[called.name][state]]
    return called
