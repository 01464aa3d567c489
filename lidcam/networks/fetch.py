"""Downloads a network from its maker: only when the user asks for it, and whole or not at all."""

import hashlib
from http.client import HTTPException, HTTPMessage
from pathlib import Path
from typing import IO
from urllib.error import HTTPError, URLError
from urllib.parse import urlsplit
from urllib.request import HTTPRedirectHandler, Request, build_opener

from lidcam.networks.known import NETWORKS, KnownNetwork, network_path
from lidcam.pipeline.core.errors import ModelError
from lidcam.writers.outputs.errors import output_errors
from lidcam.writers.outputs.transaction import OutputTransaction

TIMEOUT_S = 30
"""Maximum silence of the server."""


def is_fetched(name: str) -> bool:
    """Whether the user has the file of a network, as its maker publishes it.

    Raises:
        OutputError: what stands there cannot be read.
    """
    path = network_path(Path(name))
    with output_errors(path):
        return path.is_file() and not _fault(path.read_bytes(), NETWORKS[name])


def fetch_network(name: str) -> Path:
    """Download a network into the user's data folder, in place of what stands there.

    Args:
        name: One of `NETWORKS`.

    Returns:
        The file.

    Raises:
        ModelError: the server cannot be reached, refuses, leads elsewhere than to https, or gives another file.
        OutputError: the file cannot be written.
    """
    network, path = NETWORKS[name], network_path(Path(name))
    try:
        data = _download(network)
    except (OSError, HTTPException) as err:
        fault = _reason(err)
    else:
        fault = _fault(data, network)
    if fault:
        raise ModelError(f"{network.address}: {fault}; nothing was written; download it by hand and save it as {path}")
    with output_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    with OutputTransaction([path]) as outputs, output_errors(path), outputs[path].part.open("xb") as file:
        file.write(data)
    return path


def _download(network: KnownNetwork) -> bytes:
    """The file that the server gives, or one byte more than its size."""
    with build_opener(_SafeRedirects).open(network.address, timeout=TIMEOUT_S) as response:
        data: bytes = response.read(network.size_bytes + 1)
    return data


def _fault(data: bytes, network: KnownNetwork) -> str:
    """Fault of a file; empty if there is none."""
    if len(data) != network.size_bytes:
        found = f"{len(data)}" if len(data) < network.size_bytes else "more"
        return f"expected {network.size_bytes} bytes, found {found}"
    found = hashlib.sha256(data).hexdigest()
    return "" if found == network.sha256 else f"expected SHA-256 {network.sha256}, found {found}"


def _reason(err: OSError | HTTPException) -> str:
    if isinstance(err, HTTPError):
        return f"the server answers {err.code} {err.reason}"
    if isinstance(err, URLError):
        return f"cannot be reached: {err.reason}"
    return f"the connection broke: {err or type(err).__name__}"


class _SafeRedirects(HTTPRedirectHandler):
    """Follows redirects to https alone; from plain http, which no maker's address is, also to http."""

    def redirect_request(
        self, req: Request, fp: IO[bytes], code: int, msg: str, headers: HTTPMessage, newurl: str
    ) -> Request | None:
        target = urlsplit(newurl)
        if target.scheme not in {"https", req.type}:
            raise URLError(f"it leads to {target.scheme}://{target.hostname}, and not to https")
        return super().redirect_request(req, fp, code, msg, headers, newurl)
