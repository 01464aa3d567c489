"""The parts of a kit's network, in terms that both kits share."""

from typing import Annotated

from pydantic import Field, model_validator

from lidcam.pipeline.core.settings.model import Positive, SettingsModel
from lidcam.pipeline.detectors.pillars.kits import Feature, KitSpecs

Channels = Annotated[int, Field(ge=1, le=2048)]
Few = Annotated[int, Field(ge=0, le=64)]


class Names(SettingsModel):
    """How a kit names its layers.

    Attributes:
        encoder: Prefix of the encoder's layers.
        blocks: Prefix of the backbone's blocks.
        ups: Prefix of the layers that bring these blocks to one size.
        head: Prefix of the head's layers.
        first: Place of the first convolution in a block.
        boxes: The layer for the boxes of anchors.
        heads: The heads of the groups of classes.
        pair: A convolution and the normalisation that follows it.
        heat: The branch of a head for its classes.
        branches: Its branches for places, heights, sizes and headings.
    """

    encoder: str
    blocks: str
    ups: str
    head: str
    first: int
    boxes: str
    heads: str
    pair: tuple[str, str]
    heat: str
    branches: tuple[str, str, str, str]


class Encoder(SettingsModel):
    """Layers over the points of a pillar; after each but the last, the pillar's maximum is added to each point."""

    channels: Annotated[tuple[Channels, ...], Field(min_length=1, max_length=8)]
    eps: Positive = 1e-3


class Backbone(SettingsModel):
    """Convolutions over the ground.

    Attributes:
        channels: Channels of each block.
        layers: Convolutions of each block after the first.
        strides: Stride of the first convolution of each block.
        up_channels: Channels of each block after scaling.
        up_strides: Factor by which each block is scaled; below 1 it becomes smaller.
        convolves: Whether a factor of 1 is a convolution; otherwise it is a transposed one.
        eps: Epsilon of the normalisations of the blocks.
        up_eps: The same for the scaling layers.
    """

    channels: Annotated[tuple[Channels, ...], Field(min_length=1, max_length=8)]
    layers: tuple[Few, ...]
    strides: tuple[Annotated[int, Field(ge=1, le=16)], ...]
    up_channels: tuple[Channels, ...]
    up_strides: tuple[Annotated[float, Field(ge=1 / 16, le=16)], ...]
    convolves: bool = False
    eps: Positive = 1e-3
    up_eps: Positive = 1e-3

    @model_validator(mode="after")
    def _one_of_each(self) -> "Backbone":
        counts = {len(one) for one in (self.channels, self.layers, self.strides, self.up_channels, self.up_strides)}
        if len(counts) > 1:
            raise ValueError("expected as many strides and channels as blocks, and one way up for each")
        return self


class Anchor(SettingsModel):
    """A box in each cell of the output.

    Attributes:
        low_m: Place of the first box along x and y; with `is_centred`, the corner of its cell.
        high_m: Place of the last box, or the corner of its cell.
        is_centred: Whether boxes stand in the middle of their cells.
        z_m: Height of the middle of the box.
        size_m: Length, width, height.
        yaw_rad: Heading.
    """

    low_m: tuple[float, float]
    high_m: tuple[float, float]
    is_centred: bool
    z_m: float
    size_m: tuple[Positive, Positive, Positive]
    yaw_rad: float


class AnchorHead(SettingsModel):
    """Boxes as differences from anchors.

    Attributes:
        anchors: Anchors of each cell.
        code: How many numbers describe a box.
        directions: How many parts of a full turn the network distinguishes; 0: none.
        offset_rad: Heading at which the first part begins.
        limit: How far before that a heading may lie, in parts.
    """

    anchors: Annotated[tuple[Anchor, ...], Field(min_length=1, max_length=64)]
    code: Annotated[int, Field(ge=7, le=16)] = 7
    directions: Few
    offset_rad: float
    limit: float


class CenterHead(SettingsModel):
    """Boxes at the peaks of classes.

    Attributes:
        tasks: Classes of each group.
        shared: Channels of what all groups share.
        width: Channels of the branches.
        kernel: Kernel size of their convolutions.
        heat_layers: Number of convolutions in the branch for classes.
        branches: How many numbers and convolutions the other branches have, by name.
        has_bias: Whether convolutions before a normalisation have a bias.
        sine_first: Whether the sine of the heading comes before its cosine.
        eps: Epsilon of the normalisations.
        stride: Pillars along each side of a cell.
    """

    tasks: Annotated[tuple[tuple[str, ...], ...], Field(min_length=1, max_length=64)]
    shared: Channels
    width: Channels
    kernel: Annotated[int, Field(ge=1, le=7)]
    heat_layers: Annotated[int, Field(ge=1, le=8)]
    branches: dict[str, tuple[Few, Annotated[int, Field(ge=1, le=8)]]]
    has_bias: bool
    sine_first: bool
    eps: Positive = 1e-5
    stride: Annotated[int, Field(ge=1, le=64)]


class KitModel(SettingsModel):
    """A network and how its layers are named.

    Attributes:
        names: Names of its layers.
        specs: What its file will say about it.
        raw: Features of each point by itself.
        encoder: Layers over the points of a pillar.
        backbone: Convolutions over the ground.
        head: Layers that locate objects.
    """

    names: Names
    specs: KitSpecs
    raw: tuple[Feature, ...]
    encoder: Encoder
    backbone: Backbone
    head: AnchorHead | CenterHead
