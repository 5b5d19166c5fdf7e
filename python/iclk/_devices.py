"""Vulkan devices."""

from __future__ import annotations

from typing import TypedDict

from . import _core


class Device(TypedDict):
    """A device, as `iclk devices --json` lists it."""

    index: int  #: for ``device=``, which also takes the UUID or a part of the name
    name: str
    type: str  #: "discrete", "integrated", "virtual", "cpu" (lavapipe; faster than device="cpu") or "other"
    uuid: str
    vulkan: str
    driver: str
    memory_bytes: int
    subgroup_size: int
    usable: bool
    rejected: str  #: why it is not usable; else empty


def devices() -> list[Device]:
    """Returns the Vulkan devices of this machine. Without Vulkan the list is empty; use ``device="cpu"`` then."""
    return _core.devices()
