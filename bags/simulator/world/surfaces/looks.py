"""The colours of textures."""

from dataclasses import dataclass

from bags.simulator.world.meshes.mesh import Rgb

__all__ = ["OWN", "Look", "linear"]


@dataclass(frozen=True, slots=True)
class Look:
    """One of a texture's colours.

    Attributes:
        rgb: sRGB colour; None for the material's own.
        reflectivity: As in `Material`; None for the material's own.
    """

    rgb: Rgb | None = None
    reflectivity: float | None = None


OWN = Look()
"""The look of the material itself."""


def linear(rgb: Rgb) -> Rgb:
    """Linear light of an sRGB colour (IEC 61966-2-1)."""
    red, green, blue = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in rgb)
    return red, green, blue
