"""Decoders: one message type each, from bytes to a record."""
