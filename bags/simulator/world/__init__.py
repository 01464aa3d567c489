"""The simulated world: meshes, surfaces, movers, ray casting."""
