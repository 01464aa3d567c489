"""The log of what is compiled; apart from `pipeline.core.compiled`, so that `lidcam --help` need not import that."""

import logging

__all__ = ["compile_log"]

compile_log = logging.getLogger("pipeline.compiled")
"""What is compiled because it was not kept, at level INFO: it may take a while, once."""
