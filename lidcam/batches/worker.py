"""The process that jobs are copies of: for each pickled `Task`, a pickled `JobRecord`."""

import gc
import os
import pickle
import signal
import socket
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from lidcam.batches.local import Task
from lidcam.batches.records import JobRecord, with_outputs, with_summary
from lidcam.outputs.sending import sent_when_complete
from lidcam.pipeline.core.ending import undone_at_once
from lidcam.pipeline.core.text import one_line
from lidcam.pipeline.parallel.process import signals_blocked
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


def serve(run: Callable[[Task], JobRecord] = run_task) -> None:
    """Run jobs one after another, each in a copy of this process, until stdin, a socket, is closed.

    A job comes as descriptors: its task, its record, what is printed, and what it holds open. The answer is its status
    and usage. If there is none, this process and the job have ended when the socket has.
    """
    end_at_signals()
    with socket.socket(fileno=0) as link:
        while files := socket.recv_fds(link, 1, 4)[1]:
            with signals_blocked():
                child = os.fork()
            if not child:
                os.dup2(files[2], 1)
                os.dup2(files[2], 2)
                with os.fdopen(files[0], "rb") as given, os.fdopen(files[1], "wb") as result:
                    pickle.dump(run(pickle.load(given)), result)  # noqa: S301  # from the batch
                return
            for file in files:
                os.close(file)
            with undone_at_once(partial(os.kill, child, signal.SIGTERM)):
                _, status, usage = os.wait4(child, 0)
            link.sendall(pickle.dumps((status, usage.ru_utime + usage.ru_stime, usage.ru_maxrss)))
