"""Build plate_bringup as an ament_python package."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = "plate_bringup"
SUFFIXES = (".yaml", ".xml", ".py", ".rviz", ".json")


def shared_files(folder):
    """List the files under `folder` for share/<package>/<folder>; plate_core has the rig file."""
    by_target = {}
    for path in sorted(Path(folder).glob("**/*.*")):
        if path.suffix in SUFFIXES and path.name != "rig.yaml":
            by_target.setdefault(f"share/{NAME}/{path.parent}", []).append(str(path))
    return list(by_target.items())


setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={NAME: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        *shared_files("config"),
        *shared_files("launch"),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="The plate developers",
    maintainer_email="plate@example.org",
    description="Launch files of the closed loop, its list of nodes, parameters, scenarios, views.",
    license="Apache-2.0",
)
