from .maps import Trajectory, make_map, make_map_image, save_map
from .video import make_filmstrip, save_picture, save_video

__all__ = [
    "Trajectory",
    "make_filmstrip",
    "make_map",
    "make_map_image",
    "save_map",
    "save_picture",
    "save_video",
]
