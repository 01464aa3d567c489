"""Records, geometry, cameras, settings and errors, shared by all packages."""
