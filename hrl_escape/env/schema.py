"""Base class of room configurations: settings whose plain values determine the ids of rooms.

Plain values omit fields at their default. A field added later leaves every id unchanged, provided that its default
means the former behaviour. The fields below are always written, because the first ids included them. The list is
closed: do not add classes or fields.
"""

from __future__ import annotations

import dataclasses
from typing import Any

from hrl_escape.settings import Settings

_ALWAYS_WRITTEN = {
    "BitFlipConfig": "count buttons",
    "BitFlipPuzzle": "count",
    "BlocksWorldConfig": "count problem places",
    "BlocksWorldPuzzle": "names start goal clear free_hand",
    "ButtonsConfig": "count graph on_violation allow_off goal buttons",
    "ButtonsPuzzle": "count edge_list goal on_violation allow_off",
    "Capsule": "x1 y1 x2 y2 radius",
    "CodeLockConfig": "digits length memory shown buttons",
    "CodeLockPuzzle": "digits code memory shown",
    "DeepSeaConfig": "size mapping_seed buttons",
    "DeepSeaPuzzle": "size mapping_seed",
    "DynamicsConfig": "kind press_with press_margin noise slip",
    "ExitConfig": "place x y width depth door",
    "FactoredConfig": "count arity max_parents success buttons",
    "FactoredPuzzle": "count arity parents turns goal success",
    "ForagingConfig": "worms ends",
    "ForagingPuzzle": "worms",
    "GraphConfig": "kind max_parents edge_probability seed edges relabel",
    "HanoiConfig": "discs buttons",
    "HanoiPuzzle": "discs",
    "KeyChestConfig": "floor",
    "LightBoxConfig": "count graph success lights",
    "LightBoxPuzzle": "count edge_list goal success",
    "LightsOutConfig": "rows columns task scramble buttons",
    "LightsOutPuzzle": "count columns start goal",
    "MiniGridConfig": "level size rooms largest rows",
    "MiniGridPuzzle": "rows",
    "ObstaclesConfig": "count cylinder_share size_min size_max height aligned",
    "Pads": "width depth places",
    "Panels": "width height thickness centre_height height_spread inset places",
    "PinPadConfig": "count floor",
    "PinPadPuzzle": "code",
    "Place": "x y yaw_deg z",
    "PlacedProp": "prop x y yaw",
    "PotionsConfig": "features trials bottles",
    "PotionsPuzzle": "features trials",
    "Prop": "name kind half_size height mass",
    "PuddleWorldConfig": "areas cost goal",
    "PuddleWorldPuzzle": "areas cost",
    "PushBlockConfig": "count block_size block_height block_mass plate_size",
    "PushBlockPuzzle": "things",
    "RecipesConfig": "goal buttons",
    "RecipesPuzzle": "goal",
    "Rectangle": "x_min x_max y_min y_max",
    "RewardConfig": "step exit exit_replaces_step",
    "RobotConfig": (
        "kind body_radius body_height joints link_length mount_forward joint_limit_deg hand_radius "
        "move_step turn_step_deg joint_step_deg urdf hand_link"),
    "RoomConfig": "name room robot puzzle obstacles start exit reward dynamics horizon",
    "RoomInstance": (
        "name seed half_width half_depth wall_height solids door targets props exit starts robot "
        "puzzle reward dynamics horizon"),
    "ShapeConfig": "width depth wall_height wall_thickness rooms doorway_width",
    "SokobanConfig": "size boxes rows",
    "SokobanPuzzle": "rows",
    "Solid": "shape x y half_x half_y yaw height role",
    "SpaceLayout": "reach_x reach_y wall_height target_names bounds",
    "Start": "x y heading_steps heading_offset",
    "StartConfig": "place x y heading_deg choices",
    "Target": "name x y z half_x half_y half_z yaw",
    "TaxiConfig": "fickleness depots",
    "TaxiPuzzle": "fickleness",
    "Wall": "x y to_x to_y",
}  # fmt: skip
"""Space-separated fields by the name of their class."""


@dataclasses.dataclass(frozen=True)
class HashedSettings(Settings):
    """Base class of settings whose values are part of ids."""

    def to_dict(self) -> dict[str, Any]:
        """Return nested plain values. Fields at their default are omitted, except those listed in this module."""
        always = _ALWAYS_WRITTEN.get(type(self).__name__, "").split()
        unchanged = {field.name for field in dataclasses.fields(self)
                     if field.name not in always and getattr(self, field.name) == field.default}
        return {name: value for name, value in super().to_dict().items() if name not in unchanged}
