"""The network in PyTorch: convolutions over the image, and three grids, each with a head for the objects at its cells.

The grids and the numbers of each cell are those of YOLOX (Ge et al., 2021); the network is much smaller, so that one
processor core can train and run it. Coarse grids, which see more of the image, pass what they see to the finer ones
(Lin et al., "Feature pyramid networks", 2017).
"""

import math
from typing import cast

import torch
from torch import Tensor, nn

BLOCKS = (((12, 2), (20, 2), (32, 2), (32, 1)), ((48, 2), (48, 1)), ((64, 2), (64, 1), (64, 1)))
"""Channels and strides of the convolutions up to each of the grids."""

WIDTH = 32
"""Channels of the heads. Each grid has its own head: their numbers differ, and a shared normalisation fails."""

LIKELY = 0.01
"""Probability of an object in each cell before anything is learned."""


class ImageNetwork(nn.Module):
    """Turns images into the numbers of each cell."""

    def __init__(self, classes: int) -> None:
        super().__init__()
        self.blocks, self.laterals, self.heads = nn.ModuleList(), nn.ModuleList(), nn.ModuleList()
        before = 3
        for block in BLOCKS:
            layers: list[nn.Module] = []
            for channels, stride in block:
                layers += _convolved(before, channels, stride)
                before = channels
            self.blocks.append(nn.Sequential(*layers))
            self.laterals.append(nn.Conv2d(before, WIDTH, 1))
            last = nn.Conv2d(WIDTH, 5 + classes, 1)
            nn.init.constant_(cast(Tensor, last.bias)[4:5], math.log(LIKELY / (1 - LIKELY)))
            self.heads.append(nn.Sequential(*_convolved(WIDTH, WIDTH, 1), last))

    def forward(self, images: Tensor) -> Tensor:
        """(B, A, 5 + C) for images (B, 3, H, W), blue first, 0 to 255, whose height and width are multiples of 32.

        Numbers of each cell, in the order of YOLOX: the middle of a box and the logarithms of its width and height, in
        cells; the log odds that there is a box; and the log odds of each class.
        """
        found = []
        for block in self.blocks:
            images = block(images)
            found.append(images)
        total, rows = None, []
        for image, lateral, head in zip(found[::-1], self.laterals[::-1], self.heads[::-1], strict=True):
            own = lateral(image)
            total = own if total is None else own + nn.functional.interpolate(total, scale_factor=2.0)
            rows.append(head(torch.relu(total)).flatten(2))
        return torch.cat(rows[::-1], 2).transpose(1, 2)


def _convolved(before: int, channels: int, stride: int) -> list[nn.Module]:
    convolution = nn.Conv2d(before, channels, 3, stride=stride, padding=1, bias=False)
    return [convolution, nn.BatchNorm2d(channels), nn.ReLU()]
