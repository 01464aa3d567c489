"""The log of what is compiled; apart from `pipeline.core.compiled`, so that `lidcam --help` need not import that."""

import logging

__all__ = ["compile_log"]

compile_log = logging.getLogger("pipeline.compiled")
"""At level INFO: a function is compiled because it was not kept. It may take a while, once."""
