"""Vehicles and pedestrians: how they move, where, and who controls them."""
