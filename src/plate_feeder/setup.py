"""Build plate_feeder as an ament_python package."""

from setuptools import find_packages, setup

from plate_native import node_programs

NAME = "plate_feeder"

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={NAME: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["plate_core", "numpy"],
    extras_require={"test": ["hypothesis", "pytest"]},
    cmdclass={"install_scripts": node_programs("feeder")},
    zip_safe=False,
    maintainer="The plate developers",
    maintainer_email="plate@example.org",
    description="A feeder: dispenses parts to a robot one by one.",
    license="Apache-2.0",
    entry_points={"console_scripts": [f"feeder = {NAME}.node:main"]},
)
