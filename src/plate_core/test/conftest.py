"""What several tests here share."""

import pytest


@pytest.fixture(scope="session")
def hears():
    """Read what a program says until a line of it: on a busy machine Fast DDS may say more."""

    def until(process, line):
        return any(said == f"{line}\n" for said in process.stdout)

    return until
