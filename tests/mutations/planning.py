"""Bugs of planners."""

from tests.mutations.mutation import Mutation

MUTATIONS = [
    Mutation(
        "a target that is touched already counts as pressed",
        "planning/goals.py",
        "return bool(after.touching & ~before.touching & 1 << goal.target)",
        "return bool(after.touching & 1 << goal.target)",
        "planning/test_room_planner.py planning/test_primitive_search.py",
    ),
    Mutation(
        "headings are compared without the turn round",
        "planning/goals.py",
        "turn = (rules.get_heading(after) - goal.heading + math.pi) % math.tau - math.pi",
        "turn = rules.get_heading(after) - goal.heading",
        "planning/test_room_planner.py planning/test_primitive_search.py",
    ),
    Mutation(
        "a heading is read in radians",
        "planning/goals.py",
        "heading = math.radians(numbers[2]) if len(numbers) == 3 else None",
        "heading = numbers[2] if len(numbers) == 3 else None",
        "planning/test_room_planner.py",
    ),
    Mutation(
        "routes with the exit shut are taken for those with it open",
        "planning/route_finder.py",
        "return goal, method, self.is_solved(state), (*get_pose(state), props)",
        "return goal, method, False, (*get_pose(state), props)",
        "planning/test_room_planner.py",
    ),
    Mutation(
        "routes are remembered without a bound",
        "planning/route_finder.py",
        "if len(self._routes) > MOST_ROUTES:",
        "if False:",
        "planning/test_room_planner.py",
    ),
    Mutation(
        "what a time limit cut short is remembered",
        "planning/route_finder.py",
        "if not clock.has_stopped:",
        "if True:",
        "planning/test_clock.py planning/test_room_planner.py",
    ),
]
