"""The stages, their engines and the types that they exchange. Nothing here opens recordings or prints."""
