"""Packages of the extra `viewer`, imported in one place with one error that names the extra."""

from hrl_escape.errors import MissingExtraError

try:
    import msgspec
    import trimesh
    import viser
    import viser.infra
    import websockets
    import websockets.asyncio.server
    from viser import uplot
    from viser.transforms import SO3
except ImportError as missing:
    raise MissingExtraError("viser", "viewer", "The viewer") from missing

__all__ = ["SO3", "msgspec", "trimesh", "uplot", "viser", "websockets"]
