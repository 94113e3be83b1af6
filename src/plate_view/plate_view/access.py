"""Access rules of the page. The rules decide by address, origin and token who may open the page and
who may send commands."""

from __future__ import annotations

import hmac
import ipaddress
from dataclasses import dataclass
from enum import StrEnum

from plate_core import PlateError

LOCAL_NAMES = ("localhost", "127.0.0.1", "[::1]")
"""Host names with which a browser on this machine requests the page."""

MIN_TOKEN = 12
"""Minimum number of characters of a token."""


class AccessError(PlateError):
    """The settings of the page's access rules are unsafe or invalid."""


class Role(StrEnum):
    """Role of a browser. A viewer may only see data, and an operator may also send commands."""

    VIEWER = "viewer"
    OPERATOR = "operator"


@dataclass(frozen=True)
class Access:
    """Access rules of one page.

    Attributes
    ----------
    address : str
        IP address on which the page is served.
    operator_token, viewer_token : str
        Tokens that give a browser the role of operator or viewer. A browser sends its token at the
        end of the page's address, `?token=...`. If the token of a role is empty, no browser can get
        this role by a token.

    Raises
    ------
    AccessError
        If other machines could send commands without a token.
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
                f"address is {self.address}, allowed without operator_token: 127.0.0.1; for other "
                f"addresses set operator_token with at least {MIN_TOKEN} characters"
            )
        for name in ("operator_token", "viewer_token"):
            token = getattr(self, name)
            if token and not (len(token) >= MIN_TOKEN and token.isascii() and token.isalnum()):
                raise AccessError(
                    f"{name} has {len(token)} characters, allowed: at least {MIN_TOKEN}, "
                    "only letters and digits"
                )
        if self.operator_token and self.operator_token == self.viewer_token:
            raise AccessError("operator_token and viewer_token are equal, allowed: different ones")

    @property
    def is_local(self) -> bool:
        """Whether only this machine can reach the page."""
        return ipaddress.ip_address(self.address).is_loopback

    def role(self, token: str) -> Role | None:
        """Return the role of a browser with this token. Return None if the browser has no
        access."""
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
        """Whether requests to this host (`name:port`) are accepted. A page that is served only to
        this machine accepts only the local names. If it accepted other names, another web site
        could map its own name to this address (DNS rebinding)."""
        name = host.rsplit(":", 1)[0] if not host.endswith("]") else host
        return not self.is_local or name in (*LOCAL_NAMES, self.address)

    def allows_origin(self, origin: str, host: str) -> bool:
        """Whether a web page of this origin may connect. Only the page of this server may
        connect."""
        return origin in (f"http://{host}", f"https://{host}")
