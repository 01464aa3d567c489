"""What a network of a kit consists of, in the words of neither kit."""

from typing import Annotated

from pydantic import Field, model_validator

from pipeline.core.settings.model import Positive, SettingsModel
from pipeline.detectors.pillars.kits import Feature, KitSpecs

__all__ = ["Anchor", "AnchorHead", "Backbone", "CenterHead", "Encoder", "KitModel", "Names"]

Channels = Annotated[int, Field(ge=1, le=2048)]
Few = Annotated[int, Field(ge=0, le=64)]


class Names(SettingsModel):
    """How a kit names its layers.

    Attributes:
        encoder: Before those of the encoder, and so on.
        blocks: Of the backbone.
        ups: Of what brings its blocks to one size.
        head: Of the head.
        first: Place of the first convolution in a block.
        boxes: The layer of anchors' boxes.
        heads: The heads of groups of classes.
        pair: A convolution and the normalisation behind it.
        heat: The branch of a head for its classes; then for places, heights, sizes and headings.
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
    """Layers over the points of a pillar; behind all but the last stands their maximum beside each point."""

    channels: Annotated[tuple[Channels, ...], Field(min_length=1, max_length=8)]
    eps: Positive = 1e-3


class Backbone(SettingsModel):
    """Convolutions over the ground.

    Attributes:
        channels: Of each block.
        layers: Convolutions of it behind the first.
        strides: Of the first.
        up_channels: Of what it is brought to.
        up_strides: By how much; below 1 it becomes smaller.
        convolves: Whether a stride of 1 is a convolution, else the reverse of one.
        eps: Of normalisation.
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
        low_m: Place of the first one along x and y, or with `is_centred` corner of its cell.
        high_m: Place of the last one, or corner of its cell.
        is_centred: Whether they stand in the middle of the cells.
        z_m: Middle of the box.
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
    """Boxes by what differs from anchors.

    Attributes:
        anchors: Of each cell.
        code: Numbers of a box.
        directions: Parts of a full turn that are told apart; 0: none.
        offset_rad: Where the first begins.
        limit: How far a heading may lie before it, in parts.
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
        kernel: Of their convolutions.
        heat_layers: Convolutions of the branch of classes.
        branches: Numbers and convolutions of the others, by name.
        has_bias: Whether convolutions before a normalisation have one.
        sine_first: Whether the sine of the heading stands before its cosine.
        eps: Of normalisation.
        stride: Pillars of a cell.
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
        names: Of its layers.
        specs: What its file will say of it.
        raw: What the kit knows of each point by itself.
        encoder: Over the points of a pillar.
        backbone: Over the ground.
        head: What says where objects are.
    """

    names: Names
    specs: KitSpecs
    raw: tuple[Feature, ...]
    encoder: Encoder
    backbone: Backbone
    head: AnchorHead | CenterHead
