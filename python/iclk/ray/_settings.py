"""What the results depend on, and how a worker goes about them."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

FREE = ("device", "batch", "threads", "max_pixels")  #: on which no bit of a result depends


@dataclass(frozen=True)
class Settings:
    camera: str = ""
    distortion: str = ""
    depth_scale: float = 0
    depth_sigma: str = "auto"
    mask: str = ""
    detector: str = "shi-tomasi"
    count: int = 200
    with_features: bool = False
    model: str = "auto"
    options: dict[str, Any] = field(default_factory=dict)  #: iclk.Options
    device: str = ""
    batch: int = 0  #: 0: by the device
    threads: int = 0  #: 0: by the worker's CPUs
    max_pixels: int = 8192 * 8192

    def effective(self) -> dict[str, Any]:
        """What must be the same where a run is continued."""
        return {key: value for key, value in asdict(self).items() if key not in FREE}
