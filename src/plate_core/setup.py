"""Build plate_core as an ament_python package."""

from setuptools import find_packages, setup

NAME = "plate_core"


setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={NAME: ["py.typed", "config/*", "config/*/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["numpy", "PyYAML", "scipy", "shapely"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="The plate developers",
    maintainer_email="plate@example.org",
    description="Rig facts, frames, plate cycles and message conversion shared by all stages.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            f"check_rig = {NAME}.rig.check_rig:main",
        ]
    },
)
