"""Who may open the page, and who may command: by address, origin and token."""

from __future__ import annotations

import hmac
import ipaddress
from dataclasses import dataclass
from enum import StrEnum

from plate_core import PlateError

LOCAL_NAMES = ("localhost", "127.0.0.1", "[::1]")
"""Names by which a browser of this machine calls it."""

LEAST_TOKEN = 12
"""Characters of a token."""


class AccessError(PlateError):
    """Nobody may open the page so."""


class Role(StrEnum):
    """What a browser may do: look on, or command too."""

    VIEWER = "viewer"
    OPERATOR = "operator"


@dataclass(frozen=True)
class Access:
    """The rules of one page.

    Attributes
    ----------
    address : str
        IP address on which it is served.
    operator_token, viewer_token : str
        What a browser's address must end with, as `?token=...`; empty: there is none.

    Raises
    ------
    AccessError
        If others than this machine could command without a token.
    """

    address: str = "127.0.0.1"
    operator_token: str = ""
    viewer_token: str = ""

    def __post_init__(self) -> None:
        try:
            ipaddress.ip_address(self.address)
        except ValueError:
            raise AccessError(
                f"address is {self.address!r}, allowed: an IP address such as 127.0.0.1, or "
                "0.0.0.0 for all networks"
            ) from None
        if not (self.is_local or self.operator_token):
            raise AccessError(
                f"address is {self.address} without operator_token, allowed: 127.0.0.1, or a "
                f"token of at least {LEAST_TOKEN} characters"
            )
        for name in ("operator_token", "viewer_token"):
            token = getattr(self, name)
            if token and not (len(token) >= LEAST_TOKEN and token.isascii() and token.isalnum()):
                raise AccessError(
                    f"{name} has {len(token)} characters, allowed: at least {LEAST_TOKEN}, "
                    "letters and digits"
                )
        if self.operator_token and self.operator_token == self.viewer_token:
            raise AccessError("operator_token and viewer_token are the same, allowed: two tokens")

    @property
    def is_local(self) -> bool:
        """Whether only this machine reaches the page."""
        return ipaddress.ip_address(self.address).is_loopback

    def role(self, token: str) -> Role | None:
        """Return what a browser with this token may do; None: nothing."""
        if self.operator_token and hmac.compare_digest(
            token.encode(), self.operator_token.encode()
        ):
            return Role.OPERATOR
        if self.viewer_token and hmac.compare_digest(token.encode(), self.viewer_token.encode()):
            return Role.VIEWER
        if self.operator_token or not self.is_local:
            return None
        return Role.OPERATOR

    def allows_host(self, host: str) -> bool:
        """Whether a request may be for this host (`name:port`): a page that is served to this
        machine alone is called by no other name, or a foreign site could let its own name lead
        here."""
        name = host.rsplit(":", 1)[0] if not host.endswith("]") else host
        return not self.is_local or name in (*LOCAL_NAMES, self.address)

    def allows_origin(self, origin: str, host: str) -> bool:
        """Whether a page of this origin may talk to us: only our own."""
        return origin in (f"http://{host}", f"https://{host}")
