"""What may go wrong with a file on a server, in words that show no secrets: the libraries quote whole URLs."""

from typing import NamedTuple

__all__ = ["CHANGED", "NO_RANGES", "REMEDY", "UNUSABLE", "Fault", "ServerError", "fault_of", "fault_of_status"]

REMEDY = "download it, and read the copy"


class Fault(NamedTuple):
    """What went wrong and what to do; `passes` where the same request may succeed later."""

    reason: str
    remedy: str
    passes: bool = False


class ServerError(Exception):
    """A server's answer cannot be used.

    Attributes:
        fault: Why.
    """

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault.reason)
        self.fault = fault


NO_RANGES = Fault("its server does not give parts of a file (range requests)", REMEDY)
CHANGED = Fault("it was changed while it was read", "read it again when it is complete")
DENIED = Fault("access was denied", "check the credentials, and whether a signed link is still valid")
MISSING = Fault("no such file", "check the address")
NO_CREDENTIALS = Fault("there are no credentials for it", "set them as for the AWS CLI, or FSSPEC_S3_ANON=true")
UNUSABLE = Fault("its address cannot be used", "check the address")
REDIRECTED = Fault("its server redirects to something else than http:// and https://", "check the address")
REDIRECTS = Fault("its server redirects again and again", "check the address")
ANSWER = Fault("its server answers with something else than HTTP", f"check the address, or {REMEDY}")

BY_STATUS = {401: DENIED, 403: DENIED, 404: MISSING, 410: MISSING, 412: CHANGED, 416: CHANGED}
BY_NAME = {
    "FileExpired": CHANGED,
    "FileNotFoundError": MISSING,
    "InvalidUrlRedirectClientError": REDIRECTED,
    "InvalidURL": UNUSABLE,
    "IsADirectoryError": MISSING,
    "NoCredentialsError": NO_CREDENTIALS,
    "NonHttpUrlRedirectClientError": REDIRECTED,
    "ParamValidationError": UNUSABLE,
    "PermissionError": DENIED,
}
MAY_PASS = frozenset({408, 425, 429, *range(500, 600)})


def fault_of(err: BaseException) -> Fault:
    """What an error of any library below means."""
    chain: list[BaseException] = []
    cause: BaseException | None = err
    while cause is not None and cause not in chain:
        chain.append(cause)
        cause = cause.__cause__
    for cause in chain:
        if isinstance(cause, ServerError):
            return cause.fault
        if _is_a(cause, "TooManyRedirects"):
            return REDIRECTS  # whose status says nothing
        if _is_a(cause, "ClientResponseError") and any(_is_a(other, "BadHttpMessage") for other in chain):
            return ANSWER  # aiohttp says that it is HTTP 400
        if (status := _status(cause)) is not None:
            return fault_of_status(status)
    for cause in reversed(chain):
        fault = next((BY_NAME[base.__name__] for base in type(cause).__mro__ if base.__name__ in BY_NAME), None)
        # fsspec raises FileNotFoundError whenever it fails to ask a server.
        if fault is not None and (fault is not MISSING or len(chain) == 1):
            return fault
    if isinstance(chain[-1], ValueError):
        return UNUSABLE
    return Fault(type(chain[-1]).__name__, "check the network, and try again", passes=True)


def fault_of_status(status: int) -> Fault:
    """What an HTTP status means."""
    if status in BY_STATUS:
        return BY_STATUS[status]._replace(reason=f"{BY_STATUS[status].reason} (HTTP {status})")
    return Fault(f"HTTP {status}", f"try again later, or {REMEDY}", status in MAY_PASS)


def _is_a(err: BaseException, name: str) -> bool:
    return name in [base.__name__ for base in type(err).__mro__]


def _status(err: BaseException) -> int | None:
    """HTTP status in an error of aiohttp or botocore."""
    status = getattr(err, "status", None)
    response = getattr(err, "response", None)
    if isinstance(response, dict):
        status = response.get("ResponseMetadata", {}).get("HTTPStatusCode")
    return status if isinstance(status, int) else None
