"""Settings of an `open` world: its ground, and what stands on it."""

from typing import Annotated, Literal

from pydantic import Field

from lidcam.bags.simulator.scenario.sensors import Metres
from lidcam.pipeline.core.settings.model import NotNegative, Positive, SettingsModel, Share

ThingKind = Literal[
    "box", "cylinder", "cone", "lump", "fence", "bicycle", "tree", "conifer", "bush", "hedge", "grass", "table"
]


class RoadScenario(SettingsModel):
    """A straight road."""

    from_m: tuple[Metres, Metres]  # x, y of one end of its middle line
    to_m: tuple[Metres, Metres]  # x, y of the other
    width_m: Positive = 7.0  # from kerb to kerb


class GroundScenario(SettingsModel):
    """The ground of an `open` world."""

    reach_m: Positive = 120.0  # it reaches this far from the origin along x and y
    roads: tuple[RoadScenario, ...] = ()  # roads, which are of asphalt
    kerb_m: NotNegative = 0.12  # height of all other ground above the roads
    # Rise per metre along x and y
    slope: tuple[Annotated[float, Field(ge=-0.2, le=0.2)], Annotated[float, Field(ge=-0.2, le=0.2)]] = (0.0, 0.0)
    waves_m: NotNegative = 0.0  # height of its gentle waves
    wave_length_m: Positive = 60.0  # their length
    # Standard deviation of the height of small bumps beside the roads; a quarter of it on them
    roughness_m: NotNegative = 0.0
    seed: Annotated[int, Field(ge=0)] = 0  # of waves and bumps


class ThingScenario(SettingsModel):
    """A thing that stands in an `open` world."""

    # Its form. `lump` is a heap, `bicycle` a parked one. Of `tree`, `conifer`, `bush`, `hedge` and `grass` a lidar sees
    # single leaves, and some of what is behind.
    kind: ThingKind = "box"
    position_m: tuple[Metres, Metres]  # x, y of its middle
    size_m: tuple[Positive, Positive, Positive]  # length, width, height
    yaw_deg: float = 0.0  # direction of its length, counter-clockwise from x
    bottom_m: NotNegative = 0.0  # height of its lower end above the ground
    color: tuple[Share, Share, Share] = (0.5, 0.5, 0.5)  # sRGB, each in [0, 1]
    # Share of a lidar's light that it reflects; above 1 for a retroreflector, as signs are
    reflectivity: Annotated[float, Field(ge=0, le=10)] = 0.3
