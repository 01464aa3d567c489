"""What surfaces look like: textures, markings of roads, noise."""
