"""The address of an LCM network: what it looks like, and how the network is opened."""

import re

from pydrake.lcm import DrakeLcm

from gridpush_drake.errors import StationError

DEFAULT_URL = "udpm://239.255.76.67:7667?ttl=0"
"""The LCM network if no other is named: on this computer only."""

URL = re.compile(r"udpm://(22[4-9]|23\d)\.(\d{1,3})\.(\d{1,3})\.(\d{1,3}):(\d{1,5})(\?ttl=\d+)?")
"""Form of an LCM network's URL: a multicast address and a port."""

MAX_BYTE = 255
"""Greatest part of an address."""

MAX_PORT = 65535
"""Greatest number of a port."""


def check_url(url: str) -> None:
    """Checks the URL of an LCM network, which is not opened.

    Raises:
        StationError: the URL is not one of LCM.
    """
    match = URL.fullmatch(url)
    good = (
        match
        and all(int(part) <= MAX_BYTE for part in match.groups()[1:4])
        and 0 < int(match[5]) <= MAX_PORT
    )
    if not good:
        raise StationError(
            f"--lcm: {url!r}; expected udpm://ADDRESS:PORT?ttl=N such as {DEFAULT_URL}"
        )


def open_lcm(url: str) -> DrakeLcm:
    """Opens an LCM network.

    Raises:
        StationError: the URL is not one of LCM, or the computer has no network for it.
    """
    check_url(url)
    lcm = DrakeLcm(url)
    if not lcm.available():
        raise StationError(f"--lcm: {url}: no network takes multicast; see docs/hardware.md")
    return lcm
