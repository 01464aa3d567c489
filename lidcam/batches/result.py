"""What a batch has done, for Python."""

from dataclasses import dataclass

from lidcam.batches.records import JobRecord
from lidcam.pipeline.core.text import brief


@dataclass(frozen=True, slots=True)
class BatchResult:
    """A batch that has ended.

    Attributes:
        records: What became of each recording, in the order of their names; those that were not started are missing.
        count: Number of recordings that were found.
        table: The Parquet file with these records.
    """

    records: tuple[JobRecord, ...]
    count: int
    table: str

    __repr__ = brief

    @property
    def failed(self) -> tuple[JobRecord, ...]:
        """The records of the recordings without a result; `message` says why."""
        return tuple(record for record in self.records if record.state == "failed")
