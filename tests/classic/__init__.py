"""Textbook domains of hierarchical reinforcement learning, small enough to be solved exactly.

Each domain is a plain Gymnasium environment with a finite number of states:

| module | environment | states | source |
|---|---|---|---|
| `four_rooms` | `FourRooms(goal, slip)` | 104 | Sutton, Precup and Singh 1999; the slips of Bacon et al. 2017 |
| `taxi` | `Taxi(noisy, fickle)` | 500 or 600 | Dietterich 2000 |
| `chain` | `Chain(visited)` | 12 | Kulkarni et al. 2016 |
| `empty_room` | `EmptyRoom(goal)` | 121 | McGovern, Sutton and Fagg 1997 |
| `key_door` | `KeyDoor(aliased)` | 98 | a small key-and-door maze, after Wiering and Schmidhuber 1997 |
| `winding_maze` | `WindingMaze(turns, aliased)` | 11 or 17 | a corridor that turns back, after the same |
| `barrier_maze` | `BarrierMaze(goal)` | 53 | a barrier round the goal, after Dayan and Hinton 1993 |
| `parr_maze` | `ParrMaze(blocks, noise)` | 297 at 3 blocks | hallways with obstacles, after Parr and Russell 1998 |

Every environment is a `tabular.TabularEnv`:

    env = Taxi(noisy=True, horizon=200)
    observation, info = env.reset(seed=1)                   # info["state"] is the state's number
    observation, reward, terminated, truncated, info = env.step(action)
    saved = env.get_state(); env.set_state(saved)           # State(number, elapsed)
    env.outcomes(state, action)                             # the rule, a list of `Outcome`
    tables = env.make_tables()                              # the same as arrays: probability, ending, rewards, starts

The observation is the state's number, but in `Chain(visited=False)`, `KeyDoor(aliased=True)` and `WindingMaze()`. At
the horizon `truncated` is true, and the observation is that of the state reached, to bootstrap from.

`exact` computes every number that a test compares with:

    model = make_model(tables, gamma)                       # one primitive is one decision
    model = make_option_model(tables, options, gamma)       # one option is one decision: gamma^k is inside
    values = find_values(model)                             # optimal; `sweeps=2` stops after two synchronous sweeps
    values = evaluate(model, make_uniform_policy(model))    # a linear solve
    steps = evaluate(make_option_model(count_primitives(tables), options, 1.0), policy)
    steps = find_fewest_primitives(tables)                  # to the end of the episode, soonest
    solution = find_recursive_optimum(tables, root, gamma)  # nested tasks, each optimal for itself
    policy = find_polled_policy(root, solution)             # the same tasks, chosen anew at every primitive

Options as arrays, `TabularOption`: `four_rooms.make_hallway_options`, `empty_room.make_macros`,
`ParrMaze.make_hallway_options`, `exact.make_primitive_options`. A task graph: `taxi.make_task_graph`.

`catalogue.ENVIRONMENTS` makes each of them by name, for tests that hold for all.

`values @ tables.starts` is the expected return of an episode.
"""
