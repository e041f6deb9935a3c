"""What the extra `viewer` brings in, or one clear error that names it; whatever draws imports them from here."""

from hrl_escape.errors import MissingExtraError

try:
    import trimesh
    import viser
    from viser import uplot
    from viser.transforms import SO3
except ImportError as missing:
    raise MissingExtraError("viser", "viewer", "The viewer") from missing

__all__ = ["SO3", "trimesh", "uplot", "viser"]
