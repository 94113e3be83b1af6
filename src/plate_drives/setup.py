"""Build plate_drives as an ament_python package. `pip install ./src/plate_drives` is also
possible."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = "plate_drives"
CLONE = Path(__file__).resolve().parents[2]

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={
        NAME: [
            "py.typed",
            "firmware/*.[ch]",
            "firmware/drives/*",
            "firmware/host/*",
            "firmware/boards/linux/*",
        ]
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    # pip installs the other packages of this repository as one library. colcon builds each package
    # separately.
    install_requires=[f"vibrating-plate @ {CLONE.as_uri()}"],
    extras_require={"can": ["python-can>=4.2"], "test": ["canopen", "pytest"]},
    zip_safe=False,
    maintainer="The plate developers",
    maintainer_email="plate@example.org",
    description="Commissioning and control of drives on a CAN bus from the host, without a board.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            f"commission = {NAME}.commission:main",
            f"lateness = {NAME}.lateness:main",
        ],
        "plate_driver.transports": [f"socketcan = {NAME}.socketcan:make"],
    },
)
