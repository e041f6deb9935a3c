from .arm.arm_planner import ArmPlanner
from .arm.obstacles import Obstacle
from .arm.reacher import Reacher
from .best_known import BestKnown, best_known_return, find_best_known, record_return
from .fixed_arm import Arm
from .goals import ExitGoal, Goal, GripGoal, PoseGoal, PressGoal, PushGoal, RegionGoal, is_reached, parse_goal
from .motion.limits import MotionLimits
from .motion.sampled import MotionSampler
from .motion.trajectory import TimedTrajectory, Tracking, make_trajectory, track
from .paths.navigator import Navigator
from .paths.planners import list_planners, register_planner
from .paths.problem import PathProblem, PathResult
from .plan import Execution, Plan, PlanPart
from .planner import RoomPlanner, get_planner
from .requests import PlanningRequest, PlanningResult
from .route import PlanningReport
from .scene import Scene
from .symbolic.pddl import export_pddl, save_pddl
from .task_motion import TaskMotionPlanner
from .world import World

__all__ = [
    "Arm",
    "ArmPlanner",
    "BestKnown",
    "Execution",
    "ExitGoal",
    "Goal",
    "GripGoal",
    "MotionLimits",
    "MotionSampler",
    "Navigator",
    "Obstacle",
    "PathProblem",
    "PathResult",
    "Plan",
    "PlanPart",
    "PlanningReport",
    "PlanningRequest",
    "PlanningResult",
    "PoseGoal",
    "PressGoal",
    "PushGoal",
    "Reacher",
    "RegionGoal",
    "RoomPlanner",
    "Scene",
    "TaskMotionPlanner",
    "TimedTrajectory",
    "Tracking",
    "World",
    "best_known_return",
    "export_pddl",
    "find_best_known",
    "get_planner",
    "is_reached",
    "list_planners",
    "make_trajectory",
    "track",
    "parse_goal",
    "record_return",
    "register_planner",
    "save_pddl",
]
