"""Loops over points that no array operation does in one pass, and over fields of messages, in C++.

`kernels` is built of the files here as lidcam is installed (`hatch_build.py`). Rules for them, so that every machine
makes the same bytes:

- Sums run in the written order: no fast-math, no product fused with a sum (`-ffp-contract=off`).
- No sine, exponential or the like where a decision depends on it: they differ in the last bit between machines.
- They run without the interpreter's lock, except for `cdr`, which reads objects, and take arrays of exactly the types
  that `kernels.pyi` names.
"""
