"""Build the example as an ament_python package. The entry point of the package registers the
transport."""

from setuptools import setup

NAME = "plate_trajectory_controller"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    zip_safe=False,
    maintainer="The plate developers",
    maintainer_email="plate@example.org",
    description="Motor tables to a ros2_control joint_trajectory_controller.",
    license="Apache-2.0",
    entry_points={"plate_driver.transports": [f"trajectory_controller = {NAME}.node:make"]},
)
