"""Where the rig is, as its own clouds say."""

from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F64, check_array

__all__ = ["OdometryPose"]


@dataclass(frozen=True, slots=True, eq=False)
class OdometryPose:
    """Pose of the site frame at a frame's stamp, from the clouds.

    Attributes:
        T_fixed_site: (4, 4) float64, in the frame that the site frame was in the first cloud; metres.
        is_predicted: Whether the cloud could not be registered, so that this is the last motion carried on.
    """

    T_fixed_site: F64
    is_predicted: bool

    def __post_init__(self) -> None:
        check_array("T_fixed_site", self.T_fixed_site, (4, 4), np.float64)
