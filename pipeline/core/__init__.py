"""Records, geometry, cameras, settings and errors: what everything else is built on."""
