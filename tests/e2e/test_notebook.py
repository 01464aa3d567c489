"""The notebook in `examples/` runs in an empty folder, and is stored as it ran."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import nbformat
import pytest
from helpers import ROOT

NOTEBOOK = ROOT / "examples" / "first_look.ipynb"
MAX_BYTES = 5_000_000


def outputs_of(path: Path) -> list[list[str]]:
    """Of each cell of code, the richest kind of each of its outputs."""
    book: Any = nbformat.read(path, 4)  # type: ignore[no-untyped-call]  # nbformat has no types
    return [
        [next(iter(output.get("data", {output.output_type: ""}))) for output in cell.outputs]
        for cell in book.cells
        if cell.cell_type == "code"
    ]


@pytest.mark.slow
def test_it_runs_and_is_stored_as_it_ran(tmp_path: Path) -> None:
    """It starts a kernel of Jupyter, as its readers do."""
    (empty := tmp_path / "empty").mkdir()
    copy = Path(shutil.copy(NOTEBOOK, empty))
    program = [str(Path(sys.executable).with_name("jupyter-execute")), "--inplace", copy.name]
    environment = os.environ | {"IPYTHONDIR": str(tmp_path), "JUPYTER_RUNTIME_DIR": str(tmp_path)}
    done = subprocess.run(
        program, cwd=copy.parent, env=environment, capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, done.stderr
    stored = outputs_of(NOTEBOOK)
    assert outputs_of(copy) == stored
    kinds = [kind for cell in stored for kind in cell]
    assert kinds.count("image/png") == 4
    assert kinds.count("text/html") >= 4
    assert "stream" not in kinds  # no warning, and no progress
    assert NOTEBOOK.stat().st_size < MAX_BYTES
    assert str(ROOT) not in NOTEBOOK.read_text(encoding="utf-8")
