"""Libraries of the system that Open3D links against."""

import sys

import pytest

from lidcam.bags.simulator.world import open3d_runtime
from lidcam.bags.simulator.world.open3d_runtime import check_libraries
from lidcam.pipeline.core.errors import LidcamError


@pytest.mark.skipif(sys.platform != "linux", reason="the names are those of Linux")
def test_what_is_missing_is_named_with_its_package(monkeypatch: pytest.MonkeyPatch) -> None:
    check_libraries()
    monkeypatch.setattr(
        open3d_runtime, "LIBRARIES", {"libc.so.6": "libc6", "libno.so.1": "libno1", "libnil.so": "libnil"}
    )
    with pytest.raises(LidcamError, match=r"needs libno\.so\.1, libnil\.so, .*: apt-get install libno1 libnil, or"):
        check_libraries()
