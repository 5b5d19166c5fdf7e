"""Vulkan devices."""

from __future__ import annotations

from typing import TypedDict

from . import _core


class Device(TypedDict):
    """What `iclk devices --json` says of a device."""

    index: int  #: which ``device=`` takes, as it takes a part of the name or the UUID
    name: str
    type: str  #: "discrete", "integrated", "virtual", "cpu" (lavapipe, which is faster than device="cpu") or "other"
    uuid: str
    vulkan: str
    driver: str
    memory_bytes: int
    subgroup_size: int
    usable: bool
    rejected: str  #: why not


def devices() -> list[Device]:
    """The Vulkan devices of this machine; none where there is no Vulkan, and ``device="cpu"`` is what works."""
    return _core.devices()
