"""The process of one job, `python -m lidcam.batches.worker`: a pickled `Task` in, a pickled `JobRecord` out."""

import gc
import os
import pickle
import sys
from dataclasses import replace

from lidcam.batches.engine import Task
from lidcam.batches.records import JobRecord, with_outputs, with_summary
from lidcam.outputs.sending import sent_when_complete
from lidcam.pipeline.core.text import one_line
from lidcam.processing import RunObserver, process_recording
from lidcam.run.frames import RunInput
from lidcam.run.warning import error_line
from lidcam.signals import end_at_signals


class _Frozen(RunObserver):
    def opened(self, source: RunInput) -> None:  # noqa: ARG002
        gc.freeze()  # libraries and stages stay: looking for garbage among them takes 5 ms a frame


def run_task(task: Task) -> JobRecord:
    """Run a job in this process."""
    try:
        with sent_when_complete(task.outputs, task.job.inputs, overwrite=task.job.overwrite) as sending:
            summary = sending.send(process_recording(replace(task.job, outputs=sending.local), _Frozen()))
        return with_outputs(with_summary(task.record, summary), task.outputs)
    except Exception as err:
        line = error_line(err) or f"{type(err).__name__}: {one_line(err)}"
        return replace(task.record, state="failed", exit_code=1, message=line)


def main() -> None:
    """Run the job on stdin; its record goes to stdout."""
    end_at_signals()
    with os.fdopen(os.dup(1), "wb") as result:
        os.dup2(2, 1)  # what libraries print
        pickle.dump(run_task(pickle.load(sys.stdin.buffer)), result)  # noqa: S301  # from the batch


if __name__ == "__main__":
    main()
