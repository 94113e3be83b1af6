"""Build plate_native as an ament_python package."""

from setuptools import find_packages, setup

NAME = "plate_native"

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={NAME: ["py.typed", "include/plate/*.hpp"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=[],
    zip_safe=False,
    maintainer="The plate developers",
    maintainer_email="plate@example.org",
    description="Compilation of the C++ kernels, and their shared headers.",
    license="Apache-2.0",
)
