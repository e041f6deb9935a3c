"""Messages that a page may send: its camera, a value of a control that it shows, and a hotkey.

viser sets whatever attribute of whatever control a message names. Messages are therefore read
here first, and anything that the viewer's own page does not send is dropped.
"""

from __future__ import annotations

import math
from typing import Any

from hrl_escape.viewer.extra import msgspec, viser

__all__ = ["is_expected"]

_Three = tuple[float, float, float]


class _Camera(msgspec.Struct, tag="ViewerCameraMessage", tag_field="type", forbid_unknown_fields=True):
    wxyz: tuple[float, float, float, float]
    position: _Three
    fov: float
    near: float
    far: float
    image_height: int
    image_width: int
    look_at: _Three
    up_direction: _Three

    def is_finite(self) -> bool:
        numbers = (*self.wxyz, *self.position, *self.look_at, *self.up_direction, self.fov, self.near, self.far)
        return all(map(math.isfinite, numbers)) and 0 < self.image_height < 2**16 and 0 < self.image_width < 2**16


class _Value(msgspec.Struct, forbid_unknown_fields=True):
    value: bool | int | float | str


class _Update(msgspec.Struct, tag="GuiUpdateMessage", tag_field="type", forbid_unknown_fields=True):
    uuid: str
    updates: _Value


class _Trigger(msgspec.Struct, tag="CommandTriggerMessage", tag_field="type", forbid_unknown_fields=True):
    uuid: str


_DECODER = msgspec.msgpack.Decoder(_Camera | _Update | _Trigger)


def is_expected(server: Any, client: int | None, raw: object) -> bool:
    """True for a message that the viewer's own page could have sent.

    Args:
        server: the viser server.
        client: number of the client that sent it; None if it is not known.
        raw: the message as it came.
    """
    if not isinstance(raw, bytes):
        return False
    try:
        message = _DECODER.decode(raw)
    except (msgspec.MsgspecError, ValueError, RecursionError):
        return False
    if isinstance(message, _Camera):
        return message.is_finite()
    if isinstance(message, _Trigger):
        return True  # viser knows its commands, and a trigger carries nothing else
    handle = server.gui._gui_input_handle_from_uuid.get(message.uuid)
    own = server.get_clients().get(client)
    if handle is None and own is not None:
        handle = own.gui._gui_input_handle_from_uuid.get(message.uuid)
    return handle is not None and _may_set(handle, message.updates.value)


def _may_set(handle: Any, value: bool | int | float | str) -> bool:
    """True if a page can give this value to this control."""
    if handle.disabled or not handle.visible:
        return False
    if isinstance(handle, (viser.GuiButtonGroupHandle, viser.GuiDropdownHandle)):
        return isinstance(value, str) and value in handle.options
    if isinstance(handle, (viser.GuiButtonHandle, viser.GuiCheckboxHandle)):
        return isinstance(value, bool)
    if isinstance(handle, viser.GuiSliderHandle):
        return not isinstance(value, (bool, str)) and handle.min <= value <= handle.max
    return False
