"""The line between recorded bytes and typed data: what definitions must have, and what decoders may raise."""
