"""Build plate_driver as an ament_python package."""

from setuptools import find_packages, setup

from plate_native import node_programs

NAME = "plate_driver"

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={NAME: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["plate_core", "numpy", "pyserial", "scipy"],
    extras_require={"test": ["pytest"]},
    cmdclass={"install_scripts": node_programs("driver")},
    zip_safe=False,
    maintainer="The plate developers",
    maintainer_email="plate@example.org",
    description="Applies the rig's limits to plate motions and sends them to the motors.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [f"driver = {NAME}.node:main"],
        f"{NAME}.transports": [
            f"sim = {NAME}.transports:make_sim",
            f"serial = {NAME}.transports:make_serial",
        ],
    },
)
