"""The table of a batch, as Parquet: a row for each recording."""

from collections.abc import Sequence
from dataclasses import asdict
from io import BytesIO

import pyarrow as pa
import pyarrow.parquet as pq

from lidcam.batches.jobs import TABLE_STEM
from lidcam.batches.records import JobRecord

TABLE = f"{TABLE_STEM}.parquet"
"""Table of the batch, in the folder of the results; readers of a folder of tables skip names like this."""

SCHEMA = pa.schema(
    [
        ("recording", pa.string()),
        ("input", pa.string()),
        ("state", pa.string()),
        ("exit_code", pa.int32()),
        ("message", pa.string()),
        ("frames", pa.int64()),
        ("objects", pa.list_(pa.struct([("class", pa.string()), ("count", pa.int64())]))),
        ("road_users", pa.list_(pa.struct([("class", pa.string()), ("count", pa.int64())]))),
        ("dropped", pa.int64()),
        ("skew_max_ms", pa.float64()),
        ("lacking", pa.list_(pa.struct([("sensor", pa.string()), ("frames", pa.int64())]))),
        ("processor_s", pa.float64()),
        ("wall_s", pa.float64()),
        ("peak_mib", pa.float64()),
        ("sha256", pa.list_(pa.string())),
        ("settings", pa.string()),
        ("settings_sha256", pa.string()),
        ("version", pa.string()),
    ]
)


def records_table(records: Sequence[JobRecord]) -> bytes:
    """A row for each record, as Parquet."""
    rows = [
        {
            **asdict(one),
            "recording": one.name,
            "objects": [{"class": name, "count": count} for name, count in (one.objects or {}).items()],
            "road_users": [{"class": name, "count": count} for name, count in (one.road_users or {}).items()],
            "lacking": [{"sensor": name, "frames": count} for name, count in (one.lacking or {}).items()],
        }
        for one in records
    ]
    content = BytesIO()
    pq.write_table(pa.Table.from_pylist(rows, SCHEMA), content)
    return content.getvalue()
