"""The log of compiled functions, in a file of its own: `lidcam --help` need not import numba."""

import logging

compile_log = logging.getLogger("lidcam.pipeline.compiled")
"""At level INFO: a function is compiled because it was not kept. It may take a while, once."""
