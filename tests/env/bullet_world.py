"""A room's rigid bodies in Bullet, asked how far the robot is from them: independent of the rules that moved it."""

import pybullet

from hrl_escape.env.bullet.physics import PhysicsDynamics
from hrl_escape.env.kinematics import Kinematics, RoomState, Rules


class BulletWorld:
    """Bodies of a room, put where its states say.

    Args:
        rules: of the room; under physics its doors are always solid.
    """

    def __init__(self, rules: Rules) -> None:
        self.rules, self.physics = rules, PhysicsDynamics(rules)

    def compute_clearance(self, state: RoomState) -> float:
        """Distance in m from the base to the nearest wall, obstacle or shut door; negative where they overlap.

        Bullet's answer is within 2e-6 m of the exact distance at the contact skin.
        """
        self.physics.write(state)
        instance, scene, client = self.rules.instance, self.physics.scene, self.physics.client
        furthest = 3.0 * (instance.reach_x + instance.reach_y)
        bodies = [(solid, -1) for solid in scene.solids]
        rotation = self.rules.get_rotation(state.heading_steps, state.heading_offset)
        if scene.door is not None and (not isinstance(self.rules, Kinematics) or self.rules.is_door_shut(
                state.x, state.y, state.puzzle, rotation)):
            bodies.append((scene.door, 0))
        return min(point[8] for body, link in bodies for point in pybullet.getClosestPoints(
            scene.robot, body, furthest, scene.base_link, link, physicsClientId=client))
