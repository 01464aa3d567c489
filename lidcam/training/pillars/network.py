"""The network in PyTorch: an encoder of pillars, convolutions over the ground, a head for the centres of objects.

After PointPillars (Lang et al., 2019) and CenterPoint (Yin, Zhou, Kraehenbuehl, "Center-based 3D object detection and
tracking", CVPR 2021), and much smaller than either, so that one core of a processor trains and runs it.
"""

import math
from typing import cast

import torch
from torch import Tensor, nn

from lidcam.pipeline.detectors.pillars.decoding import BOX_NUMBERS
from lidcam.pipeline.detectors.pillars.grid import FEATURES, STRIDE

WIDTH = 32
BLOCKS = (32, 2), (64, 3), (96, 3)
"""Channels and convolutions of each block; the first of each halves the resolution."""

LIKELY = 0.01
"""Probability of an object in each cell before anything is learned."""


class PillarNetwork(nn.Module):  # type: ignore[misc]  # mypy skips torch
    """Turns the points in pillars into the numbers of each cell of the output."""

    def __init__(self, classes: int) -> None:
        super().__init__()
        self.encoder = nn.Sequential(nn.Linear(len(FEATURES), WIDTH, bias=False), nn.BatchNorm1d(WIDTH), nn.ReLU())
        self.blocks, self.ups = nn.ModuleList(), nn.ModuleList()
        before, scale = WIDTH, 1
        for channels, layers in BLOCKS:
            parts = [layer for row in range(layers) for layer in _convolved(channels if row else before, channels, row)]
            self.blocks.append(nn.Sequential(*parts))
            up = nn.ConvTranspose2d(channels, WIDTH, scale, stride=scale, bias=False)
            self.ups.append(nn.Sequential(up, nn.BatchNorm2d(WIDTH)))
            before, scale = channels, 2 * scale
        self.head = nn.Sequential(*_convolved(WIDTH, WIDTH, 1))
        self.last = nn.Conv2d(WIDTH, classes + BOX_NUMBERS, 1)
        nn.init.zeros_(self.last_bias)
        nn.init.constant_(self.last_bias[:classes], math.log(LIKELY / (1 - LIKELY)))

    @property
    def last_bias(self) -> Tensor:
        """(classes + `BOX_NUMBERS`,) bias of the numbers of each cell."""
        return cast(Tensor, self.last.bias)

    def forward(self, features: Tensor, pillar: Tensor, frames: int, cells: int, *, bfloat16: bool = False) -> Tensor:
        """(B, classes + `BOX_NUMBERS`, H, W) numbers; the first are the log odds that an object of each class is there.

        Args:
            features: (P, F) features of the points of all frames.
            pillar: (P,) int64 pillar of each point; pillars are numbered on from frame to frame.
            frames: Number of frames, B.
            cells: Pillars along x and along y.
            bfloat16: Whether convolutions compute in bfloat16. The encoder does not, because oneDNN would keep code
                for each number of points, some megabytes in each step.
        """
        encoded = self.encoder(features)
        canvas = encoded.new_zeros((frames * cells * cells, WIDTH))
        canvas = canvas.scatter_reduce(0, pillar[:, None].expand(-1, WIDTH), encoded, "amax")
        image = canvas.view(frames, cells, cells, WIDTH).permute(0, 3, 1, 2)  # channels last: faster on processors
        total = encoded.new_zeros(())
        with torch.autocast(features.device.type, torch.bfloat16, bfloat16):
            for block, up in zip(self.blocks, self.ups, strict=True):
                image = block(image)
                total = total + up(image)
            return cast(Tensor, self.last(self.head(torch.relu(total))).float())


def _convolved(before: int, channels: int, row: int) -> list[nn.Module]:
    convolution = nn.Conv2d(before, channels, 3, stride=1 if row else STRIDE, padding=1, bias=False)
    return [convolution, nn.BatchNorm2d(channels), nn.ReLU()]
