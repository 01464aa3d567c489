"""Clouds and images that nodes made of those of sensors."""
