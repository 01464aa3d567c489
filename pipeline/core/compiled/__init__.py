"""Functions compiled for this processor: loops over points that no array operation does in one pass.

numba compiles them, without a compiler on the machine, and keeps them: see `functions`. Rules for such functions, so
that every machine makes the same bytes:

- No fast-math, no parallel loops: sums run in the written order, and no product is fused with a sum.
- No sine, exponential or the like where a decision depends on it: they differ in the last bit between machines.
- They use functions and numbers of files with compiled functions alone: a change of any of these files compiles all
  of them anew.
- Their files are imported where a stage is built, never for `--help`: numba takes half a second to import.
"""

from lidcam.pipeline.core.compiled.functions import compiled, inlined

__all__ = ["compiled", "inlined"]
