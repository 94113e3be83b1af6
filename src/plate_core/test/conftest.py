"""Fixtures and functions that several tests of this folder share."""

import pytest


@pytest.fixture(scope="session")
def hears():
    """Read the output of a program until a line. On a busy machine, Fast DDS can print further
    lines."""

    def until(process, line):
        return any(output == f"{line}\n" for output in process.stdout)

    return until
