from .maps import Trajectory, make_map, make_map_image, save_map
from .video import save_picture, save_video

__all__ = [
    "Trajectory",
    "make_map",
    "make_map_image",
    "save_map",
    "save_picture",
    "save_video",
]
