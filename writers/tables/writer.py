"""Writes the fused objects of a run as one table, CSV or Parquet: one row per object and frame.

Both have the columns of `Objects.columns`. Equal results give equal bytes; those of a Parquet file depend on the
version of pyarrow, too.
"""

from abc import abstractmethod
from contextlib import ExitStack

from lidcam.pipeline.core.arrays import join_rows
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.messages import Drop
from lidcam.pipeline.core.rig import Rig
from lidcam.writers.base import ResultWriter
from lidcam.writers.outputs.errors import output_errors
from lidcam.writers.outputs.transaction import OutputFile
from lidcam.writers.provenance import Provenance
from lidcam.writers.tables.objects import Objects, parquet_metadata

CSV_HEADER = Objects.empty(Rig("", (), (), ()), ()).csv_header
"""First line of a CSV table, by which it is known."""

GROUP_ROWS = 1 << 16
"""Rows of a row group: about 15 MB of them wait in memory."""


class _ObjectsWriter(ResultWriter):
    def __init__(self, output: OutputFile, rig: Rig, class_names: tuple[str, ...]) -> None:
        self.path, self._output, self._rig, self._class_names = output.path, output, rig, class_names

    def write(self, result: FrameResult) -> tuple[Drop, ...]:
        """Write the objects of one frame; nothing of it can be unfit."""
        with output_errors(self.path):
            self._add(Objects.of_frame(result, self._rig, self._class_names))
        return ()

    @abstractmethod
    def _add(self, objects: Objects) -> None: ...


class CsvObjectsWriter(_ObjectsWriter):
    """Writes CSV in UTF-8, in the form of `Objects.write_rows`."""

    name = "csv"

    def _open(self, resources: ExitStack) -> None:
        self._file = resources.enter_context(self._output.part.open("x", encoding="utf-8", newline=""))
        self._file.write(CSV_HEADER)

    def _add(self, objects: Objects) -> None:
        objects.write_rows(self._file)


class ParquetObjectsWriter(_ObjectsWriter):
    """Writes Parquet in row groups, with where the result comes from (`Provenance.metadata`) in its metadata."""

    name = "parquet"

    def __init__(self, output: OutputFile, rig: Rig, class_names: tuple[str, ...], provenance: Provenance) -> None:
        super().__init__(output, rig, class_names)
        self._origin = parquet_metadata(rig.site_frame, provenance.metadata())
        self._waiting: list[Objects] = []
        self._waiting_rows = 0

    def _open(self, resources: ExitStack) -> None:
        from pyarrow import parquet  # takes a quarter of a second, and starts threads

        self._schema = Objects.empty(self._rig, self._class_names).to_arrow().schema.with_metadata(self._origin)
        file = resources.enter_context(self._output.part.open("xb"))
        self._parquet = resources.enter_context(parquet.ParquetWriter(file, self._schema, compression="zstd"))

    def _add(self, objects: Objects) -> None:
        if not len(objects):
            return
        self._waiting.append(objects)
        self._waiting_rows += len(objects)
        if self._waiting_rows >= GROUP_ROWS:
            self._finish()

    def _finish(self) -> None:
        if self._waiting:
            table = join_rows(*self._waiting).to_arrow()
            self._parquet.write_table(table.cast(self._schema))
            self._waiting, self._waiting_rows = [], 0
