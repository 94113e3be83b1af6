"""Who may open the page, and who may command."""

import pytest

from plate_view import Access, AccessError, Role

OPERATOR, VIEWER = "operator1234", "viewer123456"


def test_if_the_page_is_local_every_browser_is_an_operator():
    access = Access()
    assert access.role("") is Role.OPERATOR
    assert access.is_local


@pytest.mark.parametrize("address", ["0.0.0.0", "192.168.1.7", "::"])
def test_a_network_needs_a_token(address):
    with pytest.raises(AccessError, match="without operator_token"):
        Access(address)
    access = Access(address, OPERATOR)
    assert access.role(OPERATOR) is Role.OPERATOR
    assert access.role("") is None
    assert access.role(OPERATOR[:-1]) is None


def test_a_token_determines_the_role_of_a_browser():
    access = Access("0.0.0.0", OPERATOR, VIEWER)
    assert access.role(VIEWER) is Role.VIEWER
    assert access.role("no token at all: ü") is None
    assert Access(viewer_token=VIEWER).role(VIEWER) is Role.VIEWER


@pytest.mark.parametrize(
    "words",
    [("somewhere",), ("0.0.0.0", "short"), ("0.0.0.0", "with spaces in"),
     ("0.0.0.0", OPERATOR, OPERATOR), ("127.0.0.1", "", "short")],
)  # fmt: skip
def test_invalid_access_options_are_refused(words):
    with pytest.raises(AccessError, match="allowed"):
        Access(*words)


def test_a_local_page_is_called_by_no_other_name():
    """A foreign site may let its own name lead to 127.0.0.1."""
    access = Access()
    for host in ("localhost:8080", "127.0.0.1:8080", "[::1]:8080", "localhost"):
        assert access.allows_host(host), host
    for host in ("evil.example:8080", "127.0.0.1.evil.example", ""):
        assert not access.allows_host(host), host
    assert Access("0.0.0.0", OPERATOR).allows_host("lab-7:8080")


def test_only_our_own_page_may_talk_to_us():
    access = Access()
    assert access.allows_origin("http://localhost:8080", "localhost:8080")
    for origin in ("", "null", "http://evil.example", "http://localhost:9090", "file://"):
        assert not access.allows_origin(origin, "localhost:8080"), origin
