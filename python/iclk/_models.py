"""The models in this package."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from . import _core


def folders() -> list[str]:
    return [str(Path(__file__).parent / "models")]


def default_model() -> str:
    return os.environ.get("ICLK_MODEL") or "auto"


def model_info(model: str, width: int = 752, height: int = 480) -> dict[str, Any]:
    """Returns what `iclk model info --json` prints: architecture, parameters, GMAC, licence, provenance of a model.

    model: "sd6dof", "sd6dof-small" or a path. width, height: image size for the cost. Raises ``iclk.Error`` (code "io") for a
    missing or damaged model, ValueError for images that are too small for its levels.
    """
    info: dict[str, Any] = json.loads(_core.model_info(model, width, height, folders()))
    return info
