"""Outputs of a run that go to an object store: written in a temporary folder, and sent when all are complete."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from lidcam.outputs.bucket import Bucket, check_output
from lidcam.pipeline.core.errors import OutputError
from lidcam.readers.files.copies import temporary_folder
from lidcam.readers.location import Location, RemotePath
from lidcam.run.summary import RunSummary


@dataclass(frozen=True, slots=True)
class Sending:
    """Places of the outputs of a run."""

    local: tuple[Path, ...]  # The local path of each, in their order
    remote: tuple[tuple[Path, Bucket], ...] = ()  # The folder of an output, and where all that is in it is put
    overwrite: bool = False  # Whether objects that are no results are replaced, too

    def send(self, summary: RunSummary) -> RunSummary:
        """Put what was written to its places, the result last; the summary with these places."""
        sent: dict[Path, RemotePath] = {}
        for folder, bucket in reversed(self.remote):
            for path in sorted(folder.iterdir()):
                if not self.overwrite:
                    bucket.check_replaceable(path.name)
                bucket.put_file(path.name, path)
                sent[path] = bucket.at(path.name)
        if not sent:
            return summary
        left = tuple(path for path in summary.outputs if path not in sent)
        places = tuple(sent[path] for path in summary.outputs if path in sent)
        return replace(summary, outputs=left, sent=places, how_to_open={})  # no viewer opens them there


@contextmanager
def sent_when_complete(
    outputs: Sequence[Location], inputs: Sequence[Location], *, overwrite: bool
) -> Iterator[Sending]:
    """Local paths for outputs, those on a server in a temporary folder that is removed at the end of the block.

    The result is the first of the outputs; with `overwrite`, objects that are no results are replaced, too.

    Raises:
        OutputError: an output is an input, is there and is no result, or its server does not answer.
    """
    local = tuple(path for path in outputs if isinstance(path, Path))
    if len(local) == len(outputs):
        yield Sending(local)
        return
    urls = {one.url for one in inputs if isinstance(one, RemotePath)}
    with temporary_folder() as folder:
        paths, remote = [], []
        for number, output in enumerate(outputs):
            if isinstance(output, Path):
                paths.append(output)
                continue
            if output.url in urls:
                raise OutputError(f"{output}: is an input of this run; choose another name")
            check_output(output)
            bucket = Bucket(RemotePath(output.url.rpartition("/")[0]))
            bucket.check()
            if not overwrite:
                bucket.check_replaceable(output.name)
            paths.append(folder / str(number) / output.name)
            paths[-1].parent.mkdir()
            remote.append((paths[-1].parent, bucket))
        yield Sending(tuple(paths), tuple(remote), overwrite)
