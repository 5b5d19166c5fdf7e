"""Results: plain values that can be pickled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Status = Literal["converged", "max_iterations", "low_overlap", "degenerate", "too_few_features", "diverged", "ambiguous"]


class Attempt(NamedTuple):
    """Result of one model of ``model="auto"``."""

    model: str
    status: Status
    reason: str


class Stage(NamedTuple):
    """The pose after a stage: "iclk", "feature_alignment", "pose", "structure", "rivals", "correction"."""

    name: str
    T_10: Floats  #: 4 x 4
    cost: float
    ms: float  #: time of the batch, shared evenly among its pairs


class Rival(NamedTuple):
    """Another pose that fits the images just as well."""

    T_10: Floats  #: 4 x 4
    inliers: int  #: features that agree on it


@dataclass(frozen=True)
class Alignment:
    """Result of a pair, as ``iclk align --json`` prints it (docs/schema/result-1.json). N features, in the given order."""

    status: Status
    reason: str  #: the status in words, with the numbers that decided it
    T_10: Floats  #: 4 x 4: takes points of camera 0 (reference) to camera 1 (target), in the unit of the depth
    covariance: Floats  #: 6 x 6 of [rho, phi], T_10 = mean Exp(xi), translation first, rad; NaN if there is none
    refined: bool  #: True: pose and covariance come from the refinement, else from ICLK
    turn: Floats | None  #: rotation by a rolling shutter, rad; None unless proven
    blur: Floats | None  #: 2 x 2, px: lines of motion blur of reference and target, if both images were blurred alike
    uv: Floats  #: N x 2, px in the target: aligned, else projected by T_10; NaN if neither
    uv_covariance: Floats  #: N x 2 x 2, px^2; NaN unless aligned
    feature_status: tuple[str, ...]  #: "aligned", "diverged", "bad_match", "out_of_image", "no_depth", ...
    inverse_depth: Floats  #: N, 1 / m: refined with structure=True, else as given
    inverse_depth_sigma: Floats  #: N; NaN unless refined
    gain: float  #: target = gain reference + bias, grey from 0 to 1, as ICLK found them
    bias: float
    visible_fraction: float
    correlation: float
    agreement: float
    inliers: int  #: features that were aligned and agree on the pose
    sigma: float  #: px, robust standard deviation of the reprojection residuals
    rivals: list[Rival]  #: with the status "ambiguous"; the one with the most features first
    static_overlay: int  #: features fixed to the camera, such as a caption; if converged, T_10 is from the others
    model: str  #: model that gave the result
    attempts: list[Attempt]
    stages: list[Stage]

    @property
    def converged(self) -> bool:
        """True if pose and covariance are valid."""
        return self.status == "converged"

    @property
    def aligned(self) -> npt.NDArray[np.bool_]:
        """N booleans: features that were found in the target."""
        return np.array([s == "aligned" for s in self.feature_status], dtype=bool)

    @staticmethod
    def _of(fields: dict[str, Any]) -> Alignment:
        fields["attempts"] = [Attempt(*a) for a in fields["attempts"]]
        fields["rivals"] = [Rival(*r) for r in fields["rivals"]]
        fields["stages"] = [Stage(*s) for s in fields["stages"]]
        return Alignment(**fields)

    def __repr__(self) -> str:
        return f"<iclk.Alignment {self.reason if self.reason.startswith(self.status) else f'{self.status}: {self.reason}'}>"
