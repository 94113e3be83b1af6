"""Build plate_gym as an ament_python package. Without ROS, use `pip install ./src/plate_gym`."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = "plate_gym"
CLONE = Path(__file__).resolve().parents[2]

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={NAME: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    # pip installs the other packages of this repository as one library. colcon builds each package
    # separately.
    install_requires=["gymnasium>=1.0", f"vibrating-plate @ {CLONE.as_uri()}"],
    extras_require={"cluster": ["distributed==2026.8.0"], "test": ["pytest"]},
    zip_safe=False,
    maintainer="The plate developers",
    maintainer_email="plate@example.org",
    description="The plate as a benchmark: environments of Gymnasium, agents and their evaluation.",
    license="Apache-2.0",
)
