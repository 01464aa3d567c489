"""Colours that textures put beside a material's own."""

from dataclasses import dataclass

from bags.simulator.world.meshes.mesh import Rgb

__all__ = ["OWN", "Look", "linear"]


@dataclass(frozen=True, slots=True)
class Look:
    """One of a texture's colours.

    Attributes:
        rgb: As displayed (sRGB); none: the material's.
        reflectivity: As of `bags.simulator.world.meshes.mesh.Material`; none: the material's.
    """

    rgb: Rgb | None = None
    reflectivity: float | None = None


OWN = Look()
"""The material's own."""


def linear(rgb: Rgb) -> Rgb:
    """Amounts of light of a displayed colour (sRGB, IEC 61966-2-1)."""
    red, green, blue = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in rgb)
    return red, green, blue
