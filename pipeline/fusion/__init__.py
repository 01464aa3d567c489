"""Pure functions of fusion, shared by its stages."""
