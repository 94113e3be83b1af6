"""For all tests: each process that runs some has a ROS domain of its own.

So neither the workers of one run nor two runs on a machine hear each other.
"""

import os

from graph.domains import own_domain


def pytest_configure(config):
    domain = own_domain()
    os.environ["ROS_DOMAIN_ID"] = str(domain.__enter__())
    config.add_cleanup(lambda: domain.__exit__(None, None, None))
