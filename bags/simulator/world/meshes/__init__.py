"""Meshes and materials."""
