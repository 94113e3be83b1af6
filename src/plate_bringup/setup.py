"""Build plate_bringup as an ament_python package."""

from pathlib import Path

from setuptools import find_packages, setup

from plate_native import node_programs

NAME = "plate_bringup"

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={NAME: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", sorted(map(str, Path("launch").glob("*.py")))),
    ],
    install_requires=["plate_core", "PyYAML"],
    extras_require={"test": ["pytest"]},
    cmdclass={"install_scripts": node_programs("one_process")},
    zip_safe=False,
    maintainer="The plate developers",
    maintainer_email="plate@example.org",
    description="Launch files of the closed loop, its list of nodes, parameters, scenarios, views.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            f"feasible = {NAME}.feasible:main",
            f"one_process = {NAME}.one_process:main",
            f"qualify = {NAME}.qualify:main",
        ]
    },
)
