"""Jobs of a batch that do not take the time of a run."""

import os
from dataclasses import replace
from pathlib import Path

from lidcam.batches.local import LocalEngine, Task
from lidcam.batches.records import EXIT_CODES, JobRecord, State, with_outputs
from lidcam.writers.outputs.transaction import OutputTransaction


class Written(LocalEngine):
    """Writes a result; fails where the recording says so."""

    def __init__(self) -> None:
        super().__init__(1)
        self.ran: list[str] = []

    def run(self, task: Task, *, keep_open: int | None) -> JobRecord:
        (recording,), (output,) = task.job.inputs, task.outputs
        assert isinstance(recording, Path)
        assert isinstance(output, Path)
        self.ran.append(recording.name)
        os.fstat(keep_open or 0)
        content = recording.read_bytes()
        if content.startswith(b"bad"):
            return replace(task.record, state="failed", exit_code=1, message="it is bad")
        with OutputTransaction([output]) as outputs:
            outputs[output].write_bytes(content)
        state: State = "incomplete" if content.startswith(b"cut") else "done"
        return with_outputs(replace(task.record, state=state, exit_code=EXIT_CODES[state]), task.outputs)
