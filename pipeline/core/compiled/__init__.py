"""Functions compiled for this processor: loops over points that no array operation does in one pass.

numba compiles them, without a compiler on the machine. The first use on a machine takes some seconds per file; what it
makes is kept beside the source, or in the user's cache where that cannot be written (`NUMBA_CACHE_DIR` names another
place). Where nothing can be kept, each process compiles anew. What was kept is run without numba: `linking`.

Rules for such functions, so that every machine makes the same bytes:

- No fast-math, no parallel loops: sums run in the written order, and no product is fused with a sum.
- No sine, exponential or the like where a decision depends on it: they differ in the last bit between machines.
- They use parts, compiled functions and numbers, of their own file or of others, by names of their own file
  (`from ... import ...`): what is kept is made anew when one of these files or numbers changes.
- Their files are imported where a stage is built, never for `--help`, and import no numba: it takes half a second.
"""

from pipeline.core.compiled.beside import compiled_beside
from pipeline.core.compiled.functions import compiled, compiled_as, inlined

__all__ = ["compiled", "compiled_as", "compiled_beside", "inlined"]
