"""Traps of algorithms on given hierarchies, each sprung."""

GIVEN = "agents/algorithms/given"


def _trap(bug: str, file: str, old: str, new: str, test: str) -> tuple[str, str, str, str, str]:
    """Fields of a mutation: what is wrong, file, sound text, broken text, test that sees it."""
    folder = "agents/hierarchy" if file in HIERARCHY else GIVEN
    return bug, f"{folder}/{file}.py", old, new, f"{GIVEN}/{test}"


HIERARCHY = ("machine", "task_graph")

MUTATIONS = [
    # terminal means: for that task
    _trap("maxq goes on after a task's own end", "maxq_q",
          "        if returned.ended:\n            own_after",
          "        if returned.ended and returned.terminated:\n            own_after",
          "test_maxq.py::test_one_child_of_three_primitives_teaches_the_completion_from_every_state_on_its_way"),
    _trap("maxq-q pays its pseudo-reward at the end of the episode alone", "maxq_q",
          "if self.settings.pseudo_rewards else 0.0",
          "if self.settings.pseudo_rewards and returned.terminated else 0.0",
          "test_maxq.py::test_every_task_is_worth_its_exact_value_with_pseudo_rewards_and_without"),
    _trap("the manager goes on after the end of the episode", "h_dqn",
          "0.0 if reached or returned.terminated or not legal.any() else decision.discount",
          "decision.discount",
          "test_h_dqn.py::test_the_manager_learns_in_the_state_where_the_goal_was_named"),
    _trap("an order that was given up counts as obeyed or left", "feudal_rl",
          "if not (returned.terminated or task.is_settled(frame, returned.seen)):",
          "if not (returned.terminated or returned.ended):",
          "test_feudal_rl.py::test_an_order_given_up_bootstraps"),
    # a* from the right table, pseudo-reward never in C
    _trap("a* is the best of what is reported", "maxq_q",
          "choice = int(self.compute_choice_values(task, seen).argmax())\n        told",
          "legal = task.legal(seen, None)\n"
          "        choice = int(np.array([\n"
          "            self.compute_value(child, seen)"
          " + self.tables['completion'].get(self.make_key(task, number, seen))\n"
          "            if legal[number] else -np.inf for number, child in enumerate(task.children)]).argmax())\n"
          "        told",
          "test_maxq.py::test_every_task_is_worth_its_exact_value_with_pseudo_rewards_and_without"),
    _trap("pseudo-reward in C", "maxq_q",
          "[\"completion\"].update(key, discount * after)", "[\"completion\"].update(key, discount * own_after)",
          "test_maxq.py::test_every_task_is_worth_its_exact_value_with_pseudo_rewards_and_without"),
    _trap("pseudo-reward in what h-uct's callers are told", "h_uct",
          "node.record(choice, reward, passed * own, passed * told)",
          "node.record(choice, reward, passed * own, passed * own)",
          "test_h_uct.py::test_a_task_is_optimal_for_itself_and_its_caller_is_told_the_truth"),
    _trap("pseudo-reward in what a task of r-maxq earns", "r_maxq",
          "right = np.column_stack([rewards[rows, best] * goes_on, follow * ~goes_on])",
          "right = np.column_stack([rewards[rows, best] * goes_on + follow @ (values * over), follow * ~goes_on])",
          "test_r_maxq.py::test_models_of_tasks_are_those_of_nested_solving"),
    # the stack in the key
    _trap("a machine's state is its innermost machine", "machine",
          "for call in self.list_calls()), label)", "for call in self.list_calls()[-1:]), label)",
          "test_hamq.py::test_the_whole_stack_is_the_machine_state"),
    _trap("one value for all orders", "feudal_rl",
          "np.int32(-1 if order is None else order)", "np.int32(-1)",
          "test_feudal_rl.py::test_the_last_level_obeys_every_order_by_the_shortest_way"),
    _trap("h-uct counts a state for all tasks together", "h_uct",
          "return task.name, self._discretise(seen.observation) if view is None else freeze(view(seen))",
          "return self._discretise(seen.observation) if view is None else freeze(view(seen))",
          "test_h_uct.py"),
    # the state in which it was chosen
    _trap("the manager learns in the state where its goal ended", "h_dqn",
          "                decision.view,\n                goal,",
          "                step.seen.observation,\n                goal,",
          "test_h_dqn.py::test_the_manager_learns_in_the_state_where_the_goal_was_named"),
    _trap("a macro is learned in the state where it ended", "macro_q",
          "self._discretise(decision.view), decision.choice",
          "self._discretise(step.seen.observation), decision.choice",
          "test_macro_q.py::test_every_primitive_and_macro_is_worth_its_exact_value"),
    # time
    _trap("every state on the way is as far from the end as the last", "maxq_q",
          "self.gamma**duration\n", "self.gamma\n",
          "test_maxq.py::test_one_child_of_three_primitives_teaches_the_completion_from_every_state_on_its_way"),
    _trap("a macro's end is discounted by one primitive", "macro_q",
          "decision.discount * float(after)", "self.gamma * float(after)",
          "test_macro_q.py::test_every_primitive_and_macro_is_worth_its_exact_value"),
    _trap("a choice of a program is discounted by its last primitive", "hamq",
          "self._discount *= transition.discount", "self._discount = transition.discount",
          "test_hamq.py::test_the_whole_stack_is_the_machine_state"),
    _trap("r-maxq's model forgets the discount", "r_maxq",
          "+ self.gamma**step.duration", "+ 1.0",
          "test_r_maxq.py::test_models_of_tasks_are_those_of_nested_solving"),
    # zero-length calls
    ("a task that is over may be called", "agents/hierarchy/task_graph.py",
     "if self.until(seen):\n            return False", "if False:\n            return False",
     "agents/hierarchy/test_task_graph.py::test_a_task_that_is_over_is_not_legal_for_it_would_take_no_primitive"),
    _trap("a macro ends before its first primitive", "macro_q",
          "float(frame.primitives > 0 and self._until(seen))", "float(self._until(seen))",
          "test_macro_q.py::test_random_walks_last_as_long_as_the_paper_s_room_makes_them"),
    _trap("a subgoal seen at the start of a turn hands over", "hq_learning",
          "if after == turn.subgoal:", "if self._turn.subgoal in (after, key):",
          "test_hq_learning.py::test_a_subgoal_counts_after_a_primitive_only"),
    # truncation in nested calls
    _trap("a caller learns from a call that was cut", "maxq_q",
          "if not cut_before_its_end:", "if True:",
          "test_maxq.py::test_a_caller_learns_nothing_from_a_call_that_was_cut"),
    _trap("a choice of a program ends where the episode was cut", "hamq",
          "if transition.terminated:\n            return", "if True:\n            return",
          "test_hamq.py::test_a_cut_inside_a_choice_learns_nothing_and_at_a_choice_point_bootstraps"),
    _trap("a macro that was cut goes on with whatever is best", "macro_q",
          "values[decision.choice] if was_cut else", "values[decision.choice] if False else",
          "test_macro_q.py::test_a_macro_that_is_cut_goes_on_with_its_own_value"),
    _trap("a cut call of a feudal level is over", "feudal_rl",
          "if not (returned.terminated or task", "if not (returned.terminated or returned.truncated or task",
          "test_feudal_rl.py::test_the_last_level_obeys_every_order_by_the_shortest_way"),
    # pay, optimism, planning
    _trap("the world pays every level", "feudal_rl",
          "if frame.context is None:\n            return step.reward", "if True:\n            return step.reward",
          "test_feudal_rl.py::test_pay_is_for_obeying_and_the_environment_pays_the_top_alone"),
    _trap("leaving in any direction is obeying", "feudal_rl",
          "frame.context < SEARCH and way == DIRECTIONS[frame.context]", "frame.context < SEARCH",
          "test_feudal_rl.py::test_the_last_level_obeys_every_order_by_the_shortest_way"),
    _trap("an unknown primitive is worth nothing", "r_maxq",
          "np.full(states, self.settings.optimistic_value)", "np.zeros(states)",
          "test_r_maxq.py::test_an_unknown_primitive_makes_its_callers_look_worth_the_optimum"),
    _trap("hdg walks by landmarks to goals next door", "hdg",
          "(self.settings.neighbours and self._borders[here, there])", "False",
          "test_hdg.py::test_with_the_neighbour_rule_every_walk_arrives_and_is_nearly_shortest"),
    _trap("a simulated task that never ends takes the whole budget", "h_uct",
          "if inside and settings.patience:", "if False:",
          "test_h_uct.py::test_a_task_that_never_ends_leaves_budget_for_its_caller"),
    _trap("an agent's return is mixed with its own value after it handed over", "hq_learning",
          "value = float(self.tables[turn.agent].get_values(key)",
          "value = float(self.tables[0].get_values(key)",
          "test_hq_learning.py::test_a_trial_teaches_values_of_primitives_and_of_the_subgoal_by_hand"),
    _trap("the last agent's best subgoal stands for what it earned", "hq_learning",
          "largest = followed if turn.agent + 1 == self.last else self",
          "largest = 0.0 if turn.agent + 1 == self.last else self",
          "test_hq_learning.py::test_a_trial_teaches_values_of_primitives_and_of_the_subgoal_by_hand"),
]
