"""Messages of one moment: which message of each topic belongs together.

Three policies, each a class that is fed one message at a time and can be tested alone, and one generator over them:
`ApproximateTime` and `ApproximateTimePython` behave as the two synchronisers of ROS's message_filters, `Nearest`
goes by the distance to a reference topic. All work in event time: only stamps and the order of arrival count.
"""

from pipeline.stages.sync.approximate_time import ApproximateTime
from pipeline.stages.sync.approximate_time_python import ApproximateTimePython
from pipeline.stages.sync.nearest import Nearest
from pipeline.stages.sync.policy import DropReason, Policy
from pipeline.stages.sync.synchronize import SyncStats, synchronize

__all__ = [
    "ApproximateTime",
    "ApproximateTimePython",
    "DropReason",
    "Nearest",
    "Policy",
    "SyncStats",
    "synchronize",
]
