"""Materials that several bodies share."""

from lidcam.bags.simulator.world.meshes.mesh import Material

RUBBER = Material("rubber", (0.16, 0.16, 0.165), 0.06)
DARK = Material("dark plastic", (0.13, 0.13, 0.14), 0.08, mirror=0.02)
SEAM = Material("seam", (0.10, 0.10, 0.11), 0.10)
GLASS = Material("glass", (0.13, 0.16, 0.18), 0.06, mirror=0.10, transmission=0.6)
CHROME = Material("chrome", (0.62, 0.63, 0.65), 0.5, mirror=0.35)
METAL = Material("steel", (0.45, 0.46, 0.48), 0.4, mirror=0.06)
HEADLAMP = Material("headlamp", (0.90, 0.92, 0.93), 0.9, mirror=0.15)
TAIL_LAMP = Material("tail lamp", (0.70, 0.05, 0.05), 1.6, mirror=0.05)
SIGNAL = Material("direction lamp", (0.95, 0.50, 0.08), 1.2, mirror=0.05)
PLATE = Material("number plate", (0.93, 0.93, 0.90), 3.0)
PLATE_YELLOW = Material("number plate, rear", (0.93, 0.86, 0.55), 3.0)


def paint(color: tuple[float, float, float], name: str = "paint") -> Material:
    """Car paint; dark paint reflects less of a lidar's light."""
    brightness = 0.3 * color[0] + 0.59 * color[1] + 0.11 * color[2]
    return Material(name, color, 0.10 + 0.75 * brightness**1.5, mirror=0.05)
