"""The look of surfaces: textures, road markings, noise."""
